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
from typing import Any, Literal, NamedTuple

from mast_zenoh.config import registry
from mast_zenoh.errors import ConfigurationError, nearest
from mast_zenoh.faults.plan import band

_NAME = re.compile(r"[A-Za-z0-9_-]+")
_MAX_HOSTS = 200

#: A connection without an acknowledgement for 1.5 s ends (mesh/session.py); a round trip must take less.
_MAX_DELAY_MS = 500.0

#: Valid ranges of parameters.
_RANGES = {
    "loss": (0.0, 1.0),
    "probability": (0.0, 1.0),
    "bits_per_s": (8_000.0, 1e11),
    "delay_ms": (0.0, _MAX_DELAY_MS),
    "jitter_ms": (0.0, _MAX_DELAY_MS),
}


@dataclass(frozen=True, kw_only=True)
class _InRange:
    """Checks its numbers; raises ValueError."""

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            low, high = _RANGES.get(name, (0.0, 1e9))
            if isinstance(value, float) and not low <= value <= high:
                raise ValueError(f"{name}: found {value!r}, expected a number from {low:g} to {high:g}")


@dataclass(frozen=True, kw_only=True)
class ScenarioHost(_InRange):
    """A host with its own network, and the nodes on it.

    nodes: names or patterns of nodes; the others run at the centre, where the router is
    delay_ms, jitter_ms: ms, delay of its link to the centre one way, and how much that varies, up to 500
    loss: 0 to 1, share of the packets that its link loses
    bits_per_s: bandwidth of its link; None: unlimited
    delay_by: what delays: the kernel (`netem`), or a process (`relay`); None: what this machine has
    """

    nodes: list[str]
    delay_ms: float = 0.0
    jitter_ms: float = 0.0
    loss: float = 0.0
    bits_per_s: float | None = None
    delay_by: Literal["netem", "relay"] | None = None


@dataclass(frozen=True, kw_only=True)
class HostPartition(_InRange):
    """Lets nothing through the links of hosts, either way.

    at:    s of scene time at which it begins
    until: s of scene time at which it is healed; None: it lasts to the end
    hosts: names of hosts, an empty list: none; or '*' for all
    """

    at: float
    until: float | None = None
    hosts: str | tuple[str, ...]

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.until is not None and self.until <= self.at:
            raise ValueError(f"until: found {self.until!r}, expected a time after `at` ({self.at!r})")
        if isinstance(self.hosts, str) and self.hosts != "*":
            raise ValueError(f"hosts: found {self.hosts!r}, expected a list of hosts, or '*'")


@dataclass(frozen=True, kw_only=True)
class HostLoss(HostPartition):
    """Loses a share of the packets of hosts, in addition to other losses.

    probability: share of the packets, 0 to 1
    """

    probability: float


@dataclass(frozen=True, kw_only=True)
class HostDelay(HostPartition):
    """Delays the packets of hosts.

    delay_ms: added to each packet, in each direction;  jitter_ms: random deviation of the delay, in either direction
    """

    delay_ms: float
    jitter_ms: float = 0.0


@dataclass(frozen=True, kw_only=True)
class HostBandwidth(HostPartition):
    """Limits what the links of hosts carry.

    bits_per_s: in each direction
    """

    bits_per_s: float


#: The faults of hosts' links, by type.
HOST_FAULTS: dict[str, type[HostPartition]] = {
    cls.__name__: cls for cls in (HostPartition, HostLoss, HostDelay, HostBandwidth)
}


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
        host: ScenarioHost = registry.construct(ScenarioHost, registry.built(spec, Mapping, where), where)
        resolved[name] = vars(host) | {"delayed": bool(host.delay_ms or host.jitter_ms)}  # whether it ever delays
        for node in _claimed(host.nodes, known, where):
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
    result = []
    for fault in network.get("faults", ()):
        hosts, kind = fault["hosts"], fault["type"]
        nodes = [node for name in hosts for node in network["hosts"][name]["nodes"]]
        label = {"label": f"{kind.removeprefix('Host').lower()} of {', '.join(hosts)}"}
        result += [band("fault", kind, fault["at"], fault["until"], nodes, "network") | label] if hosts else []
    return result


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
        needed = {
            "partition": any(state.cut for state in states[name]),
            "loss": any(state.loss for state in states[name]),
            "bandwidth": any(state.bits_per_s is not None for state in states[name]),
            spec["delay_by"] or "delay": spec["delayed"],
        }
        for capability in filter(needed.get, needed):
            capabilities.setdefault(capability, []).append(name)
    return capabilities


def _claimed(patterns: Iterable[str], known: Sequence[str], where: str) -> list[str]:
    """The nodes that match a host's `nodes`."""
    claimed = []
    for pattern in patterns:
        matching = [node for node in known if fnmatchcase(node, pattern)]
        if not matching:
            raise ConfigurationError(f"{where}.nodes: no node {pattern!r} in this run{nearest(pattern, known)}")
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
    parameters = {key: value for key, value in fault.items() if key != "type"}
    checked: HostPartition = registry.construct(HOST_FAULTS[kind], parameters, where)
    targets = hosts if checked.hosts == "*" else checked.hosts
    for name in targets:
        if name not in hosts:
            raise ConfigurationError(f"{where}.hosts: no host {name!r}{nearest(name, hosts)}")
    return {"type": kind, **vars(checked), "hosts": list(dict.fromkeys(targets))}
