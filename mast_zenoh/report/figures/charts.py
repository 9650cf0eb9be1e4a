"""Charts of counts over time for one run or several."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from mast_zenoh.report.figures.bands import bands, fault_legend, shade
from mast_zenoh.report.figures.style import ADVERSARY_ON_LIGHT, INK, LOCAL, RUN_COLOURS, Figure, light_axes, plain
from mast_zenoh.report.figures.timeaxis import padded, rows_over_time
from mast_zenoh.report.files import Table
from mast_zenoh.report.narrative.changes import scored
from mast_zenoh.report.runfolder import RunFolder
from mast_zenoh.report.tables.scores import ESTIMATES, shown_estimates

_LABELS = {
    "fn": "missed objects\nper frame",
    "fp": "false objects\nper frame",
    "tp": "matched objects\nper frame",
    "rmse_m": "RMSE (m)",
    "id_switches": "identity switches\nper frame",
    "ospa_m": "OSPA (m)",
    "gospa_m": "GOSPA (m)",
}
#: Columns that the report shows.
REPORT_COLUMNS = ("fn", "fp", "rmse_m")
_WHOLE = ("fn", "fp", "tp", "id_switches")
_STYLES = ("-", (0, (6, 1.5)), (0, (2, 1)), (0, (6, 1, 1, 1)), "-", (0, (6, 1.5)))
#: The bold lines are means over this many past frames. Future frames are not used, so that no line rises before an
#: attack begins.
SMOOTH = 5


def counts_over_time(
    runs: Mapping[str, RunFolder],
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

    def times(run: RunFolder, frames: NDArray[Any]) -> NDArray[np.float64]:
        seconds = run.seconds(frames) if timed else None
        return frames.astype(np.float64) if seconds is None else seconds

    marked = bands(runs.values(), timed=timed)
    line_times = [times(run, counts["frame"]) for _, run, counts, _ in lines]
    extent = min(at[0] for at in line_times), max(at[-1] for at in line_times)
    figure, axes = rows_over_time(len(columns), 1.66 if len(columns) > 1 else 3.0, marked, *extent)
    attacked = [times(run, np.array(run.attack_frames)) for run in runs.values() if run.attack_frames]
    for axis, column in zip(axes, columns, strict=True):
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
        axis.set_ylabel(_LABELS.get(column, plain(column.replace("_", " "))), fontsize=10, color=INK)
        axis.set_ylim(0.0, _top(lines, column))
        axis.set_xlim(*padded(*extent))
        axis.yaxis.set_major_locator(MaxNLocator(4, integer=column in _WHOLE))
    axes[-1].set_xlabel("time (s)" if timed else "frame", fontsize=10, color=INK)
    handles, labels = axes[0].get_legend_handles_labels()
    if marked:
        handles, labels = [fault_legend(), *handles], ["fault", *labels]
    figure.legend(handles, labels, loc="upper left", bbox_to_anchor=(0.055, 1.0), ncols=7, frameon=False, fontsize=10)
    return figure


def _top(lines: list[tuple[str, RunFolder, Table, _LineStyle]], column: str) -> float:
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


def _lines(runs: Mapping[str, RunFolder], estimate: str) -> list[tuple[str, RunFolder, Table, _LineStyle]]:
    """Name, run, counts and style of each line."""
    first = next(iter(runs.values()))
    lines = [("ego alone", first, first.counts_of("local"), _ALONE)]
    if len(runs) == 1:
        names = [
            name for name in shown_estimates([first.metrics], first.ego or "") if name not in ("local", "received")
        ]
        for index, name in enumerate(names):
            line_style = _LineStyle(RUN_COLOURS[index], _STYLES[index], 2.4 if name == "picture" else 1.6)
            lines.append((ESTIMATES[name], first, first.counts_of(name), line_style))
    else:
        for index, (label, run) in enumerate(runs.items()):
            line_style = _LineStyle(RUN_COLOURS[index % len(RUN_COLOURS)], _STYLES[index % len(_STYLES)])
            lines.append((f"{ESTIMATES[estimate]}, {label}", run, run.counts_of(estimate), line_style))
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
