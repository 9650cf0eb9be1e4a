"""What the matrix needs of one trial's metrics. Pure."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from mast_zenoh.study.numbers import ego

#: Scores of the ego's picture, per frame and in m.
SCORES = ("fn", "fp", "ospa_m")

#: The part `defence` of the metrics of a trial in which nothing lies and nothing is faulty, see `trial.evaluate`.
NO_LIES: dict[str, Any] = {
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
    lies:      numbers of observable and detected lies
    delays:    (s, whether it was suspended) of each agent with an observable lie, from that lie on
    suspicion: (greatest score, whether it lied) of each agent that was honest or lied
    state_seconds: s by conduct and state;  hours: of the run, 0 without trust;  frames: of the run
    alarms:    suspensions of honest agents;  fault_alarms: of faulty agents that did not lie
    wrongly_suspended: whether an agent that never lied was suspended, faulty or not
    framed:    whether an agent that was honest was suspended after the first lie of the run, and itself never lied
    outnumbered: share of the lies, by object and frame, of which liars have more viewers than honest agents; NaN: none
    """

    scores: Mapping[str, float]
    lies: tuple[int, int]
    delays: Sequence[tuple[float, bool]]
    suspicion: Sequence[tuple[float, bool]]
    state_seconds: Mapping[str, Mapping[str, float]]
    hours: float
    frames: int
    alarms: int
    fault_alarms: int
    wrongly_suspended: bool
    framed: bool
    outnumbered: float

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
        first_lie_s = min((each["first_lie_s"] for each in part["agents"].values()), default=math.inf)
        return cls(
            scores=scores,
            lies=(part["lies"]["observable"], part["lies"]["detected"]),
            delays=[(each["observed_s"], each["suspended_after_s"] is not None) for each in watched],
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
                suspension["conduct"] == "honest" and suspension["from_s"] >= first_lie_s
                for suspensions in never_lied
                for suspension in suspensions
            ),
            outnumbered=_number(part["outnumbered"]),
        )


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)
