"""Means and rates over trials, with 95 % intervals that hold for few trials.

Trials are crossed: every scene is played with the same seeds. Trials that share a scene (its traffic) or a seed (its
draws) are correlated, so the units here are whole seeds and whole scenes, never single trials. docs/how-to-studies.md
explains the intervals; tests/study/interval_coverage.py simulates how often they hold.

Values are arrays (..., scenes, seeds), one value per trial, none missing; leading axes are independent samples.

Where a number of a kind of study is not a mean, one pair of scene and seed is the unit: its frames, lies and agents
are not independent. Shares, medians and areas have percentile intervals of a bootstrap over trials (Efron 1979, Annals
of Statistics 7:1), rates of rare events the exact interval of a Poisson count (Garwood 1936, Biometrika 28:437),
shares of runs that of a binomial count.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import betaincinv, stdtr, stdtrit

from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.metrics import CAUSES
from mast_zenoh.metrics.measures import MEASURES, range_of
from mast_zenoh.metrics.study_results import (
    BINOMIAL,
    BOOTSTRAP,
    MIN_SEEDS,
    MOSTLY_ZERO,
    NEGLIGIBLE,
    OVER_SCENES,
    POISSON,
    STUDENT,
    TWO_WAY,
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
    return _p_value(mean, error, np.asarray(values.shape[-1] - 1.0))


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
    """
    if min(values.shape[-2:]) < MIN_CLUSTERS:
        return Interval(*np.full((2, *values.shape[:-2]), np.nan))
    return _t_interval(*_two_way(values))


def _two_way(values: Floats) -> tuple[Floats, Floats, Floats]:
    """The mean over scenes and seeds, its standard error (NaN: negligible) and degrees of freedom.

    Two-way analysis of variance with mean squares A between scenes, B between seeds and C of the residuals:
    the variance of the mean is estimated by (A + max(B - C, 0)) / (scenes * seeds), its degrees of freedom by
    Satterthwaite's formula. C contributes to both A and B, but must count only once. This is Hillis's interval
    for readers and cases (2007, Statistics in Medicine 26:596), with the degrees of freedom of both factors as in
    Gaylor and Hopper (1969, Technometrics 11:691); Cameron, Gelbach and Miller (2011, JBES 29:238) add and subtract
    the same three terms. A t interval over the scenes' averages alone would overlook that scenes share their seeds.
    """
    scenes, seeds = values.shape[-2:]
    mean = values.mean(axis=(-2, -1))
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
        return mean, error, total**2 / spread


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


def _p_value(mean: Floats, error: Floats, degrees: Floats) -> Floats:
    with np.errstate(divide="ignore", invalid="ignore"):
        p: Floats = 2.0 * stdtr(degrees, -np.abs(mean / error))
    return np.where(np.isnan(error), np.nan, p)


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
    complete = _complete(values)
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


def _complete(values: Floats) -> Floats:
    """The scenes that have any value, and of these the seeds that have all."""
    known = ~np.isnan(values)
    scenes = known.any(axis=1)
    return values[scenes][:, known[scenes].all(axis=0)]


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


# -- numbers of cells --------------------------------------------------------------------------------------------------

#: Minimum number of trials for a bootstrap, and for the interval of a share that is 0 or 1 in all of them.
MIN_TRIALS = MIN_SEEDS
RESAMPLES = 2000
#: Least number of seeds, of MIN_TRIALS scenes, for an interval to other scenes and seeds: of two, 88 % are right.
LEAST_SEEDS = 3
#: Share of resamples that must have a value.
_DEFINED = 0.95
_TAILS = (1.0 - _UPPER, _UPPER)


def mean(
    values: ArrayLike, bounds: tuple[float, float] = (-np.inf, np.inf), *, scenes: int = 1, paired: bool = False
) -> Statistic:
    """The mean of a value of each trial, with the interval of all studies (`trial_estimate`).

    values: (n,) scene by scene, NaN where a trial has none: its seed is left out
    bounds: smallest and largest possible value;  scenes: their number;  paired: whether values are differences
    Of fewer than five seeds but not scenes, scenes are the units: the interval is one to other scenes with these seeds,
    and of LEAST_SEEDS or more one to other seeds, too, as that of `over_scenes`. In one of fewer seeds, what seeds have
    in common in all scenes is not contained.
    """
    grid = units(values, scenes)
    each = trial_estimate(grid, bounds, paired=paired)
    if np.isnan(each.low):
        return _at_limit(each, each.trials, bounds)
    if len(grid) == scenes:  # seeds are the units
        return each
    complete = _complete(grid).T
    if complete.shape[1] < LEAST_SEEDS:
        return each._replace(interval=OVER_SCENES)
    of_both = _two_way(complete)
    low, high = np.clip(_t_interval(*of_both), *bounds).tolist()
    p = float(_p_value(*of_both)) if paired else each.p
    return each._replace(low=low, high=high, p=p, interval="" if math.isnan(low) else TWO_WAY)


def units(values: ArrayLike, scenes: int) -> Floats:
    """(scenes, seeds) a value of each trial (n,), scene by scene. Columns are the units of intervals.

    Of fewer than five seeds but not scenes, it is (seeds, scenes).
    """
    every = np.asarray(values, np.float64).reshape(scenes, -1)
    return every.T if every.shape[1] < MIN_TRIALS <= scenes else every


def share(part: ArrayLike, whole: ArrayLike) -> Statistic:
    """The sum of a part over all trials, relative to the sum of the whole.

    part, whole: (n,) of each trial, not negative; NaN where a trial has none: it is left out. NaN if the whole is 0.
    """
    parts, wholes = (np.asarray(each, np.float64).ravel() for each in (part, whole))
    known = ~np.isnan(parts) & ~np.isnan(wholes)
    left_out = int((~known).sum())
    parts, wholes = parts[known], wholes[known]
    if not wholes.sum():
        return Statistic(left_out=left_out)
    value = float(parts.sum() / wholes.sum())
    some = wholes > 0.0
    if not parts[~some].any() and np.ptp(parts[some] / wholes[some]) <= NEGLIGIBLE:
        return _at_limit(Statistic(value, trials=len(parts), left_out=left_out), int(some.sum()), (0.0, 1.0))
    interval = bootstrap(lambda rows: _ratio(parts[rows].sum(axis=-1), wholes[rows].sum(axis=-1)), len(parts))
    return _with_bootstrap(Statistic(value, *interval, len(parts), left_out))


def one_minus(measured: Statistic) -> Statistic:
    """The complement of a share."""
    return measured._replace(value=1.0 - measured.value, low=1.0 - measured.high, high=1.0 - measured.low)


def pooled(statistic: Callable[[Ints], float], trials: int) -> Statistic:
    """A statistic of the data of all trials together, such as a median delay or an area.

    statistic: of the indices of trials, each as often as it is drawn; draws for which it is NaN are left out, and for
               which it is infinite are not. If it is equal in each trial alone, there is no interval without width.
    """
    value = statistic(np.arange(trials)) if trials else NAN
    if np.isnan(value):
        return Statistic()
    low, high = bootstrap(lambda rows: np.array([statistic(line) for line in rows]), trials)
    if high - low <= NEGLIGIBLE and _equal([statistic(np.array([row])) for row in range(trials)]):
        low = high = NAN
    return _with_bootstrap(Statistic(value, low, high, trials))


def rate(events: int, hours: float, trials: int) -> Statistic:
    """Events per hour; NaN without hours."""
    from scipy import stats  # slow to load

    if not hours > 0.0:
        return Statistic()
    low = stats.chi2.ppf(_TAILS[0], 2 * events) / 2.0 if events else 0.0
    high = stats.chi2.ppf(_TAILS[1], 2 * events + 2) / 2.0
    return Statistic(events / hours, float(low / hours), float(high / hours), trials, 0, POISSON)


def share_of_runs(outcomes: Sequence[Sequence[bool]]) -> Statistic:
    """The share of runs in which something happened; NaN without runs.

    outcomes: of the runs of each trial

    Exact for one run of each trial. Of several, the interval is that of as many runs as there are trials with any, as
    if the runs of a trial always agreed: it is wider than it would have to be if they do not.
    """
    runs = [outcome for trial in outcomes for outcome in trial]
    trials = sum(bool(trial) for trial in outcomes)
    if not runs:
        return Statistic()
    return share_of_trials(sum(runs) / len(runs) * trials, trials)._replace(trials=len(runs))


def share_of_trials(happened: float, trials: int) -> Statistic:
    """The share of trials in which something happened; NaN without trials."""
    if not trials:
        return Statistic()
    interval = clopper_pearson(happened, trials)
    return Statistic(happened / trials, float(interval.low), float(interval.high), trials, 0, BINOMIAL)


def bootstrap(statistic: Callable[[Ints], Floats], count: int) -> tuple[float, float]:
    """The 95 % percentile interval of a statistic of `count` trials; the same draws for the same count.

    statistic: (r, count) indices of trials, drawn with replacement, to (r,) values; NaN where a draw has none
    NaN for fewer than MIN_TRIALS, and if too few draws have a value.
    """
    if count < MIN_TRIALS:
        return NAN, NAN
    from scipy import stats  # slow to load

    with np.errstate(invalid="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore", stats.DegenerateDataWarning)  # of SciPy's interval, if a value is infinite
        drawn = stats.bootstrap(
            (np.arange(count),),
            lambda rows, axis: statistic(rows) if np.ndim(rows) > 1 else statistic(rows[None, :])[0],
            vectorized=True,
            n_resamples=RESAMPLES,
            method="percentile",
            random_state=np.random.default_rng(count),
        ).bootstrap_distribution
    values = drawn[~np.isnan(drawn)]
    if len(values) < _DEFINED * RESAMPLES:
        return NAN, NAN
    low, high = np.quantile(values, _TAILS, method="inverted_cdf")  # infinite values are not interpolated
    return float(low), float(high)


def _with_bootstrap(measured: Statistic) -> Statistic:
    return measured if np.isnan(measured.low) else measured._replace(interval=BOOTSTRAP)


def _equal(values: ArrayLike) -> bool:
    """Whether all values that are known are equal."""
    known = np.asarray(values, np.float64)
    known = known[~np.isnan(known)]
    return bool(np.ptp(known) <= NEGLIGIBLE) if np.isfinite(known).all() and known.size else False


def _at_limit(measured: Statistic, trials: int, bounds: tuple[float, float]) -> Statistic:
    """The mean of equal values: without an interval, except for shares of 0 or 1 in MIN_TRIALS trials or more.

    If all trials are at a limit of a share, it is at least as extreme in truth as the exact binomial bound for as many
    trials: the probability that a trial is at the limit cannot exceed the mean's distance from the other limit.
    """
    value = measured.value
    if bounds != (0.0, 1.0) or min(abs(value), abs(1.0 - value)) > NEGLIGIBLE or trials < MIN_TRIALS:
        return measured
    exact = share_of_trials(trials if value > 0.5 else 0, trials)
    return measured._replace(low=exact.low, high=exact.high, interval=exact.interval)


def _ratio(part: Floats, whole: Floats) -> Floats:
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.where(whole > 0.0, part / whole, np.nan))


@dataclass(frozen=True, slots=True, eq=False)
class Survival:
    """Kaplan-Meier estimate (1958, JASA 53:457) of the share that is not detected yet.

    time_s:     (k,) s, ascending, beginning with 0; the last is the longest time observed
    undetected: (k,) share, 0 to 1, from that time on
    detections, watched: numbers of detections, and of all that were watched
    """

    time_s: Floats
    undetected: Floats
    detections: int
    watched: int

    @property
    def median_s(self) -> float:
        """s until half are detected; NaN if fewer were, as far as they were watched."""
        below = self.undetected <= 0.5
        return float(self.time_s[below.argmax()]) if below.any() else float("nan")


def kaplan_meier(time_s: ArrayLike, detected: ArrayLike) -> Survival:
    """The survival curve of n times.

    time_s: (n,) s until detection, or for which it was watched in vain;  detected: (n,) bool
    A time at which one is detected and another censored counts both as watched. Raises ValueError for negative times.
    """
    times, events = np.asarray(time_s, np.float64).ravel(), np.asarray(detected, bool).ravel()
    if len(times) != len(events):
        raise ValueError(f"detected: found {len(events)}, expected {len(times)}, one for each time")
    if not (times >= 0.0).all():
        raise ValueError("time_s: found a negative time or NaN, expected 0 or more")
    at = np.unique(times[events])
    watched = (times[None, :] >= at[:, None]).sum(axis=1)
    now = (times[events][None, :] == at[:, None]).sum(axis=1)
    share = np.cumprod(1.0 - now / np.maximum(watched, 1))
    curve_times, curve = np.concatenate([[0.0], at]), np.concatenate([[1.0], share])
    last = float(times.max(initial=0.0))
    if last > curve_times[-1]:
        curve_times, curve = np.append(curve_times, last), np.append(curve, curve[-1])
    return Survival(curve_times, curve, int(events.sum()), len(times))
