"""Names the measured causes of a change: adversaries, links and faults, and the defence.

Over a reference run, a cause is named only if the runs differ in nothing but adversaries, errors increase, and the
adversary's changes can reach the estimate. A decrease has no cause.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from mast_zenoh.metrics.estimates import RECEIVED
from mast_zenoh.report.narrative.changes import (
    DISPLACED,
    MIN_CULPRIT_SHARE,
    Change,
    amount,
    count,
    join_names,
    witnesses_of_withheld,
)
from mast_zenoh.report.tables.wiring import all_wires
from mast_zenoh.runs.interposers import failures_of, interposers
from mast_zenoh.runs.run import Run


def reaches(run: Run, node: str, estimate: str, agent: str | None = None) -> bool:
    """Whether a node's messages can affect an estimate of an agent.

    agent: by default the ego

    True if its wires are not known.
    """
    places = _places(run, node)
    series, known = (agent or run.ego or "", estimate), run.estimate_wires
    return not places or any(known.enters_world(*place) or known.frames(*place, series) is not None for place in places)


def matters(run: Run, node: str) -> bool:
    """Whether an estimate, or the world, depends on what a node passes on; True if its wires are not known."""
    places = _places(run, node)
    return not places or any(run.estimate_wires.matters(*place) for place in places)


def _places(run: Run, node: str) -> list[tuple[str, str]]:
    """Where it ever was, live insertions included: the key of a wire, and the only subscriber before which it came."""
    places: list[tuple[str, str]] = []
    for wire in all_wires(run):
        if node in wire.get("interposers", ()) and wire["key"] in run.estimate_wires.influence.wires:
            legs = wire.get("legs", ())
            befores = {leg["before"]: None for leg in legs if leg.get("from") == node and leg.get("before")}
            places += [(wire["key"], each) for each in befores or [""]]
    return places


#: Roles of nodes that attack, and of nodes that do not affect results.
_HOSTILE, _PASSIVE = ("adversary", "coordinator"), ("recorder", "visualizer")
#: Keys of scenario.json, besides nodes, that affect results.
_SETTINGS = ("mode", "period_ns", "scene", "network")
#: Maximum number of names in a sentence; the others are counted.
_MAX_NAMED = 3


def other_differences(run: Run, reference: Run) -> tuple[str, ...]:
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
        key
        for key in _SETTINGS
        for key in _differing(key, *(each.files.scenario.get(key) for each in (run, reference)))
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


def attacking_nodes(run: Run) -> frozenset[str]:
    """Adversaries, their coordinators, and all other interposers except links."""
    return frozenset(_attackers(run))


def _played(run: Run) -> list[str]:
    """The nodes of a replay that only send what was recorded."""
    return list((run.files.record.get("replay") or {}).get("played", ()))


def _attackers(run: Run) -> set[str]:
    interposer_names = {each.name for each in interposers(run) if not each.is_link}
    return interposer_names | {name for name in _names(run) if run.role(name) in _HOSTILE}


def _names(run: Run) -> list[str]:
    """Every node of a run that can affect its results."""
    known = [
        *run.files.scenario.get("nodes", {}),
        *run.files.record.get("nodes", {}),
        *(each.name for each in interposers(run)),
    ]
    return [name for name in dict.fromkeys(known) if run.role(name) not in _PASSIVE]


def _nodes(run: Run) -> dict[str, dict[str, Any]]:
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


def _versions(run: Run, reference: Run) -> list[str]:
    """Packages with different versions, and algorithm files with different paths."""
    versions = [each.files.record.get("versions") or {} for each in (run, reference)]
    files = [{Path(path).name: path for path in each.files.scenario.get("modules", ())} for each in (run, reference)]
    known = [name for name in _differing_keys(*versions) if all(name in each for each in versions)]
    return [f"version of {name}" for name in known] + [
        name for name in files[0] if name in files[1] and files[0][name] != files[1][name]
    ]


def _steps(run: Run, excluded: set[str]) -> dict[str, Any]:
    """The scenario's steps by node."""
    steps: dict[str, Any] = {}
    for step in run.files.scenario.get("steps", ()):
        if step.get("node") not in excluded:
            steps.setdefault(f"steps of {step.get('node')}", []).append(step)
    return steps


def _wires(run: Run, excluded: set[str]) -> dict[str, Any]:
    """The nodes of each wire, without `excluded` nodes and listeners."""
    passive = {name for name in run.files.record.get("nodes", {}) if run.role(name) in (*_PASSIVE, "evaluator")}
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
        for wire in run.files.wiring.get("wires", ())
        if wire.get("publisher") not in ignored
    }


def _interceptions(run: Run, added: set[str]) -> dict[str, Any]:
    """Live insertions and releases by node, as (action, frame)."""
    events: dict[str, Any] = {}
    for event in run.files.record.get("interceptions", ()):
        if event["node"] not in added:
            events.setdefault(event["node"], []).append((event["action"], event["frame"]))
    return events


def _failures(run: Run) -> dict[str, Any]:
    """Failed handlers and their counts by node, without attackers."""
    failed = {
        name: failures_of(node)
        for name, node in run.files.record.get("nodes", {}).items()
        if name not in _attackers(run)
    }
    return {
        f"failures of {name}": [(each["handler"], each["count"]) for each in entries]
        for name, entries in failed.items()
        if entries
    }


#: More adversaries than these are counted, not named.
_MAX_CULPRITS = 3


def due_to_causes(run: Run, changes: Sequence[Change]) -> str:
    """`are due to adversary_1 and adversary_2`: measured causes shared by all changes."""
    singular = ("1 ", "1.0 ", "no ")
    one = len(changes) == 1 and (changes[0].kind == DISPLACED or amount(run, changes[0]).startswith(singular))
    return f"{'is' if one else 'are'} due to {join_names(causes(run, changes[0]))}"


def cause_clause(run: Run, change: Change, reference: Run) -> str:
    """`, due to adversary_1`: the cause of a change, or why none is named."""
    others = other_differences(run, reference)
    if others:
        also = "also " if attacking_nodes(run) - attacking_nodes(reference) else ""
        return f"; not attributed: the runs {also}differ in {join_names(others, _MAX_NAMED)}"
    if change.amount <= 0.0:
        return ""
    names = causes(run, change, reference)
    return f", due to {join_names(names)}" if names else ", by no measured cause"


def causes(run: Run, change: Change, reference: Run | None = None) -> list[str]:
    """Adversaries, links, faults and the defence that cause a change.

    May be empty with a reference.

    reference: the run that the change is over; None: the change is from the run's own measurements
    """
    if reference is not None and (change.amount <= 0.0 or other_differences(run, reference)):
        return []
    by_name = {each.name: each for each in interposers(run)}
    culprits = culprit_names(run, change, reference)
    names = [by_name[name].description if name in by_name else name for name in culprits]
    descriptions = names if len(names) <= _MAX_CULPRITS else [f"{count(len(names))} adversaries"]
    own_displacement = reference is None and change.kind == DISPLACED and not descriptions
    if change.due_to("fault") or own_displacement:
        descriptions = descriptions + _faults(run, any_effect=own_displacement and not change.due_to("fault"))
    if change.due_to("withheld"):
        descriptions = [*descriptions, _defence(run, change)]
    return descriptions or ["adversaries"] if reference is None else descriptions


def culprit_names(run: Run, change: Change, reference: Run | None = None) -> list[str]:
    """Adversaries that cause a change, those with the most rows first; may be empty.

    For a change over a run that differs in adversaries alone, these are all adversaries whose changes can reach the
    estimate, unless measurements of single objects narrow them down.
    """
    total = sum(change.by.values())
    acting = [
        each.name
        for each in interposers(run)
        if each.changed and not each.is_link and (change.estimate != RECEIVED or change.agent in each.agents)
    ]
    measured = [name for name, rows in change.by.most_common() if rows >= MIN_CULPRIT_SHARE * total] or acting
    if reference is None:
        return measured if change.due_to("attack") else []
    if change.amount <= 0.0 or other_differences(run, reference):
        return []
    # Real-time runs also differ by timing, so only measured effects count.
    exact = run.files.scenario.get("mode", "lockstep") == "lockstep"
    candidates = measured if change.due_to("attack") else acting if exact else []
    added = attacking_nodes(run) - attacking_nodes(reference)
    return [name for name in candidates if name in added and reaches(run, name, change.estimate, change.agent)]


def _defence(run: Run, change: Change) -> str:
    """The integrity stage, and how many agents that were not suspended reported what it withheld."""
    witnesses = witnesses_of_withheld(run, change.estimate) if change.agent == run.ego else []
    what = "objects"
    if witnesses:
        fewest, most = min(witnesses), max(witnesses)
        number = count(most) if fewest == most else f"on average {sum(witnesses) / len(witnesses):.1f}"
        agents = "agent that was not suspended" if (fewest, most) == (1, 1) else "agents that were not suspended"
        if sum(witnesses) < 0.05 * len(witnesses):
            number, agents = "almost only" if most else "only", "suspended agents"
        what += f" that {number} {agents} reported"
    return f"{run.defence or 'the command centre'}, which withheld {what}"


def _faults(run: Run, *, any_effect: bool = False) -> list[str]:
    """Links and faults in words; any_effect: only if links had a measured effect."""
    acting = [each for each in interposers(run) if each.is_link and each.changed]
    planned = [str(each["label"]) for each in run.timeline if each["kind"] != "attack"]
    planned += [
        f"the loss of {node}" for node in dict.fromkeys(event["node"] for event in run.files.record.get("churn") or ())
    ]
    if any_effect and not acting:
        return []
    if planned:
        return ["links and faults" if len(planned) > _MAX_CULPRITS else join_names(planned)]
    return [
        "links" if len(acting) > _MAX_CULPRITS else join_names([each.name for each in acting]) or "links and faults"
    ]
