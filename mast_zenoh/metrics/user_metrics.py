"""User-defined metrics: computed for every estimate of every agent, in all tables. Pure; see docs/metrics.md."""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.metrics.attribution import Labels
from mast_zenoh.metrics.causes import named
from mast_zenoh.metrics.record import TruthTable
from mast_zenoh.metrics.scores import OUTCOMES, Scores, Table, Texts, mean_and_std


@dataclass(frozen=True, slots=True)
class Estimate:
    """One estimate of one agent over a run of f frames: n boxes, of the truth and of the tracks.

    agent, estimator: their names;  frames: (f,) int64;  period_s: s from frame to frame
    scored:   (f,) bool, the frames over which summaries are made
    frame:    (n,) int64, row of `frames`
    is_track: (n,) bool, a track, or else a truth object
    outcome:  (n,) str, "matched", "missed", "false" or "unevaluated"
    id, match_id: (n,) int64, of the box and of the one that it is matched with, -1: none
    position: (n, 3) m and size (n, 3) m, world frame;  yaw: (n,) rad;  score: (n,), NaN for truth objects
    range_m:  (n,) m, from the agent, in the bird's-eye view
    cause:    (n,) str, of false tracks and missed objects, one of CAUSES
    """

    agent: str
    estimator: str
    frames: Ints
    period_s: float
    scored: Bools
    frame: Ints
    is_track: Bools
    outcome: Texts
    id: Ints
    match_id: Ints
    position: Floats
    size: Floats
    yaw: Floats
    score: Floats
    range_m: Floats
    cause: Texts

    def count(self, boxes: Bools) -> Floats:
        """(f,) how many of the boxes that a mask (n,) picks are in each frame."""
        return np.bincount(self.frame[boxes], minlength=len(self.frames)).astype(np.float64)


class Metric(ABC):
    """A user-defined metric: a subclass of FrameMetric or RunMetric, in a scenario's file or beside it, that the
    scenario names: `evaluator=dict(metrics=[dict(type="MyMetric")])`.

    name: in tables; by default the class's, in lower case with underscores
    unit: of its values, for figures and tables
    """

    name: ClassVar[str] = ""
    unit: ClassVar[str] = ""

    @property
    def label(self) -> str:
        """What the metric is called in tables."""
        return self.name or re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", type(self).__name__).lower()

    @abstractmethod
    def value(self, estimate: Estimate) -> Floats | float | None:
        """(f,) values, one for each frame, or one for the run. Raises ValueError for what is neither."""


class ReturnedWrong(ValueError):
    """What a metric returned is no value of its kind. about: the user's method that returned it."""

    def __init__(self, text: str, about: Callable[..., Any]) -> None:
        super().__init__(text)
        self.about = about


class FrameMetric(Metric):
    """A metric with a value in every frame; its mean and standard deviation are over the scored frames."""

    @abstractmethod
    def per_frame(self, estimate: Estimate) -> Floats:
        """(f,) values, NaN where the metric is not defined."""

    def value(self, estimate: Estimate) -> Floats:
        found = self.per_frame(estimate)
        try:
            values = np.asarray(found, np.float64)
        except (ValueError, TypeError) as error:
            name = type(self).__name__
            text = f"{name}.per_frame: found {_sample(found)}, expected numbers: {error}"
            raise ReturnedWrong(text, type(self).per_frame) from None
        if values.shape != estimate.frames.shape:
            name = type(self).__name__
            text = f"{name}.per_frame: found shape {values.shape}, expected {estimate.frames.shape}"
            raise ReturnedWrong(text, type(self).per_frame)
        return values


def _sample(found: object) -> str:
    """What a metric returned, in a few words: its type, and that of its first value."""
    first = next(iter(found), None) if isinstance(found, (list, tuple, np.ndarray)) else None
    return type(found).__name__ if first is None else f"a {type(found).__name__} of {type(first).__name__}"


class RunMetric(Metric):
    """A metric with one value for the whole run."""

    @abstractmethod
    def per_run(self, estimate: Estimate) -> float | None:
        """The value, over the scored frames; None: it is not defined."""

    def value(self, estimate: Estimate) -> float | None:
        value = self.per_run(estimate)
        if value is not None and not isinstance(value, (int, float, np.floating, np.integer)):
            name = type(self).__name__
            text = f"{name}.per_run: found {type(value).__name__}, expected a number or None"
            raise ReturnedWrong(text, type(self).per_run)
        return None if value is None else float(value)


class ErrorsNearby(FrameMetric):
    """Missed objects and false tracks within a distance of the agent.

    distance_m: from the agent, in the bird's-eye view
    """

    unit = "objects"

    def __init__(self, *, distance_m: float = 30.0) -> None:
        if not distance_m > 0.0:
            raise ValueError(f"distance_m: found {distance_m}, expected more than 0")
        self.distance_m = distance_m

    def per_frame(self, estimate: Estimate) -> Floats:
        wrong = np.isin(estimate.outcome, ("missed", "false"))
        return estimate.count(wrong & (estimate.range_m <= self.distance_m))


class LongestMiss(RunMetric):
    """The longest time for which one object was missed without a break, s."""

    unit = "s"

    def per_run(self, estimate: Estimate) -> float | None:
        rows = np.flatnonzero((estimate.outcome == "missed") & estimate.scored[estimate.frame])
        if not len(rows):
            return 0.0
        order = rows[np.lexsort((estimate.frame[rows], estimate.id[rows]))]
        breaks = (np.diff(estimate.id[order]) != 0) | (np.diff(estimate.frame[order]) != 1)
        lengths = np.diff(np.flatnonzero(np.concatenate([[True], breaks, [True]])))
        return float(lengths.max() * estimate.period_s)


def check(metrics: Sequence[Metric], known: Sequence[str]) -> None:
    """Raises ValueError for two metrics of one name, and for one that is called like one of ours."""
    labels = [metric.label for metric in metrics]
    for metric, label in zip(metrics, labels, strict=True):
        if label.endswith("_iob") or label.startswith("success_"):
            raise ValueError(f"metrics: found {label!r}: studies have names of that form of their own")
        if label in known:
            raise ValueError(
                f"metrics: {type(metric).__name__} is called {label!r}, like one that is always computed: "
                "that one is meant by the name, expected another `name`, or another name of the class"
            )
        if labels.count(label) > 1:
            raise ValueError(f"metrics: found {label!r} twice, expected a name of its own for each metric")


def values(
    metrics: Sequence[Metric],
    scores: Scores,
    labels: Labels,
    truth: TruthTable,
    agents: Sequence[str],
    scored: Bools,
    period_s: float,
) -> tuple[dict[str, list[Any]], dict[str, BaseException]]:
    """By the name of a metric its value for each of `scores.series`: (f,) floats, or a float or None; and its error.

    A metric that raises is undefined for every series: NaN in every frame, or None. Its first error is returned.
    """
    result: dict[str, list[Any]] = {metric.label: [] for metric in metrics}
    errors: dict[str, BaseException] = {}
    for row in range(len(scores.series) if metrics else 0):
        estimate = _estimate(row, scores, labels, truth, agents, scored, period_s)
        for metric in metrics:
            if metric.label in errors:
                continue
            try:
                result[metric.label].append(metric.value(estimate))
            except KeyboardInterrupt:
                raise
            except BaseException as error:  # GeneratorExit and CancelledError are no Exception
                errors[metric.label] = error
    for metric in metrics:
        if metric.label in errors:
            undefined = np.full(len(scores.frames), np.nan) if isinstance(metric, FrameMetric) else None
            result[metric.label] = [undefined] * len(scores.series)
    return result, errors


def _estimate(
    row: int,
    scores: Scores,
    labels: Labels,
    truth: TruthTable,
    agents: Sequence[str],
    scored: Bools,
    period_s: float,
) -> Estimate:
    agent, estimator = scores.series[row]
    judged = scores.judged
    rows = np.flatnonzero(judged.series == row)
    boxes = judged.boxes.select(rows)
    frame = np.searchsorted(scores.frames, judged.frame[rows])
    at = truth.agent_position[frame, agents.index(agent)]
    frames, counted = scores.frames.copy(), scored.copy()
    for shared in (frames, counted):  # with the other metrics
        shared.flags.writeable = False
    return Estimate(
        agent=agent,
        estimator=estimator,
        frames=frames,
        period_s=period_s,
        scored=counted,
        frame=frame,
        is_track=judged.is_track[rows],
        outcome=np.array(OUTCOMES)[judged.outcome[rows]],
        id=boxes.id,
        match_id=judged.match_id[rows],
        position=boxes.position,
        size=boxes.size,
        yaw=boxes.yaw,
        score=judged.score[rows],
        range_m=np.hypot(*(boxes.position - at)[:, :2].T),
        cause=named(labels.cause[rows]).astype(str),
    )


def add_to(
    summary: dict[str, dict[str, dict[str, Any]]],
    table: Table,
    scores: Scores,
    found: dict[str, list[Any]],
    scored: Bools,
) -> None:
    """Put the values of user-defined metrics into the summary and the table per frame of all estimates."""
    every = scores.every_series
    for label, of_series in found.items():
        for (agent, estimator), row in every.items():
            value = of_series[row]
            if isinstance(value, np.ndarray):
                known = value[scored & np.isfinite(value)]
                summary[agent][estimator][label] = mean_and_std(known)
            else:
                summary[agent][estimator][label] = value
        if all(isinstance(value, np.ndarray) for value in of_series) and every:
            table[label] = np.concatenate([of_series[row] for row in every.values()])
