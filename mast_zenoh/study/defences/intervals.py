"""Numbers over the trials of a cell or of a defence, with 95 % intervals. Pure.

Means have the intervals of all studies (`study.statistics`), over seeds. Elsewhere a trial, one pair of scene and seed,
is the unit: its frames, lies and agents are not independent. Shares, medians and areas have percentile intervals of a
bootstrap over trials (Efron 1979, Annals of Statistics 7:1), rates of rare events the exact interval of a Poisson count
(Garwood 1936, Biometrika 28:437), shares of runs the exact interval of a binomial count (Clopper and Pearson 1934,
Biometrika 26:404).
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike

from mast_zenoh.arrays.states import Floats, Ints
from mast_zenoh.metrics.study_results import (
    BINOMIAL,
    BOOTSTRAP,
    MIN_SEEDS,
    NAN,
    POISSON,
    Statistic,
    Survival,
)
from mast_zenoh.study import statistics
from mast_zenoh.study.statistics import CONFIDENCE, clopper_pearson

#: Minimum number of trials for a bootstrap, and for the interval of a share that is 0 or 1 in all of them.
MIN_TRIALS = MIN_SEEDS
RESAMPLES = 2000
#: Share of resamples that must have a value.
_DEFINED = 0.95
#: Differences up to this are rounding errors.
_EQUAL = 1e-9

_TAILS = (0.5 - CONFIDENCE / 2.0, 0.5 + CONFIDENCE / 2.0)


def mean(
    values: ArrayLike, bounds: tuple[float, float] = (-np.inf, np.inf), *, scenes: int = 1, paired: bool = False
) -> Statistic:
    """The mean of a value of each trial, with the interval of all studies (`statistics.trial_estimate`).

    values: (n,) scene by scene, NaN where a trial has none: its seed is left out
    bounds: smallest and largest possible value;  scenes: their number;  paired: whether values are differences
    Of fewer than five seeds but not scenes, scenes are the units.
    """
    each = statistics.trial_estimate(units(values, scenes), bounds, paired=paired)
    return _at_limit(each, each.trials, bounds) if np.isnan(each.low) else each


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
    if not parts[~some].any() and np.ptp(parts[some] / wholes[some]) <= _EQUAL:
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
    if high - low <= _EQUAL and _equal([statistic(np.array([row])) for row in range(trials)]):
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
    return bool(np.ptp(known) <= _EQUAL) if np.isfinite(known).all() and known.size else False


def _at_limit(measured: Statistic, trials: int, bounds: tuple[float, float]) -> Statistic:
    """The mean of equal values: without an interval, except for shares of 0 or 1 in MIN_TRIALS trials or more.

    If all trials are at a limit of a share, it is at least as extreme in truth as the exact binomial bound for as many
    trials: the probability that a trial is at the limit cannot exceed the mean's distance from the other limit.
    """
    value = measured.value
    if bounds != (0.0, 1.0) or min(abs(value), abs(1.0 - value)) > _EQUAL or trials < MIN_TRIALS:
        return measured
    exact = share_of_trials(trials if value > 0.5 else 0, trials)
    return measured._replace(low=exact.low, high=exact.high, interval=exact.interval)


def _ratio(part: Floats, whole: Floats) -> Floats:
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.where(whole > 0.0, part / whole, np.nan))


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
