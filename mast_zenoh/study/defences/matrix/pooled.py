"""Numbers over the trials of a cell, or of all cells of a defence. Pure.

A group holds the records of one pair of scene and seed: one for a cell, several for a defence. Groups are the trials of
`intervals`: runs of the same scene and seed are not independent.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from mast_zenoh.arrays.states import Floats, Ints
from mast_zenoh.metrics.study_results import DefenceRoc, Measured, Survival
from mast_zenoh.metrics.trust import auc, partial_auc, roc
from mast_zenoh.study.defences import intervals
from mast_zenoh.study.defences.matrix.records import TrialRecord
from mast_zenoh.study.defences.survival import kaplan_meier

#: False alarms per hour below which the partial area under the characteristic is taken.
ALARMS_PER_HOUR = 1.0
#: Liars are below the local majority in a trial if they outnumber the honest viewers of fewer than this share of the
#: lies that an honest agent could notice.
MAJORITY = 0.5

Groups = Sequence[Sequence[TrialRecord]]


def lies_detected(groups: Groups) -> Measured:
    """The share of observable lies that were detected."""
    lies = np.array([[sum(record.lies[index] for record in group) for group in groups] for index in (0, 1)])
    return intervals.share(lies[1], lies[0])


def median_delay(groups: Groups) -> Measured:
    """The median delay; its upper bound is infinite if it is not known that half are detected."""
    delays = [each for each in _delays(groups) if len(each)]

    def median(rows: Ints) -> float:
        drawn = np.concatenate([delays[row] for row in rows.tolist()])
        value = kaplan_meier(drawn[:, 0], drawn[:, 1]).median_s
        return math.inf if math.isnan(value) else value

    measured = intervals.pooled(median, len(delays))
    return measured._replace(value=math.nan) if math.isinf(measured.value) else measured


def delay_curve(groups: Groups) -> Survival | None:
    """The share of liars not suspended yet; None: nobody lied, or nobody was judged."""
    delays = np.concatenate([np.zeros((0, 2)), *_delays(groups)])
    if not len(delays):
        return None
    return kaplan_meier(delays[:, 0], delays[:, 1])


def alarms_per_hour(groups: Groups, *, faulty: bool = False) -> Measured:
    """Suspensions of honest agents, or of faulty ones."""
    records = [record for group in groups for record in group if record.hours]
    events = sum(record.fault_alarms if faulty else record.alarms for record in records)
    return intervals.rate(events, sum(record.hours for record in records), len(records))


def shares_of_runs(groups: Groups, *, lies: bool) -> dict[str, Measured]:
    """The share of runs in which something happened, of those in which it can happen.

    lies: whether agents lie in these runs
    """

    def share(happened: Callable[[TrialRecord], bool], counts: Callable[[TrialRecord], bool]) -> Measured:
        return intervals.share_of_runs(
            [[happened(each) for each in group if each.hours and counts(each)] for group in groups]
        )

    return {
        "wrongly_suspended": share(lambda each: each.wrongly_suspended, lambda each: not lies),
        "framed": share(lambda each: each.framed, lambda each: lies),
        "framed_by_minority": share(lambda each: each.framed, lambda each: lies and each.outnumbered < MAJORITY),
        "framed_by_majority": share(lambda each: each.framed, lambda each: lies and each.outnumbered >= MAJORITY),
    }


def state_shares(groups: Groups) -> dict[str, dict[str, Measured]]:
    """By conduct and state of trust, the share of the time with this conduct."""
    conducts = dict.fromkeys(name for group in groups for record in group for name in record.state_seconds)
    return {conduct: shares for conduct in conducts if (shares := _states(groups, conduct))}


def characteristic(defence: str, groups: Groups) -> DefenceRoc | None:
    """The characteristic of one score for each agent and run; None if nobody lied, or scores are equal or unknown."""
    judged = [group for group in groups if any(record.hours for record in group)]
    parts = [np.array([pair for record in group for pair in record.suspicion]).reshape(-1, 2) for group in judged]
    hours = np.array([sum(record.hours for record in group) for group in judged])
    pairs = np.concatenate([np.zeros((0, 2)), *parts])
    if not pairs[:, 1].any() or len(set(pairs[~np.isnan(pairs[:, 0]), 0].tolist())) < 2:
        return None

    def area(rows: Ints) -> float:
        drawn = np.concatenate([parts[row] for row in rows.tolist()])
        return auc(drawn[:, 0], drawn[:, 1])

    def partial(rows: Ints) -> float:
        drawn = np.concatenate([parts[row] for row in rows.tolist()])
        return partial_auc(drawn[:, 0], drawn[:, 1], float(hours[rows].sum()), ALARMS_PER_HOUR)

    whole, below = (intervals.pooled(statistic, len(parts), (0.0, 1.0)) for statistic in (area, partial))
    return DefenceRoc(defence, roc(pairs[:, 0], pairs[:, 1]), whole, below, float(hours.sum()))


def _delays(groups: Groups) -> list[Floats]:
    """(n, 2) delays s, and whether each ended with a suspension, of each group."""
    return [
        np.array([each for record in group for each in record.delays], np.float64).reshape(-1, 2) for group in groups
    ]


def _states(groups: Groups, conduct: str) -> dict[str, Measured]:
    """The shares of states; {} if no agent behaved like this."""
    seconds = [
        [record.state_seconds[conduct] for record in group if conduct in record.state_seconds] for group in groups
    ]
    states = dict.fromkeys(state for group in seconds for each in group for state in each)
    sums = {state: np.array([sum(each[state] for each in group) for group in seconds]) for state in states}
    whole = np.sum(list(sums.values()), axis=0)
    return {state: intervals.share(part, whole) for state, part in sums.items()} if whole.any() else {}
