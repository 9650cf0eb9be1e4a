"""Resolves the events of a run over time: links, faults and attacks."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from mast_zenoh import links
from mast_zenoh.arrays.states import Bools, Floats
from mast_zenoh.attacks import Attack
from mast_zenoh.config import plugins, registry
from mast_zenoh.config.resolved import NodeSpec
from mast_zenoh.errors import ConfigurationError, WiringError, nearest
from mast_zenoh.faults import Fault, FaultPlan, network, plan
from mast_zenoh.faults.base import DIRECTIONS, SENSOR, Rule
from mast_zenoh.faults.plan import Carriers, band
from mast_zenoh.run_folder.finding import Finding
from mast_zenoh.scenario.nodes import node_spec
from mast_zenoh.scenes.agents import best_pattern
from mast_zenoh.scenes.recording import Recording
from mast_zenoh.wiring.model import Wire, Wiring, agent_of, link_of, part_of, peer_of

#: The attack that acts only as a coordinator says.
DIRECTED = "CoordinatedAttack"
#: The coordination without a plan of its own: its adversaries keep the name of their attack.
_PLAIN = "Coordinator"
#: The rewrite that puts every link between its agent and the centre.
REWRITE = "network.toml"
#: Those that put it elsewhere, by a role that the scenario has.
REWRITES = {"peer": "network_peers.toml", "center": "network_centers.toml"}

#: s before a fault; messages of that time may still be on their way when it begins.
_UNDER_WAY_S = 1.0

_log = logging.getLogger("mast.scenario")


def acts_at(band: Mapping[str, Any], times_s: Floats) -> Bools:
    """(n,) whether a fault may act on messages of n times, s: while it lasts, and on those on their way as it begins.

    band: its entry of Resolved.timeline
    """
    until_s = np.inf if band.get("until_s") is None else band["until_s"]
    return np.asarray((band["at_s"] - _UNDER_WAY_S <= times_s) & (times_s <= until_s))


@dataclass(frozen=True)
class Timeline:
    """A scenario's `links`, `faults`, `hosts` and attacks, resolved.

    links: the specs of the link nodes, by name;  on_wires: (link, key of a wire) where a fault, no map, puts it
    plan: the plan of the faults;  bands: entries of Resolved.timeline
    network: hosts and their faults, see faults/network.py
    faults: by agent, its faults: type, beginning and end in s (None: the end of the run)
    idle: each adversary, link and fault that names or matches nothing, or begins after the last frame
    """

    links: dict[str, NodeSpec]
    on_wires: tuple[tuple[str, str], ...]
    plan: FaultPlan
    bands: tuple[dict[str, Any], ...]
    network: dict[str, Any]
    faults: dict[str, list[tuple[str, float, float | None]]]
    idle: tuple[Finding, ...]


def timeline_of(
    path: Path,
    scenario: Mapping[str, Any],
    nodes: Mapping[str, NodeSpec],
    recording: Recording,
    frames: int,
    wired: Callable[[Mapping[str, NodeSpec]], tuple[Any, Any, Wiring]],
    *,
    seed: int,
    mode: str,
) -> Timeline:
    """The timeline of a scenario over its first `frames` frames.

    nodes: all nodes except links;  wired: builds these and links, and returns their wiring last
    Raises ConfigurationError and, if a fault may be of a wire, WiringError.
    """

    def link(of: str, rules: Mapping[str, Any]) -> tuple[str, NodeSpec]:
        """Name and spec of the link of an agent, or of a wire."""
        name = link_of(of)
        if name in nodes:
            raise ConfigurationError(
                f"{path}: {name}: another node already has this name, and the link of {of!r} needs it"
            )
        agent = of if of in roles else ""
        peer = {"peer": peer_of(agent)} if agent and "peer" in roles.values() else {}
        return name, node_spec(path, name, "link", {"agent": agent, **rules, **peer})

    @cache
    def wires() -> dict[str, Wire]:
        """The wires by key, with a link for each agent, which shows where links would be."""
        try:
            *_, wiring = wired(dict(link(agent, {}) for agent in agents))
        except WiringError:  # a map of the user's own, on which agents can have no links
            *_, wiring = wired({})
        return {wire.key: wire for wire in wiring.wires if wire.legs[0].publisher.node in nodes}

    roles = {name: spec.role for name, spec in nodes.items()}
    times_ns = recording.times_ns[:frames] - recording.times_ns[0]
    node_faults, host_faults = _faults(path, scenario.get("faults", ()))
    agents = [name for name, role in roles.items() if role == "agent"]

    def carriers() -> Carriers:
        return {key: _carriers(wire, agents) for key, wire in wires().items()}

    fault_plan = plan(node_faults, roles, times_ns, seed, lockstep=mode == "lockstep", carriers=carriers)
    for place in fault_plan.missed:
        _log.warning("%s: begins after the last frame and is ignored", place)
    end_s = float(times_ns[-1]) * 1e-9
    late = {place: fault for place, fault in node_faults if place in fault_plan.missed}
    idle = [_begins_late(f"{_short(place)} ({type(fault).__name__})", fault.at, end_s) for place, fault in late.items()]
    profiles, permanent = _profiles(path, scenario.get("links", {}), roles, _gateways(recording))
    specs: dict[str, NodeSpec] = {}
    on_wires: list[tuple[str, str]] = []
    beside: dict[str, str] = {}
    for of in dict.fromkeys([*agents, *fault_plan.rules]):
        if of not in profiles and of not in fault_plan.rules:
            continue
        permanent_rules, timed_rules = profiles.get(of, {}), fault_plan.rules.get(of, {})
        rules: dict[str, Any] = {
            f"rules_{direction}": [*permanent_rules.get(direction, ()), *timed_rules.get(direction, ())]
            for direction in DIRECTIONS
        }
        if SENSOR in timed_rules:
            rules["rules_sensor"] = timed_rules[SENSOR]
        if further := {way.partition("/")[2]: timed for way, timed in timed_rules.items() if "/" in way}:
            rules["rules_of_sensors"] = further
        name, specs[name] = link(of, rules)
        on_wires += [(name, f"agent/{of}/detections{way[len(SENSOR) :]}") for way in timed_rules if SENSOR in way]
        on_wires += [(name, of)] if of not in roles else []
        beside[name] = of if of in roles else wires()[of].legs[0].publisher.node
    hosts = network.resolve(
        scenario.get("hosts", {}),
        host_faults,
        [*nodes, *specs],
        mode=mode,
        place=str(path),
        beside=beside,
    )
    of_hosts = network.bands(hosts)
    bands = [*permanent, *fault_plan.bands, *of_hosts, *_attacks(nodes)]
    faults = {agent: list(entries) for agent, entries in fault_plan.of_agents.items()}
    for each in of_hosts:
        for name in each["nodes"]:
            if roles.get(name) == "agent":
                faults.setdefault(name, []).append((each["type"], each["at_s"], each["until_s"]))
    visible = sorted((each for each in bands if each["at_s"] <= end_s), key=lambda each: float(each["at_s"]))
    idle += [_begins_late(f"fault {each['label']}", each["at_s"], end_s) for each in of_hosts if each["at_s"] > end_s]
    nowhere = [(f"{_short(at)} ({type(fault).__name__})", "node") for at, fault in node_faults if not fault.selectors]
    nowhere += [(f"{_short(at)} ({fault['type']})", "host") for at, fault in host_faults if not fault["hosts"]]
    nowhere += [(name, "agent") for name in scenario.get("adversaries", {}) if name not in nodes]
    idle += [Finding("idle", (part,), f"no {what}") for part, what in nowhere]
    idle += [
        Finding("idle", (pattern,), "links")
        for pattern in scenario.get("links", {})
        if not any(best_pattern(scenario["links"], agent) == pattern for agent in roles if roles[agent] == "agent")
    ]
    return Timeline(specs, tuple(on_wires), fault_plan, tuple(visible), hosts, faults, tuple(idle))


def _begins_late(part: str, at_s: float, end_s: float) -> Finding:
    return Finding("idle", (part,), "late", at_s, end_s, "s")


def _short(place: str) -> str:
    """A place in the scenario, without its file."""
    return place.rpartition(": ")[2]


def _carriers(wire: Wire, agents: Sequence[str]) -> list[tuple[str, str]]:
    """Where a fault of a wire acts: at the link of its publisher; without one, at those of its subscribers."""
    agent = agent_of(wire.subject)
    if wire.message == "detections" and agent in agents:
        return [(agent, "/".join(filter(None, (SENSOR, part_of(wire.subject)))))]
    links = {link_of(name): name for name in agents}
    before = {leg.publisher.node: branch.subscriber.node for branch in wire.branches for leg in branch.legs}
    ends = [
        (of, "down" if before.get(node) in (of, peer_of(of)) else "up")
        for node, of in ((node, links[node]) for node in wire.interposers if node in links)
        if node in before or agent in ("", of)  # a map may put links before what another node says
    ]
    return [end for end in ends if end[1] == "up"] or ends or [(wire.key, "up")]


def rewrites(links: Mapping[str, NodeSpec], nodes: Mapping[str, NodeSpec]) -> list[str]:
    """The maps that put links between their agents and the network."""
    roles = {spec.role for spec in nodes.values()}
    network_maps = [file for role, file in REWRITES.items() if role in roles]
    if "center" not in roles and (not network_maps or roles & {"broker", "command_center"}):
        network_maps.append(REWRITE)
    return network_maps if any(spec.config["agent"] for spec in links.values()) else []


def _faults(path: Path, specs: object) -> tuple[list[tuple[str, Fault]], list[tuple[str, Mapping[str, Any]]]]:
    """(faults of nodes, faults of hosts), each with its place in the scenario."""
    if not isinstance(specs, (list, tuple)):
        raise ConfigurationError(f"{path}: faults: found {specs!r}, expected a list of dict(type=…)")
    node_faults: list[tuple[str, Fault]] = []
    host_faults: list[tuple[str, Mapping[str, Any]]] = []
    known = registry.known_types(Fault)
    for index, spec in enumerate(specs):
        place = f"{path}: faults[{index}]"
        kind = spec.get("type") if isinstance(spec, Mapping) else None
        if kind in network.HOST_FAULTS:
            host_faults.append((place, spec))
            continue
        if isinstance(spec, Mapping) and (
            not isinstance(kind, str) or kind not in (known := registry.known_types(Fault, kind))
        ):
            every = {*known, *network.HOST_FAULTS}
            raise plugins.not_found(f"{place}.type: unknown fault {kind!r}", str(kind or ""), every)
        node_faults.append((place, registry.build(spec, Fault, place)))
    return node_faults, host_faults


def _profiles(
    path: Path, patterns: Mapping[str, Any], roles: Mapping[str, str], gateways: list[list[float]]
) -> tuple[dict[str, dict[str, list[Rule]]], list[dict[str, Any]]]:
    """(rules by agent and direction, bands) of a scenario's `links`."""
    agents = [name for name, role in roles.items() if role == "agent"]
    rules: dict[str, dict[str, list[Rule]]] = {}
    matched_agents: dict[str, list[str]] = {pattern: [] for pattern in patterns}
    for agent in agents:
        pattern = best_pattern(patterns, agent)
        if pattern is not None:
            rules[agent] = _rules_of(patterns[pattern], f"{path}: links[{pattern!r}]", gateways)
            matched_agents[pattern].append(agent)
    for pattern in patterns:
        if pattern not in agents and not set("*?[") & set(str(pattern)):  # a pattern may match no agent of this scene
            raise ConfigurationError(
                f"{path}: links: no agent {pattern!r} in this scene{nearest(str(pattern), agents)}"
            )
    bands = [
        band("link", _name_of(patterns[pattern]), 0.0, None, names, "links")
        for pattern, names in matched_agents.items()
        if names
    ]
    return rules, bands


def _rules_of(spec: object, place: str, gateways: list[list[float]]) -> dict[str, list[Rule]]:
    """The validated rules of one link, by direction.

    The profile's rules come first, then the link's own.
    gateways: (x, y, z) m, from which the ranges of radio links are measured, for rules without gateways of their own
    """
    spec = {"type": spec} if isinstance(spec, str) else spec
    if not isinstance(spec, Mapping):
        raise ConfigurationError(f"{place}: found {spec!r}, expected a profile, or dict(up=[rules], down=[rules])")
    for key in spec:
        if key not in ("type", *DIRECTIONS):
            raise ConfigurationError(f"{place}.{key}: unknown key{nearest(str(key), ('type', *DIRECTIONS))}")
    try:
        rules = links.profile(str(spec["type"])) if "type" in spec else {direction: [] for direction in DIRECTIONS}
    except ConfigurationError as error:
        raise ConfigurationError(f"{place}: {error}") from None
    for direction in DIRECTIONS:
        own = spec.get(direction, ())
        if not isinstance(own, (list, tuple)):
            raise ConfigurationError(f"{place}.{direction}: found {own!r}, expected a list of dict(type=…)")
        rules[direction] += own
        for index, rule in enumerate(rules[direction]):
            if isinstance(rule, Mapping) and rule.get("type") == "RangeLimit" and "gateways" not in rule:
                rules[direction][index] = rule = {**rule, "gateways": gateways}
            registry.build(rule, links.Rule, f"{place}.{direction}[{index}]")
    return rules


def _name_of(spec: object) -> str:
    """The name of a link on the timeline: its profile."""
    return spec if isinstance(spec, str) else str(spec.get("type", "rules")) if isinstance(spec, Mapping) else "rules"


def _gateways(recording: Recording) -> list[list[float]]:
    """Positions where radio links reach the wired network, (x, y, z) m.

    These are the positions of all static agents or, if there are none, of the first agent.
    """
    static = [i for i, agent in enumerate(recording.agents) if agent.kind == "static"] or [0]
    return [[float(value) for value in recording.agent_position[0, i]] for i in static]


def attack_starts(nodes: Mapping[str, NodeSpec]) -> dict[tuple[str, float], list[str]]:
    """The adversaries of each attack, by (type, start in s of scene time)."""
    types = registry.known_types(Attack)
    adversaries: dict[tuple[str, float], list[str]] = {}
    for name, spec in nodes.items():
        attack = spec.config.get("attack")
        if spec.role == "adversary" and isinstance(attack, Mapping) and attack.get("type") in types:
            start = registry.parameters_of(types[attack["type"]]).get("start_s")
            if start is not None:
                adversaries.setdefault((attack["type"], float(attack.get("start_s", start.default))), []).append(name)
    return adversaries


def _attacks(nodes: Mapping[str, NodeSpec]) -> list[dict[str, Any]]:
    """A band for all adversaries that begin the same attack at the same time; directed ones have their coordination."""
    plans = [spec.config.get("coordination") for spec in nodes.values() if spec.role == "coordinator"]
    types = [plan["type"] for plan in plans if isinstance(plan, Mapping) and plan.get("type", _PLAIN) != _PLAIN]
    directed = types[0] if types else DIRECTED
    return [
        band("attack", directed if kind == DIRECTED else kind, at_s, None, names, "adversary")
        for (kind, at_s), names in attack_starts(nodes).items()
    ]
