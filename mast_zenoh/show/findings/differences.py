"""In what two runs differ besides their adversaries."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Any

from mast_zenoh.runs.interposers import failures_of, hostile, interposers
from mast_zenoh.runs.run import Run

#: Roles of nodes that attack, and of nodes that do not affect results.
_HOSTILE, _PASSIVE = ("adversary", "coordinator"), ("recorder", "visualizer")
#: Keys of scenario.json, besides nodes, that affect results.
_SETTINGS = ("mode", "period_ns", "scene", "network")


def other_differences(run: Run, reference: Run) -> tuple[str, ...]:
    """Settings, nodes, wires and failures in which two runs differ, from scenario.json and wiring.json.

    Adversaries and coordinators that only `run` has, and their wires, are ignored. Empty: no other difference.
    A setting is named by its node and path: `command_center.pipeline.clustering.assign_radius`.
    """
    nodes, reference_nodes = _nodes(run), _nodes(reference)
    added = attacking_nodes(run) - reference_nodes.keys()
    differences = list(_differing({name: nodes[name] for name in nodes if name not in added}, reference_nodes))
    differences += _differing(_settings(run), _settings(reference))
    for here, there in zip(_code(run), _code(reference), strict=True):
        known = here.keys() & there  # what only one of them names may be the same
        differences += _differing(
            {name: here[name] for name in here if name in known}, {name: there[name] for name in known}
        )
    ignored = {*added, *differences, *_played(run), *_played(reference)}
    differences += _differing(_parts(run, added, ignored), _parts(reference, added, ignored), depth=1)
    return tuple(dict.fromkeys(differences))


def _settings(run: Run) -> dict[str, Any]:
    return {key: run.files.scenario.get(key) for key in _SETTINGS}


def attacking_nodes(run: Run) -> frozenset[str]:
    """Adversaries, their coordinators, and all other interposers except links."""
    return frozenset(
        {each.name for each in hostile(run)} | {name for name in _names(run) if run.role(name) in _HOSTILE}
    )


def _differing(here: Any, there: Any, path: str = "", depth: int = -1) -> Iterator[str]:
    """Dotted names of differing settings, at most `depth` names long; parts of different types differ as a whole."""
    if here == there:
        return
    mappings = isinstance(here, Mapping) and isinstance(there, Mapping)
    if not depth or not mappings or here.get("type") != there.get("type"):
        yield path
        return
    for key in dict.fromkeys([*here, *there]):
        yield from _differing(here.get(key), there.get(key), f"{path}.{key}" if path else key, depth - 1)


def _played(run: Run) -> list[str]:
    """The nodes of a replay that only send what was recorded."""
    return list((run.files.record.get("replay") or {}).get("played", ()))


def _names(run: Run) -> list[str]:
    """Every node of a run that can affect its results."""
    files = run.files
    known = [
        *files.scenario.get("nodes", {}),
        *files.record.get("nodes", {}),
        *(each.name for each in interposers(run)),
    ]
    return [name for name in dict.fromkeys(known) if run.role(name) not in _PASSIVE]


def _nodes(run: Run) -> dict[str, dict[str, Any]]:
    """Settings by node; empty for nodes that are not in scenario.json."""
    specs = {name: run.node_spec(name) for name in _names(run)}
    settings = {name: {**(spec.pop("config", None) or {}), **spec} for name, spec in specs.items()}
    settings.get("evaluator", {}).pop("metrics", None)  # a user's own metrics add rows without changing others
    return settings


def _code(run: Run) -> tuple[dict[str, Any], dict[str, Any]]:
    """The versions of packages, and the paths of files with algorithms by their names."""
    versions = {f"version of {name}": version for name, version in (run.files.record.get("versions") or {}).items()}
    return versions, {Path(path).name: path for path in run.files.scenario.get("modules", ())}


def _parts(run: Run, added: Collection[str], ignored: Collection[str]) -> dict[str, Any]:
    """Steps and live insertions by node, failed handlers, and the ends of wires; without ignored and passive nodes."""
    parts: dict[str, Any] = {}
    for step in run.files.scenario.get("steps", ()):
        if step.get("node") not in ignored:
            parts.setdefault(f"steps of {step.get('node')}", []).append(step)
    for event in run.files.record.get("interceptions", ()):
        if event["node"] not in added:
            parts.setdefault(event["node"], []).append((event["action"], event["frame"]))
    hostile, nodes = attacking_nodes(run), run.files.record.get("nodes", {})
    for name, node in nodes.items():
        if name not in hostile and (failed := failures_of(node)):
            parts[f"failures of {name}"] = [(each["handler"], each["count"]) for each in failed]
    listeners = {name for name in nodes if run.role(name) in (*_PASSIVE, "evaluator")}
    unseen = {*ignored, *listeners, *_PASSIVE, "evaluator"}
    for wire in run.files.wiring.get("wires", ()):
        ends = (
            wire.get("subscribers", ()),
            wire.get("interposers", ()),
            [x["node"] for x in wire.get("listeners", ())],
        )
        if wire.get("publisher") not in unseen:
            kept = [[name for name in names if name not in unseen] for names in ends]
            parts[f"wire {wire['key']}"] = (wire.get("publisher"), *kept)
    return parts
