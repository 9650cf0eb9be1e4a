"""What two runs differ in beside the adversaries that only the first one has: these keep a cause from being named."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from mast_zenoh.report.narrative.phrases import listed
from mast_zenoh.report.runfolder import RunFolder
from mast_zenoh.report.tables.interposers import failures_of, interposers

#: Roles of nodes that direct or make up an attack, and of those that have no part in the results.
_HOSTILE, _PASSIVE = ("adversary", "coordinator"), ("recorder", "visualizer")
#: Of scenario.json, what decides over results beside the nodes.
_SETTINGS = ("mode", "period_ns", "scene", "network")
#: Names that a sentence holds; the others are counted.
_MOST_NAMED = 3


def other_differences(run: RunFolder, reference: RunFolder) -> tuple[str, ...]:
    """Names of the settings, nodes, wires and failures in which two runs differ, by scenario.json and wiring.json.

    Adversaries that only `run` has do not count, nor their coordinator and the wires of both. Empty: nothing else
    differs. A setting is named by its node and its path: `command_center.pipeline.clustering.assign_radius`.
    """
    ours, theirs = _nodes(run), _nodes(reference)
    only_here = [name for name in ours if name not in theirs]
    added = {name for name in only_here if name in _hostile(run)}
    found = [name for name in (*only_here, *(name for name in theirs if name not in ours)) if name not in added]
    found += [
        key for key in _SETTINGS for key in _differing(key, *(each.scenario.get(key) for each in (run, reference)))
    ]
    for name in (name for name in ours if name in theirs):
        found += _differing(name, ours[name], theirs[name])
    found += _versions(run, reference)
    one_sided = {*found, *added}
    found += _of_pairs(*(_steps(each, one_sided) for each in (run, reference)))
    found += _of_pairs(*(_wires(each, one_sided) for each in (run, reference)))
    found += _of_pairs(*(_interceptions(each, added) for each in (run, reference)))
    found += _of_pairs(*(_failures(each) for each in (run, reference)))
    return tuple(dict.fromkeys(found))


def named(differences: tuple[str, ...]) -> str:
    """`a, b, c and 2 more`."""
    shown, more = list(differences[:_MOST_NAMED]), len(differences) - _MOST_NAMED
    return listed([*shown, f"{more} more"] if more > 0 else shown)


def hostile_nodes(run: RunFolder) -> frozenset[str]:
    """Adversaries, their coordinators, and all other interposers that are no links."""
    return frozenset(_hostile(run))


def _hostile(run: RunFolder) -> set[str]:
    sitting = {each.name for each in interposers(run) if not each.is_link}
    return sitting | {name for name in _names(run) if run.role(name) in _HOSTILE}


def _names(run: RunFolder) -> list[str]:
    """Every node of a run that can have an influence on its results."""
    known = [*run.scenario.get("nodes", {}), *run.run.get("nodes", {}), *(each.name for each in interposers(run))]
    return [name for name in dict.fromkeys(known) if run.role(name) not in _PASSIVE]


def _nodes(run: RunFolder) -> dict[str, dict[str, Any]]:
    """By node its settings; of one that scenario.json does not know, none."""
    specs = {name: dict(run.scenario.get("nodes", {}).get(name, {})) for name in _names(run)}
    settings = {name: {**(spec.pop("config", None) or {}), **spec} for name, spec in specs.items()}
    settings.get("evaluator", {}).pop("metrics", None)  # metrics of the user's own add rows and change none
    return settings


def _differing(name: str, here: Any, there: Any) -> Iterator[str]:
    """Where two settings differ; of two parts of different types, the part as a whole."""
    if here == there:
        return
    mappings = isinstance(here, Mapping) and isinstance(there, Mapping)
    if not mappings or here.get("type") != there.get("type"):
        yield name
        return
    for key in dict.fromkeys([*here, *there]):
        yield from _differing(f"{name}.{key}", here.get(key), there.get(key))


def _of_pairs(here: Mapping[str, Any], there: Mapping[str, Any]) -> list[str]:
    return [name for name in dict.fromkeys([*here, *there]) if here.get(name) != there.get(name)]


def _versions(run: RunFolder, reference: RunFolder) -> list[str]:
    """Packages of different versions, and files of algorithms that go by one name."""
    versions = [each.run.get("versions") or {} for each in (run, reference)]
    files = [{Path(path).name: path for path in each.scenario.get("modules", ())} for each in (run, reference)]
    known = [name for name in _of_pairs(*versions) if all(name in each for each in versions)]
    return [f"version of {name}" for name in known] + [
        name for name in files[0] if name in files[1] and files[0][name] != files[1][name]
    ]


def _steps(run: RunFolder, without: set[str]) -> dict[str, Any]:
    """By node, what the scenario does to its process."""
    steps: dict[str, Any] = {}
    for step in run.scenario.get("steps", ()):
        if step.get("node") not in without:
            steps.setdefault(f"steps of {step.get('node')}", []).append(step)
    return steps


def _wires(run: RunFolder, without: set[str]) -> dict[str, Any]:
    """By wire its nodes, as if those that only one of the runs has had never been on it."""
    passive = {name for name in run.run.get("nodes", {}) if run.role(name) in (*_PASSIVE, "evaluator")}
    gone = without | passive | {"recorder", "visualizer", "evaluator"}

    def kept(names: Any) -> list[str]:
        return [name for name in names if name not in gone]

    return {
        f"wire {wire['key']}": (
            wire.get("publisher"),
            kept(wire.get("subscribers", ())),
            kept(wire.get("interposers", ())),
            kept(ear["node"] for ear in wire.get("listeners", ())),
        )
        for wire in run.wiring.get("wires", ())
        if wire.get("publisher") not in gone
    }


def _interceptions(run: RunFolder, added: set[str]) -> dict[str, Any]:
    """By node, when it was put on wires and taken off while the run went on."""
    events: dict[str, Any] = {}
    for done in run.run.get("interceptions", ()):
        if done["node"] not in added:
            events.setdefault(done["node"], []).append((done["action"], done["frame"]))
    return events


def _failures(run: RunFolder) -> dict[str, Any]:
    """By node that is no adversary, which of its handlers failed and how often."""
    failed = {name: failures_of(node) for name, node in run.run.get("nodes", {}).items() if name not in _hostile(run)}
    return {
        f"failures of {name}": [(each["handler"], each["count"]) for each in entries]
        for name, entries in failed.items()
        if entries
    }
