"""Summarises trials: one estimate per configuration and series."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from mast_zenoh.arrays.states import Floats
from mast_zenoh.metrics.study_results import Estimate, Series, StudyRow
from mast_zenoh.study import statistics
from mast_zenoh.study.definition import Study
from mast_zenoh.study.numbers import ACHIEVED, DEFENCE, NAN, SELECTIVE, Number, ego
from mast_zenoh.study.ranges import value_range
from mast_zenoh.study.results import COMPROMISED
from mast_zenoh.study.statistics import Moments
from mast_zenoh.study.trial import Outcome


class Samples:
    """The reported numbers: of the ego, compromised agents, achievements and the defence."""

    def __init__(self, study: Study, seeds: Sequence[int]) -> None:
        """seeds: the planned seeds of every configuration and scene."""
        self._study = study
        self._scene = {scene.label: index for index, scene in enumerate(study.scenes)}
        self._seed = {seed: index for index, seed in enumerate(seeds)}
        self._cells: dict[str, dict[Series, Floats]] = {each.label: {} for each in study.configurations}
        self._rates: set[Series] = set()
        self._ego = ""

    def add(self, outcome: Outcome, trial_numbers: Iterable[Number]) -> None:
        """Add the numbers of a trial, `results.values`."""
        self._ego = agent = self._ego or ego(outcome.metrics)
        trial = outcome.trial
        cell = self._scene[trial.scene], self._seed[trial.seed]
        cells = self._cells[trial.configuration]
        for number in trial_numbers:
            if number.metric in SELECTIVE:
                continue
            if number.owner in (agent, COMPROMISED) or number.estimator in (ACHIEVED, DEFENCE):
                series = Series(*number[:3])
                if series not in cells:
                    cells[series] = np.full((3, len(self._scene), len(self._seed)), NAN)
                cells[series][:, *cell] = number.value, number.std, number.frames
                if number.binary:
                    self._rates.add(series)

    def rows(self) -> list[StudyRow]:
        """A row per configuration."""
        return [
            StudyRow(
                label=configuration.label,
                run=configuration.run,
                point=dict(configuration.point),
                estimates={
                    series: _estimate(series, *cell, rate=series in self._rates)
                    for series, cell in self._cells[configuration.label].items()
                },
                ego=self._ego or "ego",
            )
            for configuration in self._study.configurations
        ]


def _estimate(series: Series, values: Floats, stds: Floats, frames: Floats, *, rate: bool) -> Estimate:
    """The estimate of a series from arrays (scenes, seeds).

    NaN where a trial has no value.

    Statistics over frames use all trials. Statistics over trials use the seeds that have a value in every scene with
    any value. Bounds are clipped to the possible range of the metric.
    """
    pooled = ~np.isnan(values) & ~np.isnan(stds) & (frames > 0)
    over_frames = [Moments(*each) for each in zip(frames[pooled], values[pooled], stds[pooled], strict=True)]
    mean, std = statistics.pooled(over_frames)
    bounds = value_range(series)
    estimate = trial_estimate(values, bounds, rate=rate, paired=series.metric.endswith("_iob"))
    return replace(estimate, mean=mean if over_frames else estimate.trial_mean, std=std)


def trial_estimate(
    values: Floats, bounds: tuple[float, float], *, rate: bool = False, paired: bool = False
) -> Estimate:
    """The mean over trials and its intervals, from an array (scenes, seeds), NaN where a trial has no value.

    bounds: smallest and largest possible value;  rate: whether values are 0 or 1
    paired: whether values are differences, which have a p-value, and an exact interval of the share of trials with 0.
            If that is more than half, the mean has no interval and no p-value: the interval would be too narrow
    """
    known = ~np.isnan(values)
    nonempty_scenes = known.any(axis=1)
    complete = values[nonempty_scenes][:, known[nonempty_scenes].all(axis=0)]
    scenes, seeds = complete.shape
    left_out = values.shape[1] - seeds
    if not complete.size:
        return Estimate(left_out=left_out)
    mean = float(complete.mean())
    low, high = statistics.rate_interval(complete) if rate else statistics.over_seeds(complete)
    scenes_interval = (NAN, NAN) if rate else statistics.over_scenes(complete)
    low, high, wide_low, wide_high = np.clip([low, high, *scenes_interval], *bounds).tolist()
    estimate = Estimate(
        mean=mean,
        trial_mean=mean,
        low=low,
        high=high,
        scenes_low=wide_low,
        scenes_high=wide_high,
        scenes=scenes,
        seeds=seeds,
        left_out=left_out,
        rate=rate,
    )
    if not paired:
        return estimate
    zeros = statistics.zeros(complete)
    zero_low, zero_high = map(float, statistics.rate_interval(zeros))
    estimate = replace(
        estimate,
        p=float(statistics.p_value_of_zero_mean(complete)),
        zero_share=float(zeros.mean()),
        zero_low=zero_low,
        zero_high=zero_high,
    )
    return estimate.without_interval() if estimate.mostly_zero else estimate
