"""Consistency: whether estimates are as accurate as their covariances say.

Normalised estimation error squared (NEES; Bar-Shalom, Li, Kirubarajan 2001, section 5.4) of matched pairs of a track
and a truth object. Pure; docs/explanation-metrics-and-causes.md.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from mast_zenoh.arrays.chi_square import TWO_SIDED, mean_bounds
from mast_zenoh.arrays.states import Floats, Ints
from mast_zenoh.metrics.estimates import LOCAL, MISSION, PICTURE, RECEIVED, rank_of
from mast_zenoh.metrics.scores import MatchedPairs
from mast_zenoh.tracking.base import LIMIT, OVERCAUTIOUS, OVERCONFIDENT

#: Degrees of freedom of both quantities: two horizontal axes.
DOF = 2
#: Median of a chi-square distribution with two degrees of freedom.
MEDIAN = 2.0 * math.log(2.0)
#: Greater values count as this, so that sums are finite: a factor of a million.
MAX_NEES = 2e12


@dataclass(frozen=True, slots=True, kw_only=True)
class Consistency:
    """Settings for the comparison of errors with covariances.

    samples_per_s: independent samples that the errors of one track give per second: consecutive frames share theirs
    limit: factor between confidence and accuracy that matters: above it, an estimate is
        overconfident, below its inverse overcautious
    Raises ValueError for samples_per_s that are not positive, and for a limit below 1.
    """

    samples_per_s: float = 1.1
    limit: float = LIMIT

    def __post_init__(self) -> None:
        if not self.samples_per_s > 0.0:
            raise ValueError(f"samples_per_s: found {self.samples_per_s}, expected more than 0")
        if not self.limit >= 1.0:
            raise ValueError(f"limit: found {self.limit}, expected at least 1")

    def summary(
        self,
        pairs: MatchedPairs,
        series: Sequence[tuple[str, str]],
        pictures: Collection[str],
        scored: slice,
        period_s: float,
    ) -> dict[str, dict[str, dict[str, Any]]]:
        """NEES of position and velocity by agent and estimate; see `nees_summary`.

        Of every agent's own tracks, as sent and as received; of the mission estimates; and of pictures.

        pairs: of the rows of `series`, (agent, estimator)
        pictures: agents whose picture counts: one of those that share it, all of those that have their own
        scored: the frames that count
        """
        of_series = {each: deviations(pairs, row, scored) for row, each in enumerate(series)}
        return self.of(of_series, np.unique(pairs.truth.boxes.id), pictures, period_s)

    def of(
        self,
        series: Mapping[tuple[str, str], PairDeviations],
        objects: Ints,
        pictures: Collection[str],
        period_s: float,
    ) -> dict[str, dict[str, dict[str, Any]]]:
        """As `summary`, of deviations by (agent, estimator); objects: (k,) ascending ids of all objects."""
        result: dict[str, dict[str, dict[str, Any]]] = {agent: {} for agent, _ in series}
        for agent, estimator in sorted(series, key=lambda each: rank_of(each[1])):
            if counts(agent, estimator, pictures):
                _, ids, position, velocity = series[agent, estimator]
                of = np.searchsorted(objects, ids)
                result[agent][estimator] = {
                    "position": self.nees_summary(position, of, period_s),
                    "velocity": self.nees_summary(velocity, of, period_s),
                }
        return result

    def nees_summary(self, values: Floats, objects: Ints, period_s: float) -> dict[str, Any]:
        """Plain values; None where undefined.

        values: (n,) NEES, NaN without a usable covariance;  objects: (n,) their numbers, from 0
        period_s: s from frame to frame

        Keys:
        nees, expected: mean over the pairs; that of a consistent estimate
        low, high: two-sided 95 % bounds of the mean of a consistent estimate
        factor: how many times more confident than accurate: sqrt(nees / expected); below 1: less
        factor_low, factor_high: its 95 % interval
        typical_factor, typical_low, typical_high: the same from the median
        pairs, objects: how many count
        samples: independent ones among the pairs
        without_covariance: pairs that are left out, because the covariance is not positive definite
        verdict: `overconfident`, `overcautious` or None
        """
        ascending = np.sort(values)  # NaN come last
        usable = int(ascending.searchsorted(np.nan))
        numbers = {"pairs": usable, "without_covariance": len(values) - usable}
        if not usable:
            names = ("nees", "low", "high", "factor", "factor_low", "factor_high")
            undefined = (*names, "typical_factor", "typical_low", "typical_high", "verdict")
            return {"expected": DOF, **dict.fromkeys(undefined), "objects": 0, "samples": 0.0, **numbers}
        if usable < len(values):
            finite = np.isfinite(values)
            values, objects, ascending = values[finite], objects[finite], ascending[:usable]
        samples, n_objects = self._samples(values, objects, _quantile(ascending, 0.5), period_s)
        mean, (low, high) = float(ascending.mean()), mean_bounds(samples, DOF)
        factors = math.sqrt(mean / DOF), math.sqrt(mean / high), math.sqrt(mean / low) if low else None
        typical = _typical(ascending, samples)
        return {
            "nees": mean,
            "expected": DOF,
            "low": low,
            "high": high,
            **dict(zip(("factor", "factor_low", "factor_high"), factors, strict=True)),
            **dict(zip(("typical_factor", "typical_low", "typical_high"), typical, strict=True)),
            "objects": n_objects,
            "samples": samples,
            **numbers,
            "verdict": self._verdict(factors, typical),
        }

    def _samples(self, values: Floats, objects: Ints, median: float, period_s: float) -> tuple[float, int]:
        """Effective number of independent samples, the smaller of two; and the number of objects.

        One follows from how long each object is matched, as every second has `samples_per_s`. The other follows from
        how differently the objects come out: the share of values above the median varies between independent objects
        as it would between so many samples.
        """
        pairs = np.bincount(objects)
        n, k = len(values), int(np.count_nonzero(pairs))
        independent = np.minimum(np.maximum(self.samples_per_s * period_s * pairs, 1.0), pairs)
        by_time = n * n / float((pairs**2 / np.maximum(independent, 1.0)).sum())
        if k < 2:
            return by_time, k
        above = np.bincount(objects, values > median) - 0.5 * pairs
        variance = k / (k - 1) * float((above**2).sum()) / n**2
        return (by_time if by_time * variance <= 0.25 else 0.25 / variance), k

    def _verdict(self, *intervals: tuple[float | None, float | None, float | None]) -> str | None:
        """The verdict if all intervals (factor, low, high) are beyond the limit on the same side."""
        if all(low is not None and low > self.limit for _, low, _ in intervals):
            return OVERCONFIDENT
        if all(high is not None and high < 1.0 / self.limit for _, _, high in intervals):
            return OVERCAUTIOUS
        return None


class PairDeviations(NamedTuple):
    """m pairs of one estimate of a run.

    frame: (m,) rows of the frames;  object: (m,) ids
    position, velocity: (m,) NEES, NaN without a usable covariance
    """

    frame: Ints
    object: Ints
    position: Floats
    velocity: Floats

    @classmethod
    def joined(cls, parts: Sequence[PairDeviations]) -> PairDeviations:
        """The pairs of several parts of a run."""
        return cls(*(np.concatenate(column) for column in zip(*parts, strict=True)))

    def every(self, step: int) -> PairDeviations:
        """The pairs of every `step`-th frame."""
        kept = self.frame % step == 0
        return PairDeviations._make(column[kept] for column in self)


def counts(agent: str, estimator: str, pictures: Collection[str]) -> bool:
    """Whether an estimate is compared with its covariances; pictures: as in `Consistency.summary`."""
    return estimator in (LOCAL, RECEIVED, MISSION) or (estimator == PICTURE and agent in pictures)


def deviations(pairs: MatchedPairs, series: int, frames: slice) -> PairDeviations:
    """The deviations of one row of series in a slice of the frames, with a start and a stop."""
    errors, truth = pairs.errors(series, frames), pairs.truth.boxes
    return PairDeviations(
        truth.group.take(errors.truth_row),
        truth.id.take(errors.truth_row),
        nees(*errors.position),
        nees(*errors.velocity),
    )


def nees(error: Floats, covariance: Floats) -> Floats:
    """Normalised squares (n,) of errors (n, 2); NaN where the covariance is not positive definite.

    covariance: (n, 3), its elements xx, xy, yy
    """
    (x, y), (a, b, c) = error.T, covariance.T
    with np.errstate(all="ignore"):
        slope = b / a
        rest = c - b * slope
        value: Floats = np.minimum(x * x / a + (y - slope * x) ** 2 / rest, MAX_NEES)
        value[~((a > 0.0) & (rest > 0.0))] = np.nan
        return value


def _typical(ascending: Floats, samples: float) -> tuple[float, float | None, float | None]:
    """The factor from the median of sorted values, and its 95 % interval between two other quantiles.

    The interval does not depend on the distribution of the values. None: too few samples for it.
    """
    half = 0.5 * TWO_SIDED / math.sqrt(samples)
    middle, low, high = (
        math.sqrt(_quantile(ascending, min(max(share, 0.0), 1.0)) / MEDIAN) for share in (0.5, 0.5 - half, 0.5 + half)
    )
    return (middle, low, high) if half <= 0.5 else (middle, None, None)


def _quantile(ascending: Floats, share: float) -> float:
    """A quantile of n >= 1 sorted values, by linear interpolation."""
    position = share * (len(ascending) - 1)
    row = int(position)
    low, high = ascending[row : row + 2].tolist() if row + 1 < len(ascending) else (float(ascending[row]),) * 2
    return float(low + (position - row) * (high - low))
