"""What a change is due to, in words: adversaries, links and faults, and only where measurements and settings allow it.

Over another run a cause is named if nothing else differs than the adversaries, there are more errors than in the other
run, and what the adversary did can reach the estimate. A decrease has no cause.
"""

from __future__ import annotations

from collections.abc import Sequence

from mast_zenoh.report.narrative.changes import CULPRIT, DISPLACED, Change
from mast_zenoh.report.narrative.other_differences import hostile_nodes, named, other_differences
from mast_zenoh.report.narrative.phrases import amount, count, listed
from mast_zenoh.report.narrative.reach import reaches
from mast_zenoh.report.runfolder import RunFolder
from mast_zenoh.report.tables.interposers import interposers

#: More adversaries than these are counted, not named.
_MOST_NAMED = 3


def due(run: RunFolder, changes: Sequence[Change]) -> str:
    """`are due to adversary_1 and adversary_2`: of changes with the same causes, by the run's own measurements."""
    singular = ("1 ", "1.0 ", "no ")
    one = len(changes) == 1 and (changes[0].kind == DISPLACED or amount(changes[0], run.ego).startswith(singular))
    return f"{'is' if one else 'are'} due to {listed(causes(run, changes[0]))}"


def caused(run: RunFolder, change: Change, reference: RunFolder) -> str:
    """`, due to adversary_1`: of a change over another run; else what keeps a cause from being named."""
    others = other_differences(run, reference)
    if others:
        also = "also " if hostile_nodes(run) - hostile_nodes(reference) else ""
        return f"; not attributed: the runs {also}differ in {named(others)}"
    if change.amount <= 0.0:
        return ""
    found = causes(run, change, reference)
    return f", due to {listed(found)}" if found else ", by no measured cause"


def causes(run: RunFolder, change: Change, reference: RunFolder | None = None) -> list[str]:
    """The adversaries, links and faults that a change is due to; over another run there may be none.

    reference: the run that the change is over; None: the change is what the run's own measurements attribute
    """
    if reference is not None and (change.amount <= 0.0 or other_differences(run, reference)):
        return []
    known = {each.name: each for each in interposers(run)}
    culprits = culprit_names(run, change, reference)
    names = [known[name].description if name in known else name for name in culprits]
    found = names if len(names) <= _MOST_NAMED else [f"{count(len(names))} adversaries"]
    own_displacement = reference is None and change.kind == DISPLACED and not found
    if change.is_fault or own_displacement:
        found = found + _faults(run, any_effect=own_displacement and not change.is_fault)
    return found or ["adversaries"] if reference is None else found


def culprit_names(run: RunFolder, change: Change, reference: RunFolder | None = None) -> list[str]:
    """The adversaries that a change is due to, those with the most rows first; may be empty.

    Of a change over another run that differs in adversaries alone, these are all that did anything which can reach the
    estimate, unless measurements of single objects tell more.
    """
    total = sum(change.by.values())
    acting = [each.name for each in interposers(run) if each.changed and not each.is_link]
    measured = [name for name, rows in change.by.most_common() if rows >= CULPRIT * total] or acting
    if reference is None:
        return measured if change.is_attack else []
    if change.amount <= 0.0 or other_differences(run, reference):
        return []
    # In real time, runs differ also by what the wall clock did: only what was measured counts.
    exact = run.scenario.get("mode", "lockstep") == "lockstep"
    found = measured if change.is_attack else acting if exact else []
    added = hostile_nodes(run) - hostile_nodes(reference)
    return [name for name in found if name in added and reaches(run, name, change.estimate, change.agent)]


def _faults(run: RunFolder, *, any_effect: bool = False) -> list[str]:
    """What links and faults there are, in words; any_effect: only if links did anything by measurement."""
    acting = [each for each in interposers(run) if each.is_link and each.changed]
    planned = [str(each["label"]) for each in run.timeline if each["kind"] != "attack"]
    if any_effect and not acting:
        return []
    if planned:
        return ["links and faults" if len(planned) > _MOST_NAMED else listed(planned)]
    return ["links" if len(acting) > _MOST_NAMED else listed([each.name for each in acting]) or "links and faults"]
