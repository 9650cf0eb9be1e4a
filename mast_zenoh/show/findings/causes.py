"""The measured causes of a change: adversaries, links and faults, and the defence.

Over a reference run, a cause is named only if the runs differ in nothing but adversaries, errors increase, and the
adversary's changes can reach the estimate. A decrease has no cause.
"""

from __future__ import annotations

import numpy as np

from mast_zenoh.arrays.states import Floats
from mast_zenoh.metrics.estimates import RECEIVED
from mast_zenoh.runs.interposers import all_wires, hostile, interposers
from mast_zenoh.runs.run import Run
from mast_zenoh.scenario.timeline import acts_at
from mast_zenoh.show.comparison import Reference
from mast_zenoh.show.findings.changes import DISPLACED, MIN_CULPRIT_SHARE, Change, witnesses_of_withheld
from mast_zenoh.show.findings.differences import attacking_nodes, other_differences
from mast_zenoh.wiring.model import link_of

#: More adversaries, links or faults than these are counted, not named.
_MOST_NAMED = 3


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


def changed_for_nothing(run: Run, node: str) -> list[str]:
    """The wires on which a node changed messages, and no estimate depends on them there; those that are known."""
    table = run.files.effects
    if table is None:
        return []
    of_node = (table["interposer"] == node) & (table["effect"] != "unsettled")
    changed = set(np.unique(table["wire"][of_node]).tolist())
    used = {key for key, before in _places(run, node) if run.estimate_wires.matters(key, before)}
    return [key for key in dict.fromkeys(key for key, _ in _places(run, node)) if key in changed - used]


def _places(run: Run, node: str) -> list[tuple[str, str]]:
    """Where it ever was, live insertions included: the key of a wire, and the only subscriber before which it came."""
    places: list[tuple[str, str]] = []
    for wire in all_wires(run):
        if node in wire.get("interposers", ()) and wire["key"] in run.estimate_wires.influence.wires:
            legs = wire.get("legs", ())
            befores = {leg["before"]: None for leg in legs if leg.get("from") == node and leg.get("before")}
            places += [(wire["key"], each) for each in befores or [""]]
    return places


def causes(run: Run, change: Change, over: Reference | None = None) -> tuple[str, ...]:
    """Adversaries, links, faults and the defence that cause a change; may be empty with a reference.

    over: the run that the change is over; None: the change is from the run's own measurements
    """
    if over is not None and (change.amount <= 0.0 or other_differences(run, over.run)):
        return ()
    descriptions = {each.name: each.description for each in interposers(run)}
    culprits = culprit_names(run, change, over)
    named = [descriptions.get(name, name) for name in culprits]
    if len(named) > _MOST_NAMED:
        named = [f"{len(named)} adversaries"]
    own_displacement = over is None and change.kind == DISPLACED and not named
    if change.due_to("fault") or own_displacement:
        named += _faults(run, change, any_effect=own_displacement and not change.due_to("fault"))
    if change.due_to("withheld"):
        number = witnesses_of_withheld(run, change.estimate) if change.agent == run.ego else None
        by = "" if number is None else f" that on average {number:.1f} agents that were not suspended reported"
        named.append(f"{run.defence or 'the command centre'}, which withheld objects{by}")
    return tuple(named or ([] if over is not None else ["adversaries"]))


def culprit_names(run: Run, change: Change, over: Reference | None = None) -> list[str]:
    """Adversaries that cause a change, those with the most rows first; may be empty.

    For a change over a run that differs in adversaries alone, these are all adversaries whose changes can reach the
    estimate, unless measurements of single objects narrow them down.
    """
    total = sum(change.by.values())
    acting = [
        each.name
        for each in hostile(run)
        if each.changed and (change.estimate != RECEIVED or change.agent in each.agents)
    ]
    measured = [name for name, rows in change.by.most_common() if rows >= MIN_CULPRIT_SHARE * total] or acting
    if over is None:
        return measured if change.due_to("attack") else []
    if change.amount <= 0.0 or other_differences(run, over.run):
        return []
    # Real-time runs also differ by timing, so only measured effects count.
    exact = run.files.scenario.get("mode", "lockstep") == "lockstep"
    candidates = measured if change.due_to("attack") else acting if exact else []
    added = attacking_nodes(run) - attacking_nodes(over.run)
    return [name for name in candidates if name in added and reaches(run, name, change.estimate, change.agent)]


def _faults(run: Run, change: Change, *, any_effect: bool) -> list[str]:
    """Links and faults in words, of links those whose measured effects can reach the estimate.

    A fault on links is named if one of them changed a message while it lasted, and a link if it did so at other times.
    any_effect: only if links had a measured effect
    """
    linking = [each.name for each in interposers(run) if each.is_link and each.changed]
    acted = {name: _acted_s(run, name) for name in linking if reaches(run, name, change.estimate, change.agent)}
    if any_effect and not acted:
        return []
    named, alone = [], {name: np.ones(len(times_s), np.bool_) for name, times_s in acted.items()}
    for each in run.timeline:
        if each["kind"] == "attack":
            continue
        links = {link_of(place) for place in each.get("nodes") or ()}
        during = {name: acts_at(each, times_s) for name, times_s in acted.items() if name in links}
        if each.get("backend") != "links" or any(rows.any() for rows in during.values()):
            named.append(str(each["label"]))
        for name, rows in during.items():
            alone[name] &= ~rows
    lost = dict.fromkeys(event["node"] for event in run.files.record.get("churn") or ())
    named += [f"the loss of {node}" for node in lost] + [name for name, rows in alone.items() if rows.any()]
    return named if 0 < len(named) <= _MOST_NAMED else ["links and faults"]


def _acted_s(run: Run, link: str) -> Floats:
    """The times, s, of the frames whose messages a link changed; as far as they are known."""
    table = run.files.effects
    if table is None:
        return np.zeros(0)
    of_link = (table["interposer"] == link) & (table["effect"] != "unsettled") & (table["frame"] >= 0)
    return run.times(np.unique(table["frame"][of_link]))
