"""Names the measured causes of a change: adversaries, links and faults, and the defence.

Over a reference run, a cause is named only if the runs differ in nothing but adversaries, errors increase, and the
adversary's changes can reach the estimate. A decrease has no cause.
"""

from __future__ import annotations

from collections.abc import Sequence

from mast_zenoh.report.narrative.changes import DISPLACED, MIN_CULPRIT_SHARE, Change, withheld_from
from mast_zenoh.report.narrative.other_differences import attacking_nodes, join_differences, other_differences
from mast_zenoh.report.narrative.phrases import amount, count, join_names
from mast_zenoh.report.narrative.reach import reaches
from mast_zenoh.report.runfolder import RunFolder
from mast_zenoh.report.tables.interposers import interposers

#: More adversaries than these are counted, not named.
_MAX_NAMED = 3


def due_to_causes(run: RunFolder, changes: Sequence[Change]) -> str:
    """`are due to adversary_1 and adversary_2`: measured causes shared by all changes."""
    singular = ("1 ", "1.0 ", "no ")
    one = len(changes) == 1 and (changes[0].kind == DISPLACED or amount(changes[0], run.ego).startswith(singular))
    return f"{'is' if one else 'are'} due to {join_names(causes(run, changes[0]))}"


def cause_clause(run: RunFolder, change: Change, reference: RunFolder) -> str:
    """`, due to adversary_1`: the cause of a change, or why none is named."""
    others = other_differences(run, reference)
    if others:
        also = "also " if attacking_nodes(run) - attacking_nodes(reference) else ""
        return f"; not attributed: the runs {also}differ in {join_differences(others)}"
    if change.amount <= 0.0:
        return ""
    names = causes(run, change, reference)
    return f", due to {join_names(names)}" if names else ", by no measured cause"


def causes(run: RunFolder, change: Change, reference: RunFolder | None = None) -> list[str]:
    """Adversaries, links, faults and the defence that cause a change.

    May be empty with a reference.

    reference: the run that the change is over; None: the change is from the run's own measurements
    """
    if reference is not None and (change.amount <= 0.0 or other_differences(run, reference)):
        return []
    by_name = {each.name: each for each in interposers(run)}
    culprits = culprit_names(run, change, reference)
    names = [by_name[name].description if name in by_name else name for name in culprits]
    descriptions = names if len(names) <= _MAX_NAMED else [f"{count(len(names))} adversaries"]
    own_displacement = reference is None and change.kind == DISPLACED and not descriptions
    if change.is_fault or own_displacement:
        descriptions = descriptions + _faults(run, any_effect=own_displacement and not change.is_fault)
    if change.is_withheld:
        descriptions = [*descriptions, _defence(run, change)]
    return descriptions or ["adversaries"] if reference is None else descriptions


def culprit_names(run: RunFolder, change: Change, reference: RunFolder | None = None) -> list[str]:
    """Adversaries that cause a change, those with the most rows first; may be empty.

    For a change over a run that differs in adversaries alone, these are all adversaries whose changes can reach the
    estimate, unless measurements of single objects narrow them down.
    """
    total = sum(change.by.values())
    acting = [each.name for each in interposers(run) if each.changed and not each.is_link]
    measured = [name for name, rows in change.by.most_common() if rows >= MIN_CULPRIT_SHARE * total] or acting
    if reference is None:
        return measured if change.is_attack else []
    if change.amount <= 0.0 or other_differences(run, reference):
        return []
    # Real-time runs also differ by timing, so only measured effects count.
    exact = run.scenario.get("mode", "lockstep") == "lockstep"
    candidates = measured if change.is_attack else acting if exact else []
    added = attacking_nodes(run) - attacking_nodes(reference)
    return [name for name in candidates if name in added and reaches(run, name, change.estimate, change.agent)]


def _defence(run: RunFolder, change: Change) -> str:
    """The integrity stage, and the agents of which it withheld what they reported."""
    agents = [name for name, _ in withheld_from(run, change.estimate).most_common()] if change.agent == run.ego else []
    of_whom = f"{count(len(agents))} agents" if len(agents) > _MAX_NAMED else join_names(sorted(agents))
    what = f"objects that {of_whom} reported" if agents else "objects"
    return f"{run.defence or 'the command centre'}, which withheld {what}"


def _faults(run: RunFolder, *, any_effect: bool = False) -> list[str]:
    """Links and faults in words; any_effect: only if links had a measured effect."""
    acting = [each for each in interposers(run) if each.is_link and each.changed]
    planned = [str(each["label"]) for each in run.timeline if each["kind"] != "attack"]
    if any_effect and not acting:
        return []
    if planned:
        return ["links and faults" if len(planned) > _MAX_NAMED else join_names(planned)]
    return ["links" if len(acting) > _MAX_NAMED else join_names([each.name for each in acting]) or "links and faults"]
