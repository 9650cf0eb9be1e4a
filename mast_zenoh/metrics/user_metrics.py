"""User-defined metrics, computed for every estimate of every agent.

Pure; see docs/metrics.md.
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import Any, ClassVar

import numpy as np

from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.metrics.causes import Labels, cause_names
from mast_zenoh.metrics.record import TruthTable
from mast_zenoh.metrics.scores import OUTCOMES, Scores, Table, Texts, mean_and_std


@dataclass(frozen=True, slots=True)
class Estimate:
    """One estimate of one agent over f frames: n boxes of truth objects and tracks.

    agent, estimator: their names;  frames: (f,) int64;  period_s: s, frame period
    scored:   (f,) bool, the frames that count in summaries
    frame:    (n,) int64, row of `frames`
    is_track: (n,) bool, a track instead of a truth object
    outcome:  (n,) str, "matched", "missed", "false" or "unevaluated"
    id, match_id: (n,) int64, of the box and of its match, -1: none
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

    def __post_init__(self) -> None:
        for each in fields(self):
            value = getattr(self, each.name)
            if isinstance(value, np.ndarray):  # all metrics get the same arrays
                value = value.view()
                value.flags.writeable = False
                object.__setattr__(self, each.name, value)

    def count(self, boxes: Bools) -> Floats:
        """Number (f,) of boxes selected by a mask (n,) in each frame."""
        return np.bincount(self.frame[boxes], minlength=len(self.frames)).astype(np.float64)


class Metric(ABC):
    """Base class of user-defined metrics; subclass FrameMetric or RunMetric instead.

    The class is in a scenario's file or in a file next to it, and named in the scenario:
    `evaluator=dict(metrics=[dict(type="MyMetric")])`.

    name: name in tables; by default the class's, in lower case with underscores
    unit: of its values, for readers of the class; tables and figures do not print it
    """

    name: ClassVar[str] = ""
    unit: ClassVar[str] = ""

    @property
    def label(self) -> str:
        """Name of the metric in tables."""
        return self.name or label_of(type(self))

    @abstractmethod
    def value(self, estimate: Estimate) -> Floats | float | None:
        """Values (f,), one per frame, or a single one for the run.

        Raises ValueError for anything else.
        """


def label_of(cls: type[Metric]) -> str:
    """Name in tables of the metrics of a class."""
    return cls.name or re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", cls.__name__).lower()


class InvalidMetricValue(ValueError):
    """A metric returned an invalid value. about: the user's method that returned it."""

    def __init__(self, text: str, about: Callable[..., Any]) -> None:
        super().__init__(text)
        self.about = about


class FrameMetric(Metric):
    """A metric with a value in every frame.

    Its mean and standard deviation are over the scored frames.
    """

    @abstractmethod
    def per_frame(self, estimate: Estimate) -> Floats:
        """Values (f,), NaN where the metric is undefined."""

    def value(self, estimate: Estimate) -> Floats:
        returned = self.per_frame(estimate)
        try:
            values = np.asarray(returned, np.float64)
        except (ValueError, TypeError) as error:
            name = type(self).__name__
            text = f"{name}.per_frame: found {_describe(returned)}, expected numbers: {error}"
            raise InvalidMetricValue(text, type(self).per_frame) from None
        if values.shape != estimate.frames.shape:
            name = type(self).__name__
            text = f"{name}.per_frame: found shape {values.shape}, expected {estimate.frames.shape}"
            raise InvalidMetricValue(text, type(self).per_frame)
        return values


def _describe(returned: object) -> str:
    """Describe a returned value by its type and its first element's type."""
    first = next(iter(returned), None) if isinstance(returned, (list, tuple, np.ndarray)) else None
    return type(returned).__name__ if first is None else f"a {type(returned).__name__} of {type(first).__name__}"


class RunMetric(Metric):
    """A metric with one value for the whole run."""

    @abstractmethod
    def per_run(self, estimate: Estimate) -> float | None:
        """The value over the scored frames; None: undefined."""

    def value(self, estimate: Estimate) -> float | None:
        value = self.per_run(estimate)
        if value is not None and not isinstance(value, (int, float, np.floating, np.integer)):
            name = type(self).__name__
            text = f"{name}.per_run: found {type(value).__name__}, expected a number or None"
            raise InvalidMetricValue(text, type(self).per_run)
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
    """The longest uninterrupted time for which one object was missed, s."""

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
    """Raise ValueError for duplicate names of metrics, and for names of built-in ones."""
    labels = [metric.label for metric in metrics]
    for metric, label in zip(metrics, labels, strict=True):
        if label.endswith("_iob") or label.startswith("success_"):
            raise ValueError(f"metrics: found {label!r}: names of this form are reserved for studies")
        if label in known:
            raise ValueError(
                f"metrics: {type(metric).__name__} is called {label!r}, which is the name of a built-in metric: "
                "expected another `name`, or another name of the class"
            )
        if labels.count(label) > 1:
            raise ValueError(f"metrics: found {label!r} twice, expected a unique name for each metric")


def values(
    metrics: Sequence[Metric],
    scores: Scores,
    labels: Labels,
    truth: TruthTable,
    agents: Sequence[str],
    scored: Bools,
    period_s: float,
) -> tuple[dict[str, list[Any]], dict[str, BaseException]]:
    """Values of the metrics for each of `scores.series`, and errors, both by name.

    Values are (f,) floats, or a float or None.
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
            except BaseException as error:  # GeneratorExit and CancelledError are not Exceptions
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
    for shared in (frames, counted):  # between metrics
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
        cause=cause_names(labels.cause[rows]).astype(str),
    )


def add_to(
    summary: dict[str, dict[str, dict[str, Any]]],
    table: Table,
    scores: Scores,
    metric_values: dict[str, list[Any]],
    scored: Bools,
) -> None:
    """Add the values of user-defined metrics to the summary and the table per frame."""
    every_series = scores.every_series
    for label, series_values in metric_values.items():
        for (agent, estimator), row in every_series.items():
            value = series_values[row]
            if isinstance(value, np.ndarray):
                finite = value[scored & np.isfinite(value)]
                summary[agent][estimator][label] = mean_and_std(finite)
            else:
                summary[agent][estimator][label] = value
        if all(isinstance(value, np.ndarray) for value in series_values) and every_series:
            table[label] = np.concatenate([series_values[row] for row in every_series.values()])
