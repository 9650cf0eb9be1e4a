"""Base class of trackers, and how far their measurements are from what they expect."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from mast_zenoh.arrays.chi_square import mean_bounds
from mast_zenoh.arrays.states import Detections, Ints, ObjectStates
from mast_zenoh.tracking.association import GATE
from mast_zenoh.tracking.view import SensorView

#: Degrees of freedom: the horizontal position.
DOF = 2
#: Factor between confidence and accuracy that matters, by default.
LIMIT = 2.0
#: Verdicts about an estimate or a tracker.
OVERCONFIDENT, OVERCAUTIOUS = "overconfident", "overcautious"


@dataclass(slots=True)
class Innovations:
    """Sums over the assigned pairs of a track and a measurement (docs/explanation-metrics-and-causes.md).

    total:  sum of normalised innovations squared of the horizontal position
    pairs:  number of pairs in `total`: those that steady motion explains
    sudden: number of other pairs, which a sudden displacement explains (`gating`)
    at_most: whether measurements were estimates themselves, with errors correlated with the tracks'. Covariance
            intersection then bounds the covariance of the innovation, so the expected value is at most DOF
    silent: number of steps in which measured tracks exist, but none is reported, as all are too uncertain
    """

    total: float = 0.0
    pairs: int = 0
    sudden: int = 0
    at_most: bool = False
    silent: int = 0

    def add(self, total: float, pairs: int, assigned: int) -> None:
        """Add `assigned` pairs, of which `pairs` without a sudden displacement have the sum `total`."""
        self.total += total
        self.pairs += pairs
        self.sudden += assigned - pairs

    def summary(self) -> dict[str, Any]:
        """Plain values for the results of a node; None where undefined, without pairs.

        Keys:
        nis, expected: mean over the pairs; that of a consistent tracker
        low, high: two-sided 95 % bounds of the mean of a consistent tracker
        factor, factor_low, factor_high: how many times larger innovations are than expected, with its 95 % interval:
            the estimate of greatest likelihood that takes sudden pairs as beyond the gate. Others beyond it are unknown
        pairs, sudden: pairs that steady motion explains; pairs that only a sudden displacement explains
        at_most: whether the expected mean is an upper limit, because the measurements are estimates themselves
        silent: number of steps in which measured tracks exist, but none is reported, as all are too uncertain
        verdict: `overconfident` or `overcautious` if the interval is beyond LIMIT or its inverse, else None

        Innovations of a consistent tracker are independent of each other (Bar-Shalom, Li, Kirubarajan 2001, 5.4.2), so
        every pair counts.
        """
        low, high = mean_bounds(self.pairs, DOF)
        factor = factor_low = factor_high = verdict = None
        if self.pairs:
            scale = math.sqrt((self.total + GATE.steady * self.sudden) / self.pairs)
            factor, factor_low = scale / math.sqrt(DOF), scale / math.sqrt(high)
            factor_high = scale / math.sqrt(low) if low else None
            if factor_low > LIMIT:
                verdict = OVERCONFIDENT
            elif factor_high is not None and factor_high < 1.0 / LIMIT and not self.at_most:
                verdict = OVERCAUTIOUS
        return {
            "nis": self.total / self.pairs if self.pairs else None,
            "expected": DOF,
            "low": 0.0 if self.at_most else low,
            "high": high if self.pairs else None,
            "factor": factor,
            "factor_low": factor_low,
            "factor_high": factor_high,
            "pairs": self.pairs,
            "sudden": self.sudden,
            "at_most": self.at_most,
            "silent": self.silent,
            "verdict": verdict,
        }

    @classmethod
    def from_summary(cls, value: object) -> Innovations | None:
        """The sums behind a summary that another node sent; None if it is none."""
        if not isinstance(value, Mapping):
            return None
        pairs, sudden, mean = value.get("pairs"), value.get("sudden"), value.get("nis")
        if type(pairs) is not int or type(sudden) is not int or pairs < 0 or sudden < 0:
            return None
        mean = 0.0 if mean is None and pairs == 0 else mean
        if not isinstance(mean, float) or not 0.0 <= mean < math.inf:
            return None
        silent = value.get("silent")
        silent = silent if type(silent) is int and silent > 0 else 0
        return cls(mean * pairs, pairs, sudden, value.get("at_most") is True, silent)


class Tracker(ABC):
    """Turns measurements at successive times into tracks with persistent ids.

    One tracker serves one agent, or the centre: `step` takes the detections of one sensor, `step_states` full states,
    such as fused ones. Both may be called on the same tracker, even for the same time.
    """

    #: how far measurements were from what the tracker expected, since the last `reset`; None: it does not tell
    innovations: Innovations | None = None

    @abstractmethod
    def step(self, time_ns: int, detections: Detections, view: SensorView | None = None) -> ObjectStates:
        """The confirmed tracks at `time_ns`, sorted by id.

        time_ns:    ns, not earlier than in the previous call (ValueError)
        detections: n detections in the tracker's frame of reference, a fixed one (the world frame)
        view:       of the sensor that measured, see `SensorView`; without it, every object counts as in view

        Ids are unique and never reused. The result does not depend on the order of the detections.
        """

    @abstractmethod
    def step_states(self, time_ns: int, measured: ObjectStates) -> ObjectStates:
        """As `step`, for n measured full states with positive definite covariances."""

    @property
    @abstractmethod
    def matched(self) -> Ints:
        """Input row (n,) that updated each track of the last result; -1: coasting."""

    @abstractmethod
    def reset(self) -> None:
        """Return to the initial state."""
