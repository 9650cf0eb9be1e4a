"""Normalised innovations squared of a tracker: whether its measurements are as far off as it expects."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from mast_zenoh.arrays.chi_square import mean_bounds
from mast_zenoh.tracking.gating import GATE

#: Degrees of freedom: the horizontal position.
DOF = 2
#: Factor between confidence and accuracy that matters, by default.
LIMIT = 2.0
#: Verdicts about an estimate or a tracker.
OVERCONFIDENT, OVERCAUTIOUS = "overconfident", "overcautious"
#: Factors beyond this are not told apart: the gate leaves hardly any trace of them.
_MAX_FACTOR = 10.0


@dataclass(slots=True)
class Innovations:
    """Sums over the assigned pairs of a track and a measurement (docs/metrics.md#confidence-and-accuracy).

    total:  sum of normalised innovations squared of the horizontal position
    pairs:  number of pairs in `total`: those that steady motion explains
    sudden: number of other pairs, which a sudden displacement explains (`gating`)
    at_most: whether measurements were estimates themselves, with errors correlated with the tracks'. Covariance
            intersection then bounds the covariance of the innovation, so the expected value is at most DOF
    """

    total: float = 0.0
    pairs: int = 0
    sudden: int = 0
    at_most: bool = False

    def add(self, total: float, pairs: int, assigned: int) -> None:
        """Add `assigned` pairs, of which `pairs` without a sudden displacement have the sum `total`."""
        self.total += total
        self.pairs += pairs
        self.sudden += assigned - pairs

    def summary(self) -> dict[str, Any]:
        """Plain values for the results of a node; None where undefined, without pairs.

        nis: mean;  expected;  low, high: two-sided 95 % bounds of the mean of a consistent tracker
        factor, factor_low, factor_high: how many times larger innovations are than expected, with its 95 % interval.
            None: at least _MAX_FACTOR, or unknown
        verdict: "overconfident" or "overcautious" if the interval is beyond LIMIT or its inverse, else None

        Innovations of a consistent tracker are independent of each other (Bar-Shalom, Li, Kirubarajan 2001, 5.4.2), so
        every pair counts.
        """
        low, high = mean_bounds(self.pairs, DOF)
        known = self.pairs > 0
        mean = self.total / self.pairs if known else 0.0
        factors = [untruncated_factor(value) for value in (mean, mean * DOF / high, mean * DOF / low if low else 0.0)]
        factor, factor_low, factor_high = factors if known else [None, None, None]
        verdict = None
        if known and (factor_low is None or factor_low > LIMIT):
            verdict = OVERCONFIDENT
        elif known and low and not self.at_most and factor_high is not None and factor_high < 1.0 / LIMIT:
            verdict = OVERCAUTIOUS
        return {
            "nis": mean if known else None,
            "expected": DOF,
            "low": 0.0 if self.at_most else low,
            "high": high if known else None,
            "factor": factor,
            "factor_low": factor_low,
            "factor_high": factor_high if low else None,
            "pairs": self.pairs,
            "sudden": self.sudden,
            "at_most": self.at_most,
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
        return cls(mean * pairs, pairs, sudden, value.get("at_most") is True)


def untruncated_factor(mean: float) -> float | None:
    """Ratio of actual to expected innovations from their mean normalised square; None: at least _MAX_FACTOR.

    With a ratio of k the values have the mean 2 k^2 and an exponential distribution, of which the gate removes the part
    beyond GATE.steady.
    """
    gate = GATE.steady

    def expected_mean(factor: float) -> float:
        scale = DOF * factor**2
        return scale - gate / math.expm1(gate / scale) if scale > gate / 700.0 else scale

    if mean >= expected_mean(_MAX_FACTOR):
        return None
    low, high = 0.0, _MAX_FACTOR
    for _ in range(50):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if expected_mean(middle) > mean else (middle, high)
    return 0.5 * (low + high)
