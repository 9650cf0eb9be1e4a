"""Differences of two runs that rule out attribution to added adversaries."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from mast_zenoh.report.narrative.phrases import join_names
from mast_zenoh.report.runfolder import RunFolder
from mast_zenoh.report.tables.interposers import failures_of, interposers

#: Roles of nodes that attack, and of nodes that do not affect results.
_HOSTILE, _PASSIVE = ("adversary", "coordinator"), ("recorder", "visualizer")
#: Keys of scenario.json, besides nodes, that affect results.
_SETTINGS = ("mode", "period_ns", "scene", "network")
#: Maximum number of names in a sentence; the others are counted.
_MAX_NAMED = 3


def other_differences(run: RunFolder, reference: RunFolder) -> tuple[str, ...]:
    """Settings, nodes, wires and failures in which two runs differ.

    From scenario.json and wiring.json.

    Adversaries and coordinators that only `run` has, and their wires, are ignored. Empty: no other difference.
    A setting is named by its node and path: `command_center.pipeline.clustering.assign_radius`.
    """
    nodes, reference_nodes = _nodes(run), _nodes(reference)
    only_in_run = [name for name in nodes if name not in reference_nodes]
    added = {name for name in only_in_run if name in _attackers(run)}
    differences = [
        name for name in (*only_in_run, *(name for name in reference_nodes if name not in nodes)) if name not in added
    ]
    differences += [
        key for key in _SETTINGS for key in _differing(key, *(each.scenario.get(key) for each in (run, reference)))
    ]
    for name in (name for name in nodes if name in reference_nodes):
        differences += _differing(name, nodes[name], reference_nodes[name])
    differences += _versions(run, reference)
    ignored = {*differences, *added, *_played(run), *_played(reference)}
    differences += _differing_keys(*(_steps(each, ignored) for each in (run, reference)))
    differences += _differing_keys(*(_wires(each, ignored) for each in (run, reference)))
    differences += _differing_keys(*(_interceptions(each, added) for each in (run, reference)))
    differences += _differing_keys(*(_failures(each) for each in (run, reference)))
    return tuple(dict.fromkeys(differences))


def join_differences(differences: tuple[str, ...]) -> str:
    """`a, b, c and 2 more`."""
    listed, more = list(differences[:_MAX_NAMED]), len(differences) - _MAX_NAMED
    return join_names([*listed, f"{more} more"] if more > 0 else listed)


def attacking_nodes(run: RunFolder) -> frozenset[str]:
    """Adversaries, their coordinators, and all other interposers except links."""
    return frozenset(_attackers(run))


def _played(run: RunFolder) -> list[str]:
    """The nodes of a replay that only send what was recorded."""
    return list((run.run.get("replay") or {}).get("played", ()))


def _attackers(run: RunFolder) -> set[str]:
    interposer_names = {each.name for each in interposers(run) if not each.is_link}
    return interposer_names | {name for name in _names(run) if run.role(name) in _HOSTILE}


def _names(run: RunFolder) -> list[str]:
    """Every node of a run that can affect its results."""
    known = [*run.scenario.get("nodes", {}), *run.run.get("nodes", {}), *(each.name for each in interposers(run))]
    return [name for name in dict.fromkeys(known) if run.role(name) not in _PASSIVE]


def _nodes(run: RunFolder) -> dict[str, dict[str, Any]]:
    """Settings by node; empty for nodes that are not in scenario.json."""
    specs = {name: run.node_spec(name) for name in _names(run)}
    settings = {name: {**(spec.pop("config", None) or {}), **spec} for name, spec in specs.items()}
    settings.get("evaluator", {}).pop("metrics", None)  # a user's own metrics add rows without changing others
    return settings


def _differing(name: str, here: Any, there: Any) -> Iterator[str]:
    """Dotted names of differing settings; parts of different types differ as a whole."""
    if here == there:
        return
    mappings = isinstance(here, Mapping) and isinstance(there, Mapping)
    if not mappings or here.get("type") != there.get("type"):
        yield name
        return
    for key in dict.fromkeys([*here, *there]):
        yield from _differing(f"{name}.{key}", here.get(key), there.get(key))


def _differing_keys(here: Mapping[str, Any], there: Mapping[str, Any]) -> list[str]:
    return [name for name in dict.fromkeys([*here, *there]) if here.get(name) != there.get(name)]


def _versions(run: RunFolder, reference: RunFolder) -> list[str]:
    """Packages with different versions, and algorithm files with different paths."""
    versions = [each.run.get("versions") or {} for each in (run, reference)]
    files = [{Path(path).name: path for path in each.scenario.get("modules", ())} for each in (run, reference)]
    known = [name for name in _differing_keys(*versions) if all(name in each for each in versions)]
    return [f"version of {name}" for name in known] + [
        name for name in files[0] if name in files[1] and files[0][name] != files[1][name]
    ]


def _steps(run: RunFolder, excluded: set[str]) -> dict[str, Any]:
    """The scenario's steps by node."""
    steps: dict[str, Any] = {}
    for step in run.scenario.get("steps", ()):
        if step.get("node") not in excluded:
            steps.setdefault(f"steps of {step.get('node')}", []).append(step)
    return steps


def _wires(run: RunFolder, excluded: set[str]) -> dict[str, Any]:
    """The nodes of each wire, without `excluded` nodes and listeners."""
    passive = {name for name in run.run.get("nodes", {}) if run.role(name) in (*_PASSIVE, "evaluator")}
    ignored = excluded | passive | {"recorder", "visualizer", "evaluator"}

    def kept(names: Any) -> list[str]:
        return [name for name in names if name not in ignored]

    return {
        f"wire {wire['key']}": (
            wire.get("publisher"),
            kept(wire.get("subscribers", ())),
            kept(wire.get("interposers", ())),
            kept(listener["node"] for listener in wire.get("listeners", ())),
        )
        for wire in run.wiring.get("wires", ())
        if wire.get("publisher") not in ignored
    }


def _interceptions(run: RunFolder, added: set[str]) -> dict[str, Any]:
    """Live insertions and releases by node, as (action, frame)."""
    events: dict[str, Any] = {}
    for event in run.run.get("interceptions", ()):
        if event["node"] not in added:
            events.setdefault(event["node"], []).append((event["action"], event["frame"]))
    return events


def _failures(run: RunFolder) -> dict[str, Any]:
    """Failed handlers and their counts by node, without attackers."""
    failed = {name: failures_of(node) for name, node in run.run.get("nodes", {}).items() if name not in _attackers(run)}
    return {
        f"failures of {name}": [(each["handler"], each["count"]) for each in entries]
        for name, entries in failed.items()
        if entries
    }
