"""Receiver operating characteristic, and areas under it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from mast_zenoh.arrays.states import Floats


@dataclass(frozen=True, slots=True, eq=False)
class Roc:
    """What each threshold detects, from the strictest to the most lenient.

    threshold:       (k,) alarms are scores of at least this; the first is inf, which nothing reaches
    false_positives: (k,) int64, number of honest ones above it
    true_positives:  (k,) int64, number of liars above it
    honest, liars:   numbers of both
    """

    threshold: Floats
    false_positives: np.ndarray
    true_positives: np.ndarray
    honest: int
    liars: int

    @property
    def false_positive_rate(self) -> Floats:
        """(k,) 0 to 1; NaN if nobody is honest."""
        return _share(self.false_positives, self.honest)

    @property
    def true_positive_rate(self) -> Floats:
        """(k,) 0 to 1; NaN if nobody lies."""
        return _share(self.true_positives, self.liars)


def roc(scores: ArrayLike, labels: ArrayLike) -> Roc:
    """The characteristic of scores, one for each agent-run.

    scores: (n,) greater is more suspicious; NaN: the agent was never judged, as if the score were -inf
    labels: (n,) bool, whether the agent lied

    Equal scores share a threshold. Raises ValueError unless both have the same length.
    """
    score = np.asarray(scores, np.float64).ravel()
    lied = np.asarray(labels, bool).ravel()
    if len(score) != len(lied):
        raise ValueError(f"labels: found {len(lied)}, expected {len(score)}, one for each score")
    score = np.where(np.isnan(score), -np.inf, score)
    order = np.argsort(-score, kind="stable")
    score, lied = score[order], lied[order]
    last = np.flatnonzero(np.append(score[1:] != score[:-1], True)) if len(score) else np.zeros(0, np.int64)
    return Roc(
        np.concatenate([[np.inf], score[last]]),
        np.concatenate([[0], np.cumsum(~lied)[last]]).astype(np.int64),
        np.concatenate([[0], np.cumsum(lied)[last]]).astype(np.int64),
        int((~lied).sum()),
        int(lied.sum()),
    )


def auc(scores: ArrayLike, labels: ArrayLike) -> float:
    """Area under the characteristic: how often a liar scores above an honest agent; ties count half.

    The parameters are those of `roc`. NaN if nobody lies or nobody is honest.
    """
    curve = roc(scores, labels)
    if not (curve.honest and curve.liars):
        return float("nan")
    return float(np.trapezoid(curve.true_positive_rate, curve.false_positive_rate))


def partial_auc(scores: ArrayLike, labels: ArrayLike, hours: float, max_rate_per_hour: float) -> float:
    """Mean share of liars detected at false-alarm rates from 0 to `max_rate_per_hour`, 0 to 1.

    hours: of all runs together, of the whole system: an honest agent above a threshold is one false alarm in these
    The other parameters are those of `roc`.

    Without data for a rate, the share at the next lower measured rate counts: nothing is interpolated, because a rate
    below one alarm in `hours` was not observed. NaN if nobody lies. Raises ValueError unless hours and rate are
    positive.
    """
    if not (hours > 0.0 and max_rate_per_hour > 0.0):
        raise ValueError(f"hours, max_rate_per_hour: found {hours}, {max_rate_per_hour}, expected more than 0")
    curve = roc(scores, labels)
    if not curve.liars:
        return float("nan")
    rate, share = curve.false_positives / hours, curve.true_positive_rate
    begins = np.minimum(rate, max_rate_per_hour)
    ends = np.append(begins[1:], max_rate_per_hour)
    return float(((ends - begins) * share).sum() / max_rate_per_hour)


def _share(counts: Sequence[int] | np.ndarray, total: int) -> Floats:
    return np.asarray(counts, np.float64) / total if total else np.full(len(counts), np.nan)
