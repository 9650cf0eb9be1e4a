"""Metrics, one class each: its key, words and unit, and what it computes for every estimate of every agent.

Users' metrics go the same way as ours: `measured` puts their values into metrics.json and metrics.parquet, and tables
and figures take what they show from there. Pure; see docs/explanation-metrics-and-causes.md.
"""

from __future__ import annotations

import math
import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.states import Bools, Floats
from mast_zenoh.metrics.ranking import rankings
from mast_zenoh.metrics.scores import FrameScores, Scores, Table, mean_and_std, means_and_stds
from mast_zenoh.metrics.scoring import Estimate


@dataclass(eq=False)
class ScoredRun:
    """What metrics are computed from.

    scored:    the frames that count in summaries, such as all except the first ones
    estimates: of each of `scores.series`, for users' metrics; empty without any
    """

    scores: FrameScores
    scored: slice = field(default_factory=lambda: slice(None))
    estimates: Iterable[Estimate] = ()

    @cached_property
    def counts(self) -> Bools:
        """(f,) the frames that count."""
        counts = np.zeros(len(self.scores.frames), bool)
        counts[self.scored] = True
        return counts

    @cached_property
    def totals(self) -> list[tuple[int, int, int, int]]:
        """tp, fp, fn and identity switches of each series over the scored frames."""
        scores = self.scores
        sums = (counts[:, self.scored].sum(axis=1) for counts in (scores.tp, scores.fp, scores.fn, scores.id_switches))
        return list(zip(*(each.tolist() for each in sums), strict=True))

    @cached_property
    def ranked(self) -> Sequence[dict[str, Any]]:
        """`rankings` over the scored frames."""
        assert isinstance(self.scores, Scores)
        n = len(self.scores.frames)
        return rankings(self.scores, slice(*self.scored.indices(n)[:2]))

    @cached_property
    def completeness(self) -> Sequence[float | None]:
        """Of each series the mean over its objects of the fraction of matched frames, 0 to 1; None without objects."""
        assert isinstance(self.scores, Scores)
        return [each.completeness for each in self.scores.objects_matched(self.scored)]

    def values(self, metric: FrameMetric) -> Floats:
        """Values (s, f) of a user's metric. Raises what the metric raises."""
        shape = len(self.scores.series), len(self.scores.frames)
        return np.array([metric.value(estimate) for estimate in self.estimates]).reshape(shape)


class Measured(NamedTuple):
    """The values of a metric for each of s series: in summaries, and (s, f) by frame (None: one for the run)."""

    summaries: list[Any]
    frames: NDArray[Any] | None = None


class Quantity:
    """What a metric is called and how its values are shown.

    name:    its key in metrics.json and metrics.parquet; by default the class's, in lower case with underscores
    unit:    of its values
    heading: in tables, by default the name;  short: in tables of studies;  axis: the label of a chart over time
    digits:  decimals in tables;  brief: whether the terminal shows it;  whole: whether its values are whole numbers
    range:   smallest and largest possible value
    """

    name: ClassVar[str] = ""
    unit: str = ""
    heading: str = ""
    short: ClassVar[str] = ""
    axis: ClassVar[str] = ""
    digits: int = 2
    brief: ClassVar[bool] = True
    whole: bool = False
    range: tuple[float, float] = (-math.inf, math.inf)

    @property
    def label(self) -> str:
        """Name of the metric in tables."""
        return self.name or label_of(type(self))


class Measure(Quantity, ABC):
    """Base class of the metrics of estimates."""

    @abstractmethod
    def measured(self, run: ScoredRun) -> Measured:
        """Its values for each of `run.scores.series`, plain or None (undefined)."""


def label_of(cls: type[Quantity]) -> str:
    """Name in tables of the metrics of a class."""
    return cls.name or re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", cls.__name__).lower()


class _OfFrames(Measure):
    """Values of frames, (s, f) in `Scores`; its summary is their mean and standard deviation over the scored ones."""

    range = (0.0, math.inf)

    def measured(self, run: ScoredRun) -> Measured:
        return _means(getattr(run.scores, self.name), run.counts)


def _means(values: NDArray[Any], counts: Bools) -> Measured:
    """Values (s, f), and their means over the frames that count (f,) and have one."""
    return Measured(means_and_stds(values[:, counts]), values)


class Missed(_OfFrames):
    """Objects in range of the agent that no track matches, per frame"""

    name, unit, heading, short, axis = "fn", "objects", "missed (FN)", "FN", "missed objects\nper frame"
    whole = True


class FalseTracks(_OfFrames):
    """Tracks in range of the agent that match no object, per frame"""

    name, unit, heading, short, axis = "fp", "objects", "false (FP)", "FP", "false objects\nper frame"
    whole = True


class Matched(_OfFrames):
    """Objects in range of the agent that a track matches, per frame"""

    name, unit, heading, short, axis = "tp", "objects", "matched (TP)", "TP", "matched objects\nper frame"
    whole = True


class Rmse(Measure):
    """Root mean square distance of the centres of matched pairs, in m"""

    name, unit, heading, short, axis = "rmse_m", "m", "RMSE m", "RMSE m", "RMSE (m)"
    range = (0.0, math.inf)

    def measured(self, run: ScoredRun) -> Measured:
        squared, pairs = run.scores.squared_error, run.scores.tp
        mean = np.divide(squared, pairs, out=np.full(pairs.shape, np.nan), where=pairs > 0)
        sums = [row[run.scored].sum() for row in squared]
        over_run = [
            float(np.sqrt(total / tp)) if tp else None for total, (tp, *_) in zip(sums, run.totals, strict=True)
        ]
        return Measured(over_run, np.sqrt(mean))


class IdSwitches(Measure):
    """Number of times that an object is matched by a different track than before"""

    name, heading, short, axis = "id_switches", "ID switches", "ID sw.", "identity switches\nper frame"
    digits, whole, range = 0, True, (0.0, math.inf)

    def measured(self, run: ScoredRun) -> Measured:
        return Measured([switches for *_, switches in run.totals], run.scores.id_switches)


class _OfTotals(Measure):
    """A ratio of the numbers of matched pairs, errors and objects of the whole run; None where it is undefined."""

    range = (0.0, 1.0)

    @abstractmethod
    def ratio(self, tp: int, fp: int, fn: int, id_switches: int) -> tuple[int, int]:
        """Numerator and denominator."""

    def measured(self, run: ScoredRun) -> Measured:
        ratios = (self.ratio(*totals) for totals in run.totals)
        return Measured([above / below if below else None for above, below in ratios])


class Precision(_OfTotals):
    """Share of the tracks that match an object, 0 to 1"""

    heading = "precision"

    def ratio(self, tp: int, fp: int, fn: int, id_switches: int) -> tuple[int, int]:
        return tp, tp + fp


class Recall(_OfTotals):
    """Share of the objects that a track matches, 0 to 1"""

    heading = "recall"

    def ratio(self, tp: int, fp: int, fn: int, id_switches: int) -> tuple[int, int]:
        return tp, tp + fn


class Mota(Measure):
    """1 minus the missed objects, false tracks and identity switches per object (CLEAR MOT), at most 1

    Bernardin and Stiefelhagen, "Evaluating Multiple Object Tracking Performance: The CLEAR MOT Metrics", EURASIP
    Journal on Image and Video Processing 2008, section 2.1.3. Negative with more errors than objects.
    """

    heading = "MOTA"

    def measured(self, run: ScoredRun) -> Measured:
        return Measured(
            [1.0 - (fn + fp + switches) / (tp + fn) if tp + fn else None for tp, fp, fn, switches in run.totals]
        )


class Completeness(Measure):
    """Share of an object's frames in which it is matched, 0 to 1, mean over objects"""

    heading, short, brief, range = "completeness", "complete", False, (0.0, 1.0)

    def measured(self, run: ScoredRun) -> Measured:
        return Measured(list(run.completeness))


class Ospa(_OfFrames):
    """OSPA: distance between the set of objects and the set of tracks, per object, in m"""

    name, unit, heading, short, axis, brief = "ospa_m", "m", "OSPA m", "OSPA m", "OSPA (m)", False


class Gospa(_OfFrames):
    """GOSPA: the same summed over the objects, in m"""

    name, unit, heading, short, axis, brief = "gospa_m", "m", "GOSPA m", "GOSPA m", "GOSPA (m)", False


class _OfPairs(_OfFrames):
    """Mean of an error over the matched pairs of a frame; frames without a pair have none."""

    brief = False


class LengthError(_OfPairs):
    """Absolute error of the lengths of matched tracks, in m, mean over the pairs of a frame"""

    name, unit, heading, short, axis = "length_error_m", "m", "length error m", "length m", "length error (m)"


class WidthError(_OfPairs):
    """Absolute error of the widths of matched tracks, in m, mean over the pairs of a frame"""

    name, unit, heading, short, axis = "width_error_m", "m", "width error m", "width m", "width error (m)"


class HeadingError(_OfPairs):
    """Angle between the headings of a matched track and its object, 0 to 180 degrees, mean over the pairs of a frame"""

    name, unit, heading, short = "heading_error_deg", "deg", "heading error \u00b0", "heading \u00b0"
    axis, digits, range = "heading error (\u00b0)", 1, (0.0, 180.0)


class SpeedError(_OfPairs):
    """Absolute error of the speeds of matched tracks over ground, in m/s, mean over the pairs of a frame"""

    name, unit, heading, short, axis = "speed_error_mps", "m/s", "speed error m/s", "speed m/s", "speed error (m/s)"


class VelocityError(_OfPairs):
    """Length of the difference of velocities over ground, in m/s, mean over the pairs of a frame"""

    name, unit, heading, axis = "velocity_error_mps", "m/s", "velocity error m/s", "velocity error (m/s)"
    short = "velocity m/s"


class Overlap(_OfPairs):
    """Intersection over union of the volumes of matched pairs, 0 to 1, mean over the pairs of a frame"""

    name, heading, short, axis, range = "iou_3d", "3D IoU", "3D IoU", "3D IoU", (0.0, 1.0)


class _Ranked(Measure):
    """One of the values of `ranking.ranked_accuracy`."""

    brief = False

    def measured(self, run: ScoredRun) -> Measured:
        return Measured([each[self.label] for each in run.ranked])


class Amota(_Ranked):
    """Tracking accuracy averaged over levels of recall, with the tracks ranked by their scores, at most 1"""

    heading = "AMOTA"


class Samota(_Ranked):
    """The same, with the accuracy at each level relative to the best one possible there, 0 to 1"""

    heading, range = "sAMOTA", (0.0, 1.0)


class Amotp(_Ranked):
    """Mean distance of the centres of matched pairs, averaged over levels of recall, in m"""

    name, unit, heading = "amotp_m", "m", "AMOTP m"


#: Our metrics by name, in the order of tables.
MEASURES: dict[str, Measure] = {
    measure.label: measure
    for measure in (
        *(Missed(), FalseTracks(), Matched(), Rmse(), IdSwitches(), Precision(), Recall(), Mota(), Completeness()),
        *(Ospa(), Gospa(), Amota(), Samota(), Amotp()),
        *(LengthError(), WidthError(), HeadingError(), SpeedError(), VelocityError(), Overlap()),
    )
}
#: Names that users' metrics cannot have: columns of the table per frame, and entries of a summary.
SUMMARY_NAMES = (
    *("frame", "agent", "estimator", "scored", *MEASURES, "causes"),
    *("fn_split", "fp_split", "id_switches_split"),
)


#: Decimals of a double.
_MOST_DIGITS = 17


class StoredMetric(Quantity):
    """A user's metric of which the values are known, and what `described` says about it.

    key: its name;  about: of metrics.json, by the names of attributes; empty: nothing is known
    """

    def __init__(self, key: str, about: Mapping[str, Any]) -> None:
        self.key = key
        self.unit = str(about.get("unit", ""))
        self.digits = min(max(about.get("digits", self.digits), 0), _MOST_DIGITS)  # also of a received folder
        self.whole = about.get("whole", self.whole)
        self.range = range_of(about)
        self.heading = str(about.get("heading", "")) or key.replace("_", " ") + (f" ({self.unit})" * bool(self.unit))

    @property
    def label(self) -> str:
        return self.key


def described(metrics: Sequence[Metric]) -> dict[str, dict[str, Any]]:
    """What readers of metrics.json need to show users' metrics by name: heading, unit, digits, whole, range and `per`.

    Bounds that are infinite are None.
    """
    return {
        each.label: {
            "per": each.per,
            "heading": each.heading,
            "unit": each.unit,
            "digits": each.digits,
            "whole": each.whole,
            "range": [bound if math.isfinite(bound) else None for bound in each.range],
        }
        for each in metrics
    }


def own_metrics(summaries: Iterable[Mapping[str, Any]]) -> dict[str, Mapping[str, Any]]:
    """What `described` says in metrics.json of runs."""
    return {name: about for each in summaries for name, about in each.get("own_metrics", {}).items()}


def range_of(about: Mapping[str, Any]) -> tuple[float, float]:
    """Smallest and largest possible value of a metric that `described` describes; infinite: unknown."""
    low, high = about.get("range", (None, None))
    return -math.inf if low is None else low, math.inf if high is None else high


def metric_named(key: str, own: Mapping[str, Mapping[str, Any]]) -> Quantity:
    """Our metric of this name, or what is known of a user's.

    own: `own_metrics` of metrics.json, see `described`
    """
    return MEASURES.get(key) or StoredMetric(key, own.get(key, {}))


class Metric(Quantity, ABC):
    """Base class of user-defined metrics; subclass FrameMetric, RunMetric or MessageMetric instead.

    The class is in a scenario's file or in a file next to it, and named in the scenario:
    `evaluator=dict(metrics=[dict(type="MyMetric")])`.

    name:   name in tables; by default the class's, in lower case with underscores
    unit:   of its values, in the headings of tables
    digits: decimals in tables;  whole: whether its values are whole numbers
    range:  smallest and largest possible value, which bound the intervals of studies
    """

    @property
    @abstractmethod
    def per(self) -> str:
        """What has a value: "frame", "run" or "message"."""


class InvalidMetricValue(ValueError):
    """A metric returned an invalid value. about: the user's method that returned it."""

    def __init__(self, text: str, about: Callable[..., Any]) -> None:
        super().__init__(text)
        self.about = about


class FrameMetric(Metric, Measure):
    """A metric with a value in every frame.

    Its mean and standard deviation are over the scored frames.
    """

    per = "frame"

    @abstractmethod
    def per_frame(self, estimate: Estimate) -> Floats:
        """Values (f,), NaN where the metric is undefined."""

    def measured(self, run: ScoredRun) -> Measured:
        return _means(run.values(self), run.counts)

    def value(self, estimate: Estimate) -> Floats:
        """`per_frame`, checked. Raises InvalidMetricValue for anything but (f,) numbers."""
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


class RunMetric(Metric, Measure):
    """A metric with one value for the whole run."""

    per = "run"

    @abstractmethod
    def per_run(self, estimate: Estimate) -> float | None:
        """The value over the scored frames; None or a number that is not finite: undefined."""

    def measured(self, run: ScoredRun) -> Measured:
        return Measured([self.value(estimate) for estimate in run.estimates])

    def value(self, estimate: Estimate) -> float | None:
        """`per_run`, checked; None: undefined. Raises InvalidMetricValue for anything but a number or None."""
        value = self.per_run(estimate)
        if value is not None and not isinstance(value, (int, float, np.floating, np.integer)):
            name = type(self).__name__
            text = f"{name}.per_run: found {type(value).__name__}, expected a number or None"
            raise InvalidMetricValue(text, type(self).per_run)
        return None if value is None or not math.isfinite(value) else float(value)


class MessageMetric(Metric):
    """A metric of the messages of one type, on every wire that carries them, as they are sent.

    message: their type

    Its mean and standard deviation over the messages of each wire are in `messages` of metrics.json.
    """

    message: ClassVar[str] = ""
    per = "message"

    @abstractmethod
    def per_message(self, frame: int, subject: str, body: Mapping[str, NDArray[Any]]) -> float | None:
        """The value of a message; None: undefined.

        frame: that it is about; subject: the names in the key of its wire; body: its columns, which cannot be changed
        """


def check(metrics: Sequence[Metric], known: Sequence[str] = SUMMARY_NAMES) -> None:
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


def measured(
    metrics: Sequence[Measure], run: ScoredRun
) -> tuple[dict[str, dict[str, dict[str, Any]]], Table, dict[str, BaseException]]:
    """Values of metrics: summaries by agent, estimator and name, columns of the table per frame, and errors by name.

    The table has a row per series (equal ones included) and frame. A metric that raises is undefined for every series:
    NaN in every frame, or None.
    """
    every = run.scores.every_series
    rows = np.array(list(every.values()), np.int64)
    summary: dict[str, dict[str, dict[str, Any]]] = {}
    for agent, estimator in every:
        summary.setdefault(agent, {})[estimator] = {}
    table: Table = {}
    errors: dict[str, BaseException] = {}
    for metric in metrics:
        label = metric.label
        try:
            values = metric.measured(run)
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # GeneratorExit and CancelledError are not Exceptions
            if not isinstance(metric, Metric):
                raise
            errors[label], values = error, _undefined(metric, run.scores)
        for (agent, estimator), row in every.items():
            summary[agent][estimator][label] = values.summaries[row]
        if values.frames is not None:
            table[label] = values.frames[rows].ravel()
    return summary, table, errors


def _undefined(metric: Metric, scores: FrameScores) -> Measured:
    shape = len(scores.series), len(scores.frames)
    if isinstance(metric, FrameMetric):
        return Measured([mean_and_std(np.zeros(0))] * shape[0], np.full(shape, np.nan))
    return Measured([None] * shape[0])


def per_frame(scores: Scores) -> Table:
    """A row per series and frame.

    Columns: frame, agent, estimator, fn, fp, tp, rmse_m, id_switches, ospa_m, gospa_m, length_error_m, width_error_m,
    heading_error_deg, speed_error_mps, velocity_error_mps, iou_3d. Errors of pairs are NaN without a pair.
    """
    return frame_keys(scores) | measured([each for each in MEASURES.values() if each.axis], ScoredRun(scores))[1]


def frame_keys(scores: FrameScores) -> Table:
    """The columns frame, agent and estimator of the table per frame.

    Columns:
    frame: number of the frame, from 0
    agent, estimator: whose estimate of which kind
    """
    every, f = list(scores.every_series), len(scores.frames)
    return {
        "frame": np.tile(scores.frames, len(every)),
        "agent": np.repeat(np.array([agent for agent, _ in every], str), f),
        "estimator": np.repeat(np.array([estimator for _, estimator in every], str), f),
    }
