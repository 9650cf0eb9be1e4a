"""What happens in a run and when: links that are never perfect, faults that come and are healed, attacks."""

from __future__ import annotations

import inspect
import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mast_zenoh import links
from mast_zenoh.attacks import Attack
from mast_zenoh.config import registry
from mast_zenoh.config.resolved import NodeSpec
from mast_zenoh.errors import ConfigurationError, nearest
from mast_zenoh.faults import Fault, Plan, network, plan
from mast_zenoh.faults.base import DIRECTIONS, Rule
from mast_zenoh.scenario.nodes import matching, node_spec
from mast_zenoh.scenes.recording import Recording

#: The rewrite that puts every link before the agent's network interface.
REWRITE = "network.toml"

_log = logging.getLogger("mast.scenario")


@dataclass(frozen=True)
class Timeline:
    """What a scenario's `links`, `faults`, `hosts` and attacks come to.

    links: the specs of the link nodes, by name;  plan: of its faults;  bands: entries of Resolved.timeline
    network: hosts and their faults, see faults/network.py
    """

    links: dict[str, NodeSpec]
    plan: Plan
    bands: tuple[dict[str, Any], ...]
    network: dict[str, Any]


def timeline_of(
    path: Path,
    scenario: Mapping[str, Any],
    nodes: Mapping[str, NodeSpec],
    recording: Recording,
    frames: int,
    *,
    seed: int,
    mode: str,
) -> Timeline:
    """The timeline of a scenario with these nodes (links not among them), of which so many frames are played.

    Raises ConfigurationError.
    """
    roles = {name: spec.role for name, spec in nodes.items()}
    times_ns = recording.times_ns[:frames] - recording.times_ns[0]
    ours, of_hosts = _faults(path, scenario.get("faults", ()))
    found = plan(ours, roles, times_ns, seed, lockstep=mode == "lockstep")
    for place in found.missed:
        _log.warning("%s: begins after the last frame, and will not happen", place)
    profiles, permanent = _profiles(path, scenario.get("links", {}), roles, _gateways(recording))
    specs: dict[str, NodeSpec] = {}
    for agent in [name for name, role in roles.items() if role == "agent"]:
        if agent not in profiles and agent not in found.rules:
            continue
        name = f"link_{agent}"
        if name in nodes:
            raise ConfigurationError(
                f"{path}: {name}: there is a node of this name already; it is the link of {agent!r}"
            )
        always, at_times = profiles.get(agent, {}), found.rules.get(agent, {})
        rules = {f"rules_{way}": [*always.get(way, ()), *at_times.get(way, ())] for way in DIRECTIONS}
        specs[name] = node_spec(path, name, "link", {"agent": agent, **rules})
    hosts = network.resolve(
        scenario.get("hosts", {}),
        of_hosts,
        [*nodes, *specs],
        mode=mode,
        place=str(path),
        beside={name: spec.config["agent"] for name, spec in specs.items()},
    )
    end_s = float(times_ns[-1]) * 1e-9
    bands = [*permanent, *found.bands, *network.bands(hosts), *_attacks(nodes)]
    shown = sorted((band for band in bands if band["at_s"] <= end_s), key=lambda band: float(band["at_s"]))
    return Timeline(specs, found, tuple(shown), hosts)


def _faults(path: Path, specs: object) -> tuple[list[tuple[str, Fault]], list[tuple[str, Mapping[str, Any]]]]:
    """(faults of nodes, faults of hosts), each with where it stands."""
    if not isinstance(specs, (list, tuple)):
        raise ConfigurationError(f"{path}: faults: found {specs!r}, expected a list of dict(type=…)")
    ours: list[tuple[str, Fault]] = []
    of_hosts: list[tuple[str, Mapping[str, Any]]] = []
    known = registry.known_types(Fault)
    for index, spec in enumerate(specs):
        place = f"{path}: faults[{index}]"
        kind = spec.get("type") if isinstance(spec, Mapping) else None
        if kind in network.HOST_FAULTS:
            of_hosts.append((place, spec))
            continue
        if isinstance(spec, Mapping) and (not isinstance(kind, str) or kind not in known):
            hint = nearest(str(kind or ""), {*known, *network.HOST_FAULTS})
            raise ConfigurationError(f"{place}.type: no fault {kind!r}{hint}")
        fault = registry.build(spec, Fault, place)
        for rule in fault.rules(True):
            registry.build({**rule, "at": fault.at, "until": fault.over}, links.Rule, place)
        ours.append((place, fault))
    return ours, of_hosts


def _profiles(
    path: Path, patterns: Mapping[str, Any], roles: Mapping[str, str], gateways: list[list[float]]
) -> tuple[dict[str, dict[str, list[Rule]]], list[dict[str, Any]]]:
    """(rules by agent and direction, bands) of the links that a scenario's `links` describe."""
    agents = [name for name, role in roles.items() if role == "agent"]
    rules: dict[str, dict[str, list[Rule]]] = {}
    who: dict[str, list[str]] = {pattern: [] for pattern in patterns}
    for agent in agents:
        pattern = matching(patterns, agent)
        if pattern is not None:
            rules[agent] = _rules_of(patterns[pattern], f"{path}: links[{pattern!r}]", gateways)
            who[pattern].append(agent)
    for pattern in patterns:
        if pattern not in agents and not set("*?[") & set(str(pattern)):  # a pattern may match nobody in this scene
            raise ConfigurationError(
                f"{path}: links: no agent {pattern!r} in this scene{nearest(str(pattern), agents)}"
            )
    bands = [_band(_name_of(patterns[pattern]), "link", 0.0, names, "links") for pattern, names in who.items() if names]
    return rules, bands


def _rules_of(spec: object, place: str, gateways: list[list[float]]) -> dict[str, list[Rule]]:
    """The rules of one link: a profile's, or its own, or both, one behind the other; checked.

    gateways: where the ranges of radio links begin that do not say it themselves
    """
    spec = {"type": spec} if isinstance(spec, str) else spec
    if not isinstance(spec, Mapping):
        raise ConfigurationError(f"{place}: found {spec!r}, expected a profile, or dict(up=[rules], down=[rules])")
    for key in spec:
        if key not in ("type", *DIRECTIONS):
            raise ConfigurationError(f"{place}.{key}: unknown key{nearest(str(key), ('type', *DIRECTIONS))}")
    try:
        found = links.profile(str(spec["type"])) if "type" in spec else {way: [] for way in DIRECTIONS}
    except ConfigurationError as error:
        raise ConfigurationError(f"{place}: {error}") from None
    for way in DIRECTIONS:
        own = spec.get(way, ())
        if not isinstance(own, (list, tuple)):
            raise ConfigurationError(f"{place}.{way}: found {own!r}, expected a list of rules, dict(type=…)")
        found[way] += own
        for index, rule in enumerate(found[way]):
            if isinstance(rule, Mapping) and rule.get("type") == "RangeLimit" and "gateways" not in rule:
                found[way][index] = rule = {**rule, "gateways": gateways}
            registry.build(rule, links.Rule, f"{place}.{way}[{index}]")
    return found


def _name_of(spec: object) -> str:
    """What a link is called on the timeline: its profile."""
    return spec if isinstance(spec, str) else str(spec.get("type", "rules")) if isinstance(spec, Mapping) else "rules"


def _gateways(recording: Recording) -> list[list[float]]:
    """Where radio ends and a wire begins: every agent that stands still, (x, y, z) m; without any, the first agent."""
    standing = [i for i, agent in enumerate(recording.agents) if agent.kind == "static"] or [0]
    return [[float(value) for value in recording.agent_position[0, i]] for i in standing]


def attack_starts(nodes: Mapping[str, NodeSpec]) -> dict[tuple[str, float], list[str]]:
    """By type of attack and the s of scene time at which it begins, the adversaries that do it then."""
    types = registry.known_types(Attack)
    found: dict[tuple[str, float], list[str]] = {}
    for name, spec in nodes.items():
        attack = spec.config.get("attack")
        if spec.role == "adversary" and isinstance(attack, Mapping) and attack.get("type") in types:
            start = inspect.signature(types[attack["type"]]).parameters.get("start_s")
            if start is not None:
                found.setdefault((attack["type"], float(attack.get("start_s", start.default))), []).append(name)
    return found


def _attacks(nodes: Mapping[str, NodeSpec]) -> list[dict[str, Any]]:
    """When attacks begin: one band for all adversaries that do the same at the same time."""
    return [_band(kind, "attack", at_s, who, "adversary") for (kind, at_s), who in attack_starts(nodes).items()]


def _band(kind: str, what: str, at_s: float, nodes: Sequence[str], backend: str) -> dict[str, Any]:
    label = f"{kind} {', '.join(nodes) if len(nodes) <= 3 else f'{len(nodes)} nodes'}"
    return {
        "label": label,
        "kind": what,
        "type": kind,
        "at_s": at_s,
        "until_s": None,
        "nodes": list(nodes),
        "backend": backend,
    }
