"""Hosts, their links to the centre, and faults of these links.

Every host has one link, to the centre, where the router is. A link's state combines its own settings with those of all
active faults: any partition cuts it, delays add up, losses are independent, the smallest bandwidth applies. When a
fault ends, the state is computed without it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from typing import Any, NamedTuple

from mast_zenoh.errors import ConfigurationError, nearest

#: Types of faults of hosts' links, and their parameters: required ones, and ones with a default.
HOST_FAULTS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "HostPartition": ((), ()),
    "HostLoss": (("probability",), ()),
    "HostDelay": (("delay_ms",), ("jitter_ms",)),
    "HostBandwidth": (("bits_per_s",), ()),
}

#: Mechanisms that can delay a host's link.
DELAY_BY = ("netem", "relay")

_NAME = re.compile(r"[A-Za-z0-9_-]+")
_TIMES = ("at", "until")
_HOST_PARAMETERS = ("delay_ms", "jitter_ms", "loss", "bits_per_s")
_MAX_HOSTS = 200
_MIN_BITS_PER_S = 8_000.0

#: A connection without an acknowledgement for 1.5 s ends (runtime/mesh/session.py); a round trip must take less.
_MAX_DELAY_MS = 500.0


@dataclass(frozen=True, slots=True)
class LinkState:
    """The state of a host's link, the same in each direction.

    cut: drops all packets; loss: fraction of lost packets; delay_ms ± jitter_ms: delay of a packet, on the wall clock;
    bits_per_s: bandwidth, None: unlimited
    """

    cut: bool = False
    loss: float = 0.0
    delay_ms: float = 0.0
    jitter_ms: float = 0.0
    bits_per_s: float | None = None

    def under(self, fault: Mapping[str, Any]) -> LinkState:
        """The state with this fault active in addition."""
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
    """A change of the links: their states from `at_s` (s of scene time) onwards."""

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
    """Resolve hosts and their faults to plain JSON without defaults or patterns.

    Returns {} without hosts.

    hosts: a scenario's `hosts`: name → dict(nodes=[names or patterns], delay_ms, jitter_ms, loss, bits_per_s, delay_by)
    faults: (place in the scenario, fault) for faults of the types HOST_FAULTS
    nodes: the names of all nodes of the run; nodes without a host run at the centre
    beside: node → the node whose host it shares unless a host claims it by name or pattern (links: their agent)

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
                raise ConfigurationError(f"{where}.nodes: {node!r} is already on host {home[node]!r}")
    for node, agent in (beside or {}).items():
        if agent in home:
            home.setdefault(node, home[agent])
    for name, spec in resolved.items():
        spec["nodes"] = [node for node in known if home.get(node) == name]
        if not spec["nodes"]:
            raise ConfigurationError(f"{place}: hosts.{name}: no node runs on this host")
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
    """The state of each host's link without faults, as before and after a run."""
    return {
        name: LinkState(False, spec["loss"], spec["delay_ms"], spec["jitter_ms"], spec["bits_per_s"])
        for name, spec in network["hosts"].items()
    }


def steps(network: Mapping[str, Any]) -> list[LinkStep]:
    """Changes of the links, one for each time at which faults begin or end."""
    faults = network["faults"]
    times = {fault["at"] for fault in faults} | {fault["until"] for fault in faults if fault["until"] is not None}
    before, changes = own_states(network), []
    for at_s in sorted(times):
        states = own_states(network)
        for fault in faults:
            if fault["at"] <= at_s and (fault["until"] is None or at_s < fault["until"]):
                states |= {name: states[name].under(fault) for name in fault["hosts"]}
        if changed := {name: state for name, state in states.items() if state != before[name]}:
            changes.append(LinkStep(at_s, changed))
        before = states
    return changes


def needs(network: Mapping[str, Any]) -> dict[str, list[str]]:
    """Capabilities that this network needs, with the hosts that need them.

    Keys: "partition", "loss", "bandwidth", "netem", "relay", or "delay" for either of the latter two
    """
    states: dict[str, list[LinkState]] = {name: [state] for name, state in own_states(network).items()}
    for step in steps(network):
        for name, state in step.states.items():
            states[name].append(state)
    capabilities: dict[str, list[str]] = {}
    for name, spec in network["hosts"].items():
        if any(state.cut for state in states[name]):
            capabilities.setdefault("partition", []).append(name)
        if any(state.loss for state in states[name]):
            capabilities.setdefault("loss", []).append(name)
        if any(state.bits_per_s is not None for state in states[name]):
            capabilities.setdefault("bandwidth", []).append(name)
        if spec["delayed"]:
            capabilities.setdefault(spec["delay_by"] or "delay", []).append(name)
    return capabilities


def _host(spec: object, where: str) -> dict[str, Any]:
    """Validate one host; `delayed`: whether its link ever has a delay."""
    if not isinstance(spec, Mapping):
        raise ConfigurationError(f"{where}: found {spec!r}, expected a dict(nodes=[…])")
    _reject_unknown(spec, ("nodes", *_HOST_PARAMETERS, "delay_by"), where)
    if "nodes" not in spec:
        raise ConfigurationError(f"{where}: found no `nodes`, expected the names of the nodes on this host")
    chosen = spec.get("delay_by")
    if chosen is not None and chosen not in DELAY_BY:
        raise ConfigurationError(f"{where}.delay_by: found {chosen!r}{nearest(str(chosen), DELAY_BY)}")
    numbers = {name: _number(name, spec.get(name, 0.0), where) for name in ("delay_ms", "jitter_ms", "loss")}
    bits_per_s = spec.get("bits_per_s")
    if bits_per_s is not None:
        bits_per_s = _number("bits_per_s", bits_per_s, where)
    delayed = bool(numbers["delay_ms"] or numbers["jitter_ms"])
    return {**numbers, "bits_per_s": bits_per_s, "delay_by": chosen, "delayed": delayed}


def _claimed(patterns: object, known: Sequence[str], where: str) -> list[str]:
    """The nodes that match a host's `nodes`."""
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
    """Validate one fault; converts its parameters to numbers and its hosts to names."""
    kind = fault["type"]
    if mode == "lockstep":
        raise ConfigurationError(
            f"{where}: {kind} acts on the host's network, on the wall clock: in lock-step the mesh would wait until it "
            "ends. Use run.mode 'realtime', or a fault of nodes (Partition, Loss, …), which is exact in lock-step"
        )
    required, optional = HOST_FAULTS[kind]
    _reject_unknown(fault, ("type", "hosts", *_TIMES, *required, *optional), where)
    for name in ("at", "hosts", *required):
        if name not in fault:
            raise ConfigurationError(f"{where}: {kind} needs {name}")
    at, until = _number("at", fault["at"], where), fault.get("until")
    if until is not None:
        until = _number("until", until, where)
        if until <= at:
            raise ConfigurationError(f"{where}.until: found {until!r}, expected a time after `at` ({at!r})")
    targets = list(hosts) if fault["hosts"] == "*" else fault["hosts"]
    if not isinstance(targets, (list, tuple)) or not targets:
        raise ConfigurationError(f"{where}.hosts: found {targets!r}, expected a list of hosts, or '*'")
    for name in targets:
        if name not in hosts:
            raise ConfigurationError(f"{where}.hosts: no host {name!r}{nearest(str(name), hosts)}")
    numbers = {name: _number(name, fault[name], where) for name in required}
    numbers |= {name: _number(name, fault.get(name, 0.0), where) for name in optional}
    return {"type": kind, "at": at, "until": until, "hosts": list(dict.fromkeys(targets)), **numbers}


def _reject_unknown(mapping: Mapping[Any, Any], known: Sequence[str], where: str) -> None:
    for key in mapping:
        if key not in known:
            raise ConfigurationError(f"{where}.{key}: unknown{nearest(str(key), known)}")


def _number(name: str, value: object, where: str) -> float:
    """A number in the valid range of the parameter `name`."""
    low, high = {
        "loss": (0.0, 1.0),
        "probability": (0.0, 1.0),
        "bits_per_s": (_MIN_BITS_PER_S, 1e11),
        "delay_ms": (0.0, _MAX_DELAY_MS),
        "jitter_ms": (0.0, _MAX_DELAY_MS),
    }.get(name, (0.0, 1e9))
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not low <= value <= high:
        raise ConfigurationError(f"{where}.{name}: found {value!r}, expected a number from {low:g} to {high:g}")
    return float(value)
