"""Hosts, the links between them and the centre, and faults of these links: what a user writes, and what it comes to.

Every host has one link, to the centre, where the router is. A link's state at any time is its own figures and those of
all faults that are on: any partition cuts it, delays add up, losses are independent, the narrowest bandwidth counts.
So a fault is healed by working out the state without it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from typing import Any, NamedTuple

from mast_zenoh.errors import ConfigurationError, nearest

#: Types of faults of hosts' links, and the figures that each takes: required, and with a default.
HOST_FAULTS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "HostPartition": ((), ()),
    "HostLoss": (("probability",), ()),
    "HostDelay": (("delay_ms",), ("jitter_ms",)),
    "HostBandwidth": (("bits_per_s",), ()),
}

#: What can delay a host's link.
DELAY_BY = ("netem", "relay")

_NAME = re.compile(r"[A-Za-z0-9_-]+")
_TIMES = ("at", "until")
_HOST_FIGURES = ("delay_ms", "jitter_ms", "loss", "bits_per_s")
_MAX_HOSTS = 200
_LEAST_BITS_PER_S = 8_000.0

#: A link of which nothing is acknowledged for 1.5 s ends (runtime/mesh/session.py): there and back must take less.
_MOST_MS = 500.0


@dataclass(frozen=True, slots=True)
class LinkState:
    """What a host's link does to packets, in each direction alike.

    cut: drops all; loss: drops this share of the packets; delay_ms ± jitter_ms: how long one takes, on the wall clock;
    bits_per_s: what it carries at most, None for all
    """

    cut: bool = False
    loss: float = 0.0
    delay_ms: float = 0.0
    jitter_ms: float = 0.0
    bits_per_s: float | None = None

    def under(self, fault: Mapping[str, Any]) -> LinkState:
        """The state while this fault is on as well."""
        match fault["type"]:
            case "HostPartition":
                return replace(self, cut=True)
            case "HostLoss":
                return replace(self, loss=1.0 - (1.0 - self.loss) * (1.0 - fault["probability"]))
            case "HostDelay":
                delay_ms, jitter_ms = self.delay_ms + fault["delay_ms"], self.jitter_ms + fault["jitter_ms"]
                return replace(self, delay_ms=delay_ms, jitter_ms=jitter_ms)
            case _:
                narrowest = min(fault["bits_per_s"], self.bits_per_s or math.inf)
                return replace(self, bits_per_s=narrowest)


class LinkStep(NamedTuple):
    """From `at_s` (s of scene time) on, the hosts' links are in these states."""

    at_s: float
    states: dict[str, LinkState]


def resolve(
    hosts: object,
    faults: Sequence[tuple[str, Mapping[str, Any]]],
    nodes: Iterable[str],
    *,
    mode: str,
    place: str,
    beside: Mapping[str, str] | None = None,
) -> dict[str, Any]:
    """Hosts and their faults as plain JSON with nothing left to decide; {} without hosts.

    hosts: a scenario's `hosts`: name → dict(nodes=[names or patterns], delay_ms, jitter_ms, loss, bits_per_s, delay_by)
    faults: (where it stands, the fault) of those whose type is one of HOST_FAULTS
    nodes: the names of all nodes of the run; those that no host claims live at the centre
    beside: node → the node with which it lives unless a host claims it by name or pattern (links: their agent)

    Raises ConfigurationError.
    """
    if not isinstance(hosts, Mapping):
        raise ConfigurationError(f"{place}: hosts: found {hosts!r}, expected a dict")
    if len(hosts) > _MAX_HOSTS:
        raise ConfigurationError(f"{place}: hosts: found {len(hosts)}, expected at most {_MAX_HOSTS}")
    known = list(nodes)
    resolved = {}
    home: dict[str, str] = {}
    for name, spec in hosts.items():
        where = f"{place}: hosts.{name}"
        if not isinstance(name, str) or not _NAME.fullmatch(name):
            raise ConfigurationError(f"{place}: hosts: found the name {name!r}, expected letters, digits, _ and -")
        resolved[name] = _host(spec, where)
        for node in _claimed(spec["nodes"], known, where):
            if home.setdefault(node, name) != name:
                raise ConfigurationError(f"{where}.nodes: {node!r} lives on {home[node]!r} already")
    for node, agent in (beside or {}).items():
        if agent in home:
            home.setdefault(node, home[agent])
    for name, spec in resolved.items():
        spec["nodes"] = [node for node in known if home.get(node) == name]
        if not spec["nodes"]:
            raise ConfigurationError(f"{place}: hosts.{name}: no node lives there")
    plain = [_fault(fault, where, list(resolved), mode) for where, fault in faults]
    for fault in plain:
        for name in fault["hosts"] if fault["type"] == "HostDelay" else ():
            resolved[name]["delayed"] = True
    return {"hosts": resolved, "faults": plain} if resolved else {}


def bands(network: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The faults of a resolved network as entries of the run's timeline."""
    return [
        {
            "label": f"{fault['type'].removeprefix('Host').lower()} of {', '.join(fault['hosts'])}",
            "kind": "fault",
            "type": fault["type"],
            "at_s": fault["at"],
            "until_s": fault["until"],
            "nodes": [node for name in fault["hosts"] for node in network["hosts"][name]["nodes"]],
            "backend": "network",
        }
        for fault in network.get("faults", ())
    ]


def own_states(network: Mapping[str, Any]) -> dict[str, LinkState]:
    """Every host's link without any fault: how a run begins, and how it is left."""
    return {
        name: LinkState(False, spec["loss"], spec["delay_ms"], spec["jitter_ms"], spec["bits_per_s"])
        for name, spec in network["hosts"].items()
    }


def steps(network: Mapping[str, Any]) -> list[LinkStep]:
    """What becomes of the links, by time: at each of these moments a fault begins or heals."""
    faults = network["faults"]
    moments = {fault["at"] for fault in faults} | {fault["until"] for fault in faults if fault["until"] is not None}
    before, found = own_states(network), []
    for at_s in sorted(moments):
        states = own_states(network)
        for fault in faults:
            if fault["at"] <= at_s and (fault["until"] is None or at_s < fault["until"]):
                states |= {name: states[name].under(fault) for name in fault["hosts"]}
        if changed := {name: state for name, state in states.items() if state != before[name]}:
            found.append(LinkStep(at_s, changed))
        before = states
    return found


def needs(network: Mapping[str, Any]) -> dict[str, list[str]]:
    """What this network wants of the machine, and the hosts that do.

    "partition", "loss", "bandwidth", "netem", "relay", or "delay" by whichever of the latter two the machine has
    """
    states: dict[str, list[LinkState]] = {name: [state] for name, state in own_states(network).items()}
    for step in steps(network):
        for name, state in step.states.items():
            states[name].append(state)
    wanted: dict[str, list[str]] = {}
    for name, spec in network["hosts"].items():
        if any(state.cut for state in states[name]):
            wanted.setdefault("partition", []).append(name)
        if any(state.loss for state in states[name]):
            wanted.setdefault("loss", []).append(name)
        if any(state.bits_per_s is not None for state in states[name]):
            wanted.setdefault("bandwidth", []).append(name)
        if spec["delayed"]:
            wanted.setdefault(spec["delay_by"] or "delay", []).append(name)
    return wanted


def _host(spec: object, where: str) -> dict[str, Any]:
    """One host, checked; `delayed`: whether its link will ever delay anything."""
    if not isinstance(spec, Mapping):
        raise ConfigurationError(f"{where}: found {spec!r}, expected a dict(nodes=[…])")
    _no_others(spec, ("nodes", *_HOST_FIGURES, "delay_by"), where)
    if "nodes" not in spec:
        raise ConfigurationError(f"{where}: found no `nodes`, expected the names of those that live there")
    chosen = spec.get("delay_by")
    if chosen is not None and chosen not in DELAY_BY:
        raise ConfigurationError(f"{where}.delay_by: found {chosen!r}{nearest(str(chosen), DELAY_BY)}")
    figures = {name: _figure(name, spec.get(name, 0.0), where) for name in ("delay_ms", "jitter_ms", "loss")}
    bits_per_s = spec.get("bits_per_s")
    if bits_per_s is not None:
        bits_per_s = _figure("bits_per_s", bits_per_s, where)
    delayed = bool(figures["delay_ms"] or figures["jitter_ms"])
    return {**figures, "bits_per_s": bits_per_s, "delay_by": chosen, "delayed": delayed}


def _claimed(patterns: object, known: Sequence[str], where: str) -> list[str]:
    """The nodes that a host's `nodes` name."""
    if not isinstance(patterns, (list, tuple)):
        raise ConfigurationError(f"{where}.nodes: found {patterns!r}, expected a list of names")
    claimed = []
    for pattern in patterns:
        matching = [node for node in known if fnmatchcase(node, str(pattern))]
        if not matching:
            raise ConfigurationError(f"{where}.nodes: no node {pattern!r} in this run{nearest(str(pattern), known)}")
        claimed += matching
    return claimed


def _fault(fault: Mapping[str, Any], where: str, hosts: Sequence[str], mode: str) -> dict[str, Any]:
    """One fault, checked, with its figures as numbers and its hosts by name."""
    kind = fault["type"]
    if mode == "lockstep":
        raise ConfigurationError(
            f"{where}: {kind} acts on the host's network, by the wall clock: in lock-step the mesh would wait until it "
            "is over. Use run.mode 'realtime', or a fault of nodes (Partition, Loss, …), which is exact in lock-step"
        )
    required, optional = HOST_FAULTS[kind]
    _no_others(fault, ("type", "hosts", *_TIMES, *required, *optional), where)
    for name in ("at", "hosts", *required):
        if name not in fault:
            raise ConfigurationError(f"{where}: {kind} needs {name}")
    at, until = _figure("at", fault["at"], where), fault.get("until")
    if until is not None:
        until = _figure("until", until, where)
        if until <= at:
            raise ConfigurationError(f"{where}.until: found {until!r}, expected a time after `at` ({at!r})")
    aimed = list(hosts) if fault["hosts"] == "*" else fault["hosts"]
    if not isinstance(aimed, (list, tuple)) or not aimed:
        raise ConfigurationError(f"{where}.hosts: found {aimed!r}, expected a list of hosts, or '*'")
    for name in aimed:
        if name not in hosts:
            raise ConfigurationError(f"{where}.hosts: no host {name!r}{nearest(str(name), hosts)}")
    figures = {name: _figure(name, fault[name], where) for name in required}
    figures |= {name: _figure(name, fault.get(name, 0.0), where) for name in optional}
    return {"type": kind, "at": at, "until": until, "hosts": list(dict.fromkeys(aimed)), **figures}


def _no_others(found: Mapping[Any, Any], known: Sequence[str], where: str) -> None:
    for key in found:
        if key not in known:
            raise ConfigurationError(f"{where}.{key}: unknown{nearest(str(key), known)}")


def _figure(name: str, value: object, where: str) -> float:
    """A number in the range that its name has."""
    least, most = {
        "loss": (0.0, 1.0),
        "probability": (0.0, 1.0),
        "bits_per_s": (_LEAST_BITS_PER_S, 1e11),
        "delay_ms": (0.0, _MOST_MS),
        "jitter_ms": (0.0, _MOST_MS),
    }.get(name, (0.0, 1e9))
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not least <= value <= most:
        raise ConfigurationError(f"{where}.{name}: found {value!r}, expected a number from {least:g} to {most:g}")
    return float(value)
