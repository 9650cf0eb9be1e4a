"""Cumulative sums of evidence, and when they are alarms."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mast_zenoh.arrays.states import Bools, Floats

#: Samples a second that the errors of tracks give independently; consecutive frames share theirs.
SAMPLES_PER_S = 1.1
#: s, after a suspension in which a fault that is found then excuses it.
EXCUSED_S = 1.0
#: s, greatest step of a sum: a batch after a gap is no more evidence than one.
MAX_STEP_S = 0.5


@dataclass(frozen=True, slots=True)
class Tail:
    """How often a statistic of an honest agent exceeds a value.

    per_hour: times an hour and agent that it exceeds 0, extrapolated from large values
    scale: change of the statistic that makes it e times rarer
    """

    per_hour: float
    scale: float

    def rate(self, statistic: Floats) -> Floats:
        """How often an hour, of one honest agent, a statistic of this size is exceeded."""
        return np.asarray(self.per_hour * np.exp(-np.minimum(statistic / self.scale, 700.0)))

    def value_at(self, per_hour: float) -> float:
        """The value that an honest agent exceeds `per_hour` times."""
        return float(self.scale * np.log(self.per_hour / per_hour))

    def alarm_at(self, per_hour: float) -> float:
        """The value from which a statistic is an alarm, at `per_hour` false ones: at least one scale."""
        return max(self.value_at(per_hour), self.scale)


def discoveries(rates: Floats, per_hour: float) -> Bools:
    """Which of m statistics are alarms, at `per_hour` false ones among all.

    rates: (...) m numbers, how often an hour an honest agent exceeds each

    The procedure of Benjamini and Hochberg (Journal of the Royal Statistical Society B, 1995), on rates instead of
    probabilities: the i rarest are alarms if the i-th is rarer than i / m times the permitted rate.
    """
    ordered = np.sort(rates, axis=None)
    m = len(ordered)
    passed = np.flatnonzero(ordered <= per_hour * np.arange(1, m + 1) / max(m, 1))
    return np.asarray(rates <= (ordered[passed[-1]] if len(passed) else -1.0))


def accumulate(total: Floats, evidence: Floats, allowance: float, dt: float) -> Floats:
    """Cumulative sums (Page, Biometrika 1954) after `dt` s with `evidence` a second; they never fall below 0.

    allowance: evidence a second that an honest agent gives
    """
    return np.maximum(0.0, total + dt * (evidence - allowance))
