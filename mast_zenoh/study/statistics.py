"""Means and rates over trials, with 95 % intervals that hold for few trials.

Trials are crossed: every scene is played with the same seeds. Trials that share a scene (its traffic) or a seed (its
draws) are correlated, so the units here are whole seeds and whole scenes, never single trials. docs/studies.md explains
the intervals and lists their simulated coverage.

Values are arrays (..., scenes, seeds), one value per trial, none missing; leading axes are independent samples.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import betaincinv, stdtr, stdtrit

from mast_zenoh.arrays.states import Bools, Floats
from mast_zenoh.metrics import CAUSES
from mast_zenoh.metrics.measures import MEASURES, range_of
from mast_zenoh.metrics.study_results import (
    BINOMIAL,
    MIN_SEEDS,
    MOSTLY_ZERO,
    NEGLIGIBLE,
    STUDENT,
    Statistic,
    StudySeries,
)
from mast_zenoh.study.numbers import ACHIEVED, COOPERATION, DEFENCE, DRIVEN, DRIVING, NAN

CONFIDENCE = 0.95
#: Minimum number of seeds for an interval, and of scenes for an interval over other scenes.
MIN_CLUSTERS = MIN_SEEDS

_SPLITS = ("fn_split.", "fp_split.", "id_switches_split.")
_DIFFERENCES = ("_iob", "_ioe")

_UPPER = 0.5 + CONFIDENCE / 2.0


class Moments(NamedTuple):
    """Number, mean and population standard deviation over the frames of one trial."""

    n: int
    mean: float
    std: float


class Interval(NamedTuple):
    """Lower and upper bounds: arrays of the leading axes' shape; NaN: no interval."""

    low: Floats
    high: Floats


def pooled_moments(parts: Sequence[Moments]) -> tuple[float, float]:
    """Mean and standard deviation of the frames of all trials; NaN without any."""
    n = np.array([part.n for part in parts], np.float64)
    if n.sum() == 0.0:
        return float("nan"), float("nan")
    mean, std = np.array([part.mean for part in parts]), np.array([part.std for part in parts])
    overall_mean = float(np.average(mean, weights=n))
    return overall_mean, float(np.sqrt(np.average(std**2 + (mean - overall_mean) ** 2, weights=n)))


def over_seeds(values: Floats) -> Interval:
    """Interval of the mean over other seeds of these scenes: Student's t.

    Computed from the seeds' averages; exact if these are normal, for any correlation between the scenes of one seed.
    NaN for fewer than MIN_CLUSTERS seeds, and where all averages are equal: without spread, nothing is known about the
    next seed.
    """
    mean, error = _seed_means(values)
    return _t_interval(mean, error, np.asarray(values.shape[-1] - 1.0))


def p_value_of_zero_mean(values: Floats) -> Floats:
    """Two-sided p-value of a zero mean over seeds (t statistic); NaN: not defined."""
    mean, error = _seed_means(values)
    with np.errstate(divide="ignore", invalid="ignore"):
        p: Floats = 2.0 * stdtr(values.shape[-1] - 1.0, -np.abs(mean / error))
    return np.where(np.isnan(error), np.nan, p)


def p_value_of_signs(values: Floats) -> float:
    """Two-sided p-value of the exact sign test of the seeds' averages (scenes, seeds); NaN: all are 0."""
    averages = values.mean(axis=-2)
    more, less = int((averages > NEGLIGIBLE).sum()), int((averages < -NEGLIGIBLE).sum())
    if not more + less:
        return NAN
    tail = sum(math.comb(more + less, number) for number in range(min(more, less) + 1))
    return min(1.0, math.ldexp(tail, 1 - more - less))


def over_scenes(values: Floats) -> Interval:
    """Interval of the mean over other random scenes and seeds.

    NaN for fewer than MIN_CLUSTERS scenes or seeds.

    Two-way analysis of variance with mean squares A between scenes, B between seeds and C of the residuals:
    the variance of the mean is estimated by (A + max(B - C, 0)) / (scenes * seeds), its degrees of freedom by
    Satterthwaite's formula. C contributes to both A and B, but must count only once. This is Hillis's interval
    for readers and cases (2007, Statistics in Medicine 26:596), with the degrees of freedom of both factors as in
    Gaylor and Hopper (1969, Technometrics 11:691); Cameron, Gelbach and Miller (2011, JBES 29:238) add and subtract
    the same three terms. A t interval over the scenes' averages alone would overlook that scenes share their seeds.
    """
    scenes, seeds = values.shape[-2:]
    mean = values.mean(axis=(-2, -1))
    if min(scenes, seeds) < MIN_CLUSTERS:
        return _t_interval(mean, np.full_like(mean, np.nan), np.asarray(1.0))
    by_scene, by_seed = values.mean(axis=-1), values.mean(axis=-2)
    residuals = values - by_scene[..., :, None] - by_seed[..., None, :] + mean[..., None, None]
    degrees = scenes - 1.0, seeds - 1.0, (scenes - 1.0) * (seeds - 1.0)
    a, b = seeds * by_scene.var(axis=-1, ddof=1), scenes * by_seed.var(axis=-1, ddof=1)
    c = (residuals**2).sum(axis=(-2, -1)) / degrees[2]
    total = a + np.maximum(b - c, 0.0)
    spread = a**2 / degrees[0] + np.where(b > c, b**2 / degrees[1] + c**2 / degrees[2], 0.0)
    error = np.sqrt(total / (scenes * seeds))
    error = np.where(_negligible(error, mean), np.nan, error)
    with np.errstate(invalid="ignore", divide="ignore"):
        return _t_interval(mean, error, total**2 / spread)


def rate_interval(successes: Floats) -> Interval:
    """Interval of a success rate over other seeds of these scenes.

    Values of trials are 0 or 1.

    The interval of `clopper_pearson` for the effective number of trials of Korn and Graubard
    (1998, Survey Methodology 24:193): the number of independent trials whose rate would vary as much as the seeds'
    averages do, corrected for the degrees of freedom. With a single scene, or if fewer than
    MIN_CLUSTERS seeds have a success or a failure, the spread is unknown, and the number of seeds is used instead. The
    interval is conservative, and has a width even at rates 0 and 1.
    """
    scenes, seeds = successes.shape[-2:]
    by_seed = successes.mean(axis=-2)
    rate = by_seed.mean(axis=-1)
    if seeds < MIN_CLUSTERS:
        return _t_interval(rate, np.full_like(rate, np.nan), np.asarray(1.0))
    n, trials = np.full_like(rate, seeds), scenes * seeds
    variance = by_seed.var(axis=-1, ddof=1) / seeds
    estimable: Bools = np.minimum((by_seed > 0.0).sum(axis=-1), (by_seed < 1.0).sum(axis=-1)) >= MIN_CLUSTERS
    estimable &= (variance > 0.0) & (scenes > 1)
    ratio = (stdtrit(trials - 1.0, _UPPER) / stdtrit(seeds - 1.0, _UPPER)) ** 2 * trials / (trials - 1.0)
    n[estimable] = np.minimum(trials, ratio * (rate * (1.0 - rate))[estimable] / variance[estimable])
    return clopper_pearson(rate * n, n)


def clopper_pearson(successes: ArrayLike, trials: ArrayLike) -> Interval:
    """The exact interval of a binomial rate (1934, Biometrika 26:404).

    successes, trials: arrays of one shape; they need not be whole, so that trials can be an effective number
    """
    k, n = np.asarray(successes, np.float64), np.asarray(trials, np.float64)
    with np.errstate(invalid="ignore"):
        low = np.where(k > 0.0, betaincinv(k, n - k + 1.0, 1.0 - _UPPER), 0.0)
        high = np.where(k < n, betaincinv(k + 1.0, n - k, _UPPER), 1.0)
    return Interval(low, high)


def zeros(values: Floats) -> Floats:
    """1 for each trial whose value is 0 up to rounding, else 0; for `rate_interval`."""
    return (np.abs(values) <= NEGLIGIBLE).astype(np.float64)


def _seed_means(values: Floats) -> tuple[Floats, Floats]:
    """Mean of the seeds' averages, and its standard error; NaN if not estimable."""
    averages = values.mean(axis=-2)
    seeds, mean = averages.shape[-1], averages.mean(axis=-1)
    if seeds < MIN_CLUSTERS:
        return mean, np.full_like(mean, np.nan)
    error = averages.std(axis=-1, ddof=1) / np.sqrt(seeds)
    return mean, np.where(_negligible(error, mean), np.nan, error)


def _negligible(error: Floats, mean: Floats) -> Bools:
    """Where a standard error is 0 up to rounding."""
    negligible: Bools = error <= 1e-12 * np.maximum(1.0, np.abs(mean))
    return negligible


def _t_interval(mean: Floats, error: Floats, degrees: Floats) -> Interval:
    half = stdtrit(degrees, _UPPER) * error
    return Interval(mean - half, mean + half)


# -- estimates ---------------------------------------------------------------------------------------------------------


def trial_estimate(
    values: Floats, bounds: tuple[float, float], *, rate: bool = False, paired: bool = False
) -> Statistic:
    """The mean over trials and its intervals, from an array (scenes, seeds), NaN where a trial has no value.

    bounds: smallest and largest possible value;  rate: whether values are 0 or 1
    paired: whether values are differences, which have a p-value, and an exact interval of the share of trials with 0.
            If that is more than half, the mean has no interval, which would be too narrow, and p is of a sign test
    """
    known = ~np.isnan(values)
    nonempty_scenes = known.any(axis=1)
    complete = values[nonempty_scenes][:, known[nonempty_scenes].all(axis=0)]
    scenes, seeds = complete.shape
    if not complete.size:
        return Statistic(left_out=values.size, scenes=scenes)
    mean = float(complete.mean())
    low, high = rate_interval(complete) if rate else over_seeds(complete)
    to_scenes = (NAN, NAN) if rate else over_scenes(complete)
    low, high, wide_low, wide_high = np.clip([low, high, *to_scenes], *bounds).tolist()
    estimate = Statistic(
        *(mean, low, high, complete.size, values.size - complete.size),
        interval="" if math.isnan(low) else BINOMIAL if rate else STUDENT,
        mean=mean,
        scenes_low=wide_low,
        scenes_high=wide_high,
        scenes=scenes,
        seeds=seeds,
        rate=rate,
    )
    if not paired:
        return estimate
    unchanged = zeros(complete)
    zero_low, zero_high = map(float, rate_interval(unchanged))
    zero_share = float(unchanged.mean())
    estimate = estimate._replace(zero_share=zero_share, zero_low=zero_low, zero_high=zero_high)
    if not estimate.mostly_zero:
        return estimate._replace(p=float(p_value_of_zero_mean(complete)))
    estimate = estimate._replace(interval="" if estimate.is_zero else MOSTLY_ZERO, p=p_value_of_signs(complete))
    return estimate._replace(low=NAN, high=NAN, scenes_low=NAN, scenes_high=NAN)


def value_range(series: StudySeries, own: Mapping[str, Mapping[str, Any]] | None = None) -> tuple[float, float]:
    """(smallest, largest) possible value of a series; infinite where unknown.

    own: `own_metrics` of metrics.json

    Counts, lengths and times are at least 0, shares are 0 to 1, differences can have either sign.
    """
    metric = series.metric
    if metric.endswith(_DIFFERENCES):
        return -math.inf, math.inf
    if series.estimator in COOPERATION:
        return 0.0, math.inf if metric.endswith("_m") else 1.0
    if series.estimator in (DEFENCE, DRIVEN):
        return 0.0, math.inf
    if series.estimator == ACHIEVED or metric.startswith(f"{DRIVING}."):
        share = "share" in metric or metric.endswith("_seen_by_others")
        return 0.0, 1.0 if share else math.inf
    if metric in MEASURES:
        return MEASURES[metric].range
    if own and metric in own:
        return range_of(own[metric])
    is_cause_count = metric.partition(" ")[2] in CAUSES
    return (0.0 if metric.startswith(_SPLITS) or is_cause_count else -math.inf), math.inf
