"""What the matrix of defences needs of each trial, and its measures over groups of trials. Pure.

A group holds the records of one pair of scene and seed: one for a cell, several for a defence. Groups are the trials of
`intervals`: runs of the same scene and seed are not independent.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mast_zenoh.arrays.states import Floats, Ints
from mast_zenoh.metrics.measures import COLUMNS
from mast_zenoh.metrics.study_results import DefenceRoc, Measured, Survival
from mast_zenoh.metrics.trust import auc, partial_auc, roc
from mast_zenoh.study.defences import intervals
from mast_zenoh.study.defences.intervals import kaplan_meier
from mast_zenoh.study.numbers import ego

#: False alarms per hour below which the partial area under the characteristic is taken.
ALARMS_PER_HOUR = 1.0
#: Liars are below the local majority in a trial if they outnumber the honest viewers of fewer than this share of the
#: lies that an honest agent could notice.
MAJORITY = 0.5

#: Scores of the ego's picture, per frame and in m.
SCORES = ("fn", "fp", "ospa_m")

#: The part `defence` of the metrics of a trial in which nothing lies and nothing is faulty, see `evaluate`.
NO_LIES: dict[str, Any] = {
    "first_attack_s": None,
    "lies": {"all": 0, "observable": 0, "detected": 0},
    "agents": {},
    "false": {"identifiable": 0.0, "unidentifiable": 0.0},
    "honest_majority": 1.0,
    "outnumbered": None,
}


@dataclass(frozen=True, slots=True, kw_only=True)
class TrialRecord:
    """What the matrix needs of one trial's metrics.

    scores:    fn, fp per frame and ospa_m of the ego's picture, false objects inserted and identifiable or not
    own:       the user's metrics of the ego's picture
    attacked:  whether an adversary changed a message
    lies:      numbers of observable and detected lies
    delays:    (s, whether it was suspended) of each agent with an observable lie, from that lie on
    suspended_before: number of agents that were suspended already at that lie, which have no delay
    suspicion: (greatest score, whether it lied) of each agent that was honest or lied
    state_seconds: s by conduct and state;  hours: of the run, 0 without trust;  frames: of the run
    alarms:    suspensions of honest agents;  fault_alarms: of faulty agents that did not lie
    wrongly_suspended: whether an agent that never lied was suspended, faulty or not
    framed:    whether an agent that was honest was suspended after the attack began, and itself never lied
    outnumbered: share of the lies, by object and frame, of which liars have more viewers than honest agents; NaN: none
    """

    scores: dict[str, float]
    own: Mapping[str, float]
    attacked: bool
    lies: tuple[int, int]
    delays: Sequence[tuple[float, bool]]
    suspended_before: int
    suspicion: Sequence[tuple[float, bool]]
    state_seconds: Mapping[str, Mapping[str, float]]
    hours: float
    frames: int
    alarms: int
    fault_alarms: int
    wrongly_suspended: bool
    framed: bool
    outnumbered: float

    def __getitem__(self, name: str) -> float:
        """A score, or the user's metric of this name; NaN: it has none."""
        return self.scores.get(name, self.own.get(name, math.nan))

    @classmethod
    def of(cls, metrics: Mapping[str, Any]) -> TrialRecord:
        """The record of a trial from its metrics.json with the part `defence`."""
        part, trust = metrics["defence"], metrics.get("integrity", {})
        picture = metrics["agents"][ego(metrics)]["picture"]
        scores = {name: _number(picture[name]["mean"]) for name in SCORES}
        scores |= {f"fp_{name}": value for name, value in part["false"].items()}
        scores["honest_majority"] = part["honest_majority"]
        watched = [each for each in part["agents"].values() if each["observed_s"] is not None]
        judged = list(trust.get("agents", {}).values())
        never_lied = [each["suspensions"] for each in judged if not each["lied"]]
        noticeable = [name for name, each in part["agents"].items() if each["first_observable_s"] is not None]
        begins_s = math.inf if part["first_attack_s"] is None else part["first_attack_s"]
        return cls(
            scores=scores,
            own=own_metrics(picture),
            attacked=part["first_attack_s"] is not None,
            lies=(part["lies"]["observable"], part["lies"]["detected"]),
            delays=[(each["observed_s"], each["suspended_after_s"] is not None) for each in watched],
            suspended_before=len([name for name in noticeable if name in trust.get("agents", {})]) - len(watched),
            suspicion=[
                (_number(each["suspicion"]["max"]), each["lied"])
                for each in judged
                if each["lied"] or not each.get("faulty")
            ],
            state_seconds=trust.get("seconds", {}),
            hours=trust.get("hours", 0.0),
            frames=metrics["frames"],
            alarms=trust.get("false_alarms", 0),
            fault_alarms=sum(each["fault_alarms"] for each in judged),
            wrongly_suspended=any(never_lied),
            framed=any(
                suspension["conduct"] == "honest" and suspension["from_s"] >= begins_s
                for suspensions in never_lied
                for suspension in suspensions
            ),
            outnumbered=_number(part["outnumbered"]),
        )


def own_metrics(summary: Mapping[str, Any]) -> dict[str, float]:
    """The user's metrics of an estimate in metrics.json."""
    own = {name: value for name, value in summary.items() if name not in COLUMNS}
    return {name: _number(value["mean"] if isinstance(value, Mapping) else value) for name, value in own.items()}


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)


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


def attacked_share(groups: Groups) -> Measured:
    """The share of runs in which adversaries lied, which some never do."""
    return intervals.share_of_runs([[record.attacked for record in group] for group in groups])


def shares_of_runs(groups: Groups) -> dict[str, Measured]:
    """The share of runs in which something happened, of those in which it can happen: with lies or without."""

    def share(happened: Callable[[TrialRecord], bool], counts: Callable[[TrialRecord], bool]) -> Measured:
        return intervals.share_of_runs(
            [[happened(each) for each in group if each.hours and counts(each)] for group in groups]
        )

    return {
        "wrongly_suspended": share(lambda each: each.wrongly_suspended, lambda each: not each.attacked),
        "honest_suspended": share(lambda each: each.alarms > 0, lambda each: True),
        "framed": share(lambda each: each.framed, lambda each: each.attacked),
        "framed_by_minority": share(lambda each: each.framed, lambda each: each.outnumbered < MAJORITY),
        "framed_by_majority": share(lambda each: each.framed, lambda each: each.outnumbered >= MAJORITY),
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

    whole = intervals.pooled(area, len(parts))
    enough = hours.sum() * ALARMS_PER_HOUR >= 1.0  # a single alarm in less is more than that
    below = intervals.pooled(partial, len(parts)) if enough else Measured()
    return DefenceRoc(defence, roc(pairs[:, 0], pairs[:, 1]), whole, below, float(hours.sum()))


def judges(groups: Groups) -> bool:
    """Whether agents are judged in any run."""
    return any(record.hours for group in groups for record in group)


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
    sums = {state: np.array([sum(each.get(state, 0.0) for each in group) for group in seconds]) for state in states}
    whole = np.sum(list(sums.values()), axis=0)
    return {state: intervals.share(part, whole) for state, part in sums.items()} if whole.any() else {}
