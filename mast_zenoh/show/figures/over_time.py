"""Charts over time: counts of one run or several, causes of errors, driving."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from mast_zenoh.metrics import ATTACK_CAUSES, CAUSES, DEFENCE_CAUSES, FAULT_CAUSES
from mast_zenoh.metrics.estimates import OWN, column_name
from mast_zenoh.metrics.measures import metric_named, own_metrics
from mast_zenoh.runs.files import Table, are_in, rows
from mast_zenoh.runs.run import Run
from mast_zenoh.show.figures.style import LINE_STYLES, Figure, light_axes, plain
from mast_zenoh.show.figures.timeaxis import HATCH, bands, fault_legend, padded, rows_over_time, shade
from mast_zenoh.show.findings.changes import scored
from mast_zenoh.show.palette import ADVERSARY_ON_LIGHT, FAULT_ON_LIGHT, INK, LOCAL, RUN_COLOURS
from mast_zenoh.show.tables.of_run import DRIVEN_BY
from mast_zenoh.show.tables.scores import shown_estimates

#: Columns that the report shows.
REPORT_COLUMNS = ("fn", "fp", "rmse_m")
#: The bold lines are means over this many past frames. Future frames are not used, so that no line rises before an
#: attack begins.
SMOOTH = 5


def counts_over_time(
    runs: Mapping[str, Run],
    frame: int | None,
    estimate: str = "picture",
    columns: Sequence[str] = REPORT_COLUMNS,
) -> Figure | None:
    """Columns of the ego's counts over time, in stacked charts; None: no counts.

    For one run: every estimate that has a column in the table. For several: the ego alone in the first run, and
    `estimate` of each run. Bold lines are means over the last SMOOTH frames, pale lines the values of single frames.
    """
    runs_with_counts = {label: run for label, run in runs.items() if run.counts_of("picture") is not None}
    if not runs_with_counts:
        return None
    lines = _lines(runs_with_counts, estimate)
    timed = all(run.seconds(counts["frame"]) is not None for _, run, counts, _ in lines)

    def times(run: Run, frames: NDArray[Any]) -> NDArray[np.float64]:
        seconds = run.seconds(frames) if timed else None
        return frames.astype(np.float64) if seconds is None else seconds

    marked = bands(runs.values(), timed=timed)
    line_times = [times(run, counts["frame"]) for _, run, counts, _ in lines]
    extent = min(at[0] for at in line_times), max(at[-1] for at in line_times)
    figure, axes = rows_over_time(len(columns), 1.66 if len(columns) > 1 else 3.0, marked, *extent)
    attacked = [times(run, np.array(run.attack_frames)) for run in runs.values() if run.attack_frames]
    described = own_metrics(run.files.summary for run in runs.values())
    for axis, column in zip(axes, columns, strict=True):
        measure = metric_named(column, described)
        light_axes(axis)
        shade(axis, marked, *extent)
        if attacked:
            start, end = min(band[0] for band in attacked), max(band[1] for band in attacked)
            axis.axvspan(start, end, color=ADVERSARY_ON_LIGHT, alpha=0.07, linewidth=0, label="attack")
            axis.axvline(start, color=ADVERSARY_ON_LIGHT, linewidth=0.9, alpha=0.6)
        for name, run, counts, style in lines:
            _line(axis, times(run, counts["frame"]), counts[column].astype(np.float64), style, name)
        if frame is not None:
            first = next(iter(runs_with_counts.values()))
            axis.axvline(float(times(first, np.array([frame]))[0]), color=INK, linewidth=0.9, label="frame shown")
        axis.set_ylabel(measure.axis or plain(measure.heading), fontsize=10, color=INK)
        axis.set_ylim(0.0, _top(lines, column))
        axis.set_xlim(*padded(*extent))
        axis.yaxis.set_major_locator(MaxNLocator(4, integer=measure.whole))
    axes[-1].set_xlabel("time (s)" if timed else "frame", fontsize=10, color=INK)
    handles, labels = axes[0].get_legend_handles_labels()
    if marked:
        handles, labels = [fault_legend(), *handles], ["fault", *labels]
    legend_above(figure, dict(zip(labels, handles, strict=True)), 7)
    return figure


def _top(lines: list[tuple[str, Run, Table, _LineStyle]], column: str) -> float:
    """The upper limit of an axis, above all values in scored frames."""
    maxima = [
        float(np.nanmax(counts[column][inside].astype(np.float64), initial=0.0))
        for _, run, counts, _ in lines
        if (inside := scored(run, counts["frame"])).any()
    ]
    return 1.08 * max(maxima, default=0.0) or 1.0


class _LineStyle(NamedTuple):
    colour: str
    style: object
    width: float = 1.9


_ALONE = _LineStyle(LOCAL, (0, (1, 1)))


def _look(index: int, width: float = 1.9) -> _LineStyle:
    """The style of one of several lines."""
    return _LineStyle(RUN_COLOURS[index % len(RUN_COLOURS)], LINE_STYLES[index % len(LINE_STYLES)], width)


def _lines(runs: Mapping[str, Run], estimate: str) -> list[tuple[str, Run, Table, _LineStyle]]:
    """Name, run, counts and style of each line."""
    first = next(iter(runs.values()))
    lines = [("ego alone", first, first.counts_of("local"), _ALONE)]
    if len(runs) == 1:
        names = [name for name in shown_estimates([first.files.summary], first.ego or "") if name not in OWN]
        for index, name in enumerate(names):
            lines.append(
                (column_name(name), first, first.counts_of(name), _look(index, 2.4 if name == "picture" else 1.6))
            )
    else:
        for index, (label, run) in enumerate(runs.items()):
            lines.append((f"{column_name(estimate)}, {label}", run, run.counts_of(estimate), _look(index)))
    return [(name, run, counts, line_style) for name, run, counts, line_style in lines if counts is not None]


def _line(axis: Axes, x: NDArray[np.float64], y: NDArray[np.float64], look: _LineStyle, label: str) -> None:
    axis.plot(x, y, color=look.colour, linewidth=0.8, alpha=0.30, drawstyle="steps-mid")
    known = np.isfinite(y)
    x, y = x[known], y[known]
    if len(y) == 0:
        return
    last = np.arange(1, len(y) + 1)
    since = np.maximum(last - SMOOTH, 0)
    total = np.concatenate([[0.0], np.cumsum(y)])
    smooth = (total[last] - total[since]) / (last - since)
    axis.plot(x, smooth, color=look.colour, linewidth=look.width, linestyle=look.style, label=plain(label))


_CAUSE_ROWS = (("truth", "missed", "missed objects"), ("track", "false", "false objects"))
#: From the bottom up: natural causes in greys, then links and faults, the defence, then attacks.
_NATURAL = tuple(cause for cause in CAUSES if cause not in (*FAULT_CAUSES, *DEFENCE_CAUSES, *ATTACK_CAUSES))
_GREYS = ("#4b535d", "#6f7883", "#939ba6", "#b4bac3", "#d0d5db", "#e6e9ec")
_HOSTILE = (ADVERSARY_ON_LIGHT, "#d35fbb", "#e391cf", "#f0c4e5")
_CAUSE_COLOURS = {
    **dict(zip(_NATURAL, _GREYS, strict=True)),
    **dict.fromkeys(FAULT_CAUSES, "#d9b25c"),
    **dict.fromkeys(DEFENCE_CAUSES, "#3f8f8a"),
    **dict(zip(ATTACK_CAUSES, _HOSTILE, strict=True)),
}


def legend_above(figure: Figure, handles: Mapping[str, Any], columns: int, **style: Any) -> None:
    """A legend above stacked charts; handles: by label."""
    place: dict[str, Any] = {"loc": "upper left", "bbox_to_anchor": (0.055, 1.0)}
    style = {"frameon": False, "fontsize": 10, "ncols": columns} | place | style
    figure.legend(list(handles.values()), list(handles), **style)


def handles_of(axes: Sequence[Axes]) -> dict[str, Any]:
    """The legend entries of all charts by label."""
    return {label: handle for axis in axes for handle, label in zip(*axis.get_legend_handles_labels(), strict=True)}


def _rows_of(
    run: Run, frames: NDArray[Any], count: int, height: float, frame: int | None
) -> tuple[Figure, Sequence[Axes], NDArray[np.float64]]:
    """A figure of stacked charts of a run, with its faults and a line at `frame`, and the times of its frames."""
    seconds = run.seconds(frames)
    times: NDArray[np.float64] = frames.astype(np.float64) if seconds is None else seconds
    marked, extent = bands([run], timed=seconds is not None), (float(times[0]), float(times[-1]))
    figure, axes = rows_over_time(count, height, marked, *extent)
    for axis in axes:
        light_axes(axis)
        shade(axis, marked, *extent, hatch=False)
        axis.set_xlim(*padded(*extent))
        if frame is not None:
            axis.axvline(float(np.interp(frame, frames, times)), color=INK, linewidth=0.9)
    axes[-1].set_xlabel("frame" if seconds is None else "time (s)", fontsize=10, color=INK)
    return figure, axes, times


def causes_over_time(run: Run, frame: int | None) -> Figure | None:
    """Missed and false objects of the ego's picture by time, stacked by cause.

    frame: marked by a line, if given

    Returns None if there is no link, fault or withheld object, or causes are not known.
    """
    objects, counts = run.files.objects, run.counts_of("picture")
    if not (run.faulted or run.withholds) or counts is None or objects is None:
        return None
    frames = counts["frame"].astype(np.int64)
    frames = frames[are_in(run.files.sample, frames)]
    figure, axes, times = _rows_of(run, frames, len(_CAUSE_ROWS), 1.9, frame)
    in_picture = objects["estimator"] == "picture"
    first, last = run.files.summary.get("scored_frames") or (frames[0], frames[-1])
    scored = (frames >= first) & (frames <= last)
    for axis, (kind, outcome, label) in zip(axes, _CAUSE_ROWS, strict=True):
        errors = in_picture & (objects["kind"] == kind) & (objects["outcome"] == outcome)
        below = np.zeros(len(frames))
        for cause, colour in _CAUSE_COLOURS.items():
            index = np.searchsorted(frames, objects["frame"][errors & (objects["cause"] == cause)])
            if not len(index):
                continue
            above = below + np.bincount(index, minlength=len(frames))[: len(frames)]
            hatch: dict[str, Any] = {"hatch": HATCH, "edgecolor": FAULT_ON_LIGHT} if cause in FAULT_CAUSES else {}
            axis.fill_between(times, below, above, step="mid", facecolor=colour, linewidth=0, label=cause, **hatch)
            below = above
        axis.set_ylabel(f"{label}\nper frame", fontsize=10, color=INK)
        axis.set_ylim(0.0, max(1.08 * below[scored].max(initial=0.0), 2.0))
        axis.yaxis.set_major_locator(MaxNLocator(4, integer=True))
    handles = handles_of(axes)
    order = {cause: handles[cause] for cause in _CAUSE_COLOURS if cause in handles}
    legend_above(figure, order, 9, columnspacing=1.3, handlelength=1.5)
    return figure


_DRIVING_COLOURS = {"truth": INK, "local": LOCAL, "mission": RUN_COLOURS[1]}
_DRIVING_STYLES = {"truth": (0, (4, 2)), "local": (0, (1, 1)), "mission": "-"}
#: s, the largest time to collision in the chart.
_MAX_TTC_S = 10.0
#: Colour and label of braking decisions by estimate and truth.
_BRAKING = {
    "brake": ("#9aa3ad", "brakes, and so does the truth"),
    "needless": ("#d62839", "brakes needlessly"),
    "omitted": ("#e0a800", "fails to brake when it must"),
}


def driving_over_time(run: Run, frame: int | None) -> Figure | None:
    """Time to collision, wrong objects and braking over time; None: not a vehicle."""
    if run.files.driving is None or not np.any(run.files.driving["agent"] == run.ego):
        return None
    ego_rows = rows(run.files.driving, run.files.driving["agent"] == run.ego)
    parts = {
        name: rows(ego_rows, ego_rows["estimate"] == name) for name in DRIVEN_BY if np.any(ego_rows["estimate"] == name)
    }
    frames = parts[next(iter(parts))]["frame"].astype(np.int64)
    figure, axes, times = _rows_of(run, frames, 3, 1.5, frame)
    if run.attack_frames is not None:
        first, last = np.interp(run.attack_frames, frames, times)
        for axis in axes:
            axis.axvspan(float(first), float(last), color=ADVERSARY_ON_LIGHT, alpha=0.07, linewidth=0)
    _draw_collision(axes[0], times, parts)
    _draw_corridor(axes[1], times, parts, scored(run, frames))
    _draw_braking(axes[2], times, parts)
    legend_above(figure, handles_of(axes), 8, fontsize=9, columnspacing=1.0, handlelength=1.6)
    return figure


def _draw_collision(axis: Axes, times: np.ndarray, parts: dict[str, Table]) -> None:
    for name, part in parts.items():
        ttc = np.nan_to_num(part["ttc_s"].astype(np.float64), nan=np.inf)
        visible = np.where(ttc <= _MAX_TTC_S, ttc, np.nan)
        look: dict[str, Any] = {"color": _DRIVING_COLOURS[name], "linestyle": _DRIVING_STYLES[name], "linewidth": 1.8}
        axis.plot(times, visible, marker=".", markersize=3, label=DRIVEN_BY[name], **look)
    if not any((part["ttc_s"].astype(np.float64) <= _MAX_TTC_S).any() for part in parts.values()):
        _annotate(axis, f"nothing in the way within {_MAX_TTC_S:.0f} s in any of the three")
    axis.set_ylim(0.0, _MAX_TTC_S)
    axis.set_ylabel("time to\ncollision (s)", fontsize=10, color=INK)


def _draw_corridor(axis: Axes, times: np.ndarray, parts: dict[str, Table], in_scored_frames: np.ndarray) -> None:
    maximum = 1.0
    for name, part in parts.items():
        wrong = (part["false"] + part["missed"]).astype(np.float64)
        if name != "truth":
            look: dict[str, Any] = {"color": _DRIVING_COLOURS[name], "linestyle": _DRIVING_STYLES[name]}
            axis.plot(times, wrong, drawstyle="steps-mid", linewidth=1.6, **look)
            maximum = max(maximum, float(wrong[in_scored_frames].max(initial=0.0)))
    axis.set_ylim(0.0, 1.1 * maximum)
    axis.yaxis.set_major_locator(MaxNLocator(4, integer=True))
    axis.set_ylabel("wrong objects\nin corridor", fontsize=10, color=INK)


def _draw_braking(axis: Axes, times: np.ndarray, parts: dict[str, Table]) -> None:
    """A lane per estimate: when it brakes, and whether it should."""
    step = float(np.median(np.diff(times))) if len(times) > 1 else 1.0
    labelled: set[str] = set()
    for lane, part in enumerate(reversed(list(parts.values()))):
        wrong = part["needless"].astype(bool) | part["omitted"].astype(bool)
        for kind, (colour, words) in _BRAKING.items():
            mask = part[kind].astype(bool) & (~wrong if kind == "brake" else True)
            spans = _spans(times, mask, step)
            if spans or kind not in labelled:
                label = "" if kind in labelled else words
                axis.broken_barh(spans, (lane + 0.12, 0.76), facecolors=colour, label=label)
                labelled.add(kind)
    if not any(part[kind].any() for part in parts.values() for kind in _BRAKING):
        _annotate(axis, "no braking in any of the three")
    names = [DRIVEN_BY[name].replace(" with ", " with\n") for name in reversed(parts)]
    axis.set_yticks(np.arange(len(parts)) + 0.5, names, fontsize=8)
    axis.set_ylim(0.0, len(parts))
    axis.grid(visible=False)


def _annotate(axis: Axes, message: str) -> None:
    """Write into an empty chart why it is empty."""
    box = {"facecolor": "white", "edgecolor": "none", "pad": 3.0}
    placement: dict[str, Any] = {"transform": axis.transAxes, "ha": "center", "va": "center", "zorder": 5}
    axis.text(0.5, 0.5, message, fontsize=9, color=LOCAL, bbox=box, **placement)


def _spans(times: np.ndarray, mask: np.ndarray, step: float) -> list[tuple[float, float]]:
    """(start, length) of each run of frames in a mask.

    A frame lasts one step and is centred on its time.
    """
    edges = np.diff(mask.astype(np.int64), prepend=0, append=0)
    first, last = np.flatnonzero(edges > 0), np.flatnonzero(edges < 0) - 1
    return [(float(times[a]) - step / 2, float(times[b] - times[a]) + step) for a, b in zip(first, last, strict=True)]
