"""Charts of counts: over time for one run or several, and means side by side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from mast_zenoh.report.bands import bands, fault_key, shade
from mast_zenoh.report.runfolder import RunFolder
from mast_zenoh.report.style import ADVERSARY_ON_LIGHT, INK, LOCAL, RUN_COLOURS, light_axes, plain
from mast_zenoh.report.table import SummaryRow
from mast_zenoh.report.timeaxis import padded, rows_over_time

_ROWS = (("fn", "missed objects"), ("fp", "false objects"), ("tp", "matched objects"))
_STYLES = ("-", (0, (6, 1.5)), (0, (2, 1)), (0, (6, 1, 1, 1)), "-", (0, (6, 1.5)))
#: The bold lines are means over this many frames up to the one shown: never later ones, so that nothing seems to
#: rise before the attack begins.
SMOOTH = 5


def counts_over_time(runs: Mapping[str, RunFolder], frame: int | None) -> Figure | None:
    """The ego's FN, FP and TP by time: its own tracks, and the picture of each run; None: no run left counts.

    Of one run, `runs` has one entry. Bold lines are means over the last SMOOTH frames, pale ones the counts
    themselves.
    """
    told = {label: table for label, run in runs.items() if (table := run.counts_of("picture")) is not None}
    if not told:
        return None
    first = runs[next(iter(told))]
    timed = all(runs[label].seconds(table["frame"]) is not None for label, table in told.items())

    def times(run: RunFolder, frames: NDArray[np.int64]) -> NDArray[np.float64]:
        seconds = run.seconds(frames) if timed else None
        return frames.astype(np.float64) if seconds is None else seconds

    marked = bands(runs.values(), timed=timed)
    shown = [times(runs[label], table["frame"]) for label, table in told.items()]
    extent = min(at[0] for at in shown), max(at[-1] for at in shown)
    figure, axes = rows_over_time(len(_ROWS), 1.66, marked, *extent)
    attacked = [times(run, np.array(run.attack_frames)) for run in runs.values() if run.attack_frames]
    local = first.counts_of("local")
    for axis, (column, label) in zip(axes, _ROWS, strict=True):
        light_axes(axis)
        shade(axis, marked, *extent)
        if attacked:
            start, end = min(band[0] for band in attacked), max(band[1] for band in attacked)
            axis.axvspan(start, end, color=ADVERSARY_ON_LIGHT, alpha=0.07, linewidth=0, label="attack")
            axis.axvline(start, color=ADVERSARY_ON_LIGHT, linewidth=0.9, alpha=0.6)
        if local is not None:
            _line(axis, times(first, local["frame"]), local[column], LOCAL, (0, (1, 1)), "ego alone")
        for index, (name, table) in enumerate(told.items()):
            style = _STYLES[index % len(_STYLES)]
            text = "picture" if len(runs) == 1 else f"picture, {name}"
            colour = RUN_COLOURS[index % len(RUN_COLOURS)]
            _line(axis, times(runs[name], table["frame"]), table[column], colour, style, text)
        if frame is not None:
            axis.axvline(float(times(first, np.array([frame]))[0]), color=INK, linewidth=0.9, label="frame shown")
        axis.set_ylabel(f"{label}\nper frame", fontsize=10, color=INK)
        axis.set_ylim(bottom=0)
        axis.set_xlim(*padded(*extent))
        axis.yaxis.set_major_locator(MaxNLocator(4, integer=True))
    axes[-1].set_xlabel("time (s)" if timed else "frame", fontsize=10, color=INK)
    handles, labels = axes[0].get_legend_handles_labels()
    if marked:
        handles, labels = [fault_key(), *handles], ["fault", *labels]
    figure.legend(handles, labels, loc="upper left", bbox_to_anchor=(0.055, 1.0), ncols=7, frameon=False, fontsize=10)
    return figure


def _line(axis: Axes, x: NDArray[np.float64], y: NDArray[np.float64], colour: str, style: object, label: str) -> None:
    axis.plot(x, y, color=colour, linewidth=0.8, alpha=0.30, drawstyle="steps-mid")
    if len(y) == 0:
        return
    last = np.arange(1, len(y) + 1)
    since = np.maximum(last - SMOOTH, 0)
    total = np.concatenate([[0.0], np.cumsum(y)])
    smooth = (total[last] - total[since]) / (last - since)
    axis.plot(x, smooth, color=colour, linewidth=1.9, linestyle=style, label=plain(label))


def means(rows: Sequence[SummaryRow], alone: str) -> Figure:
    """Grouped bars of the means per frame: the ego alone in the first row's run, then each row's picture.

    Whiskers are one standard deviation over frames. `alone` labels the bars of the ego's own tracks.
    """
    figure = Figure(figsize=(11.5, 3.6), facecolor="white")
    axis = figure.subplots()
    figure.subplots_adjust(left=0.065, right=0.985, top=0.86, bottom=0.10)
    light_axes(axis)
    bars = [(alone, LOCAL, rows[0].local)]
    bars += [(row.run, RUN_COLOURS[i % len(RUN_COLOURS)], row.picture) for i, row in enumerate(rows)]
    width = 0.8 / len(bars)
    for index, (label, colour, scores) in enumerate(bars):
        values = [getattr(scores, column) for column, _ in _ROWS]
        at = np.arange(3) + (index - (len(bars) - 1) / 2) * width
        heights = [np.nan if value.mean is None else value.mean for value in values]
        spread = [0.0 if value.std is None else value.std for value in values]
        below = np.minimum(spread, np.nan_to_num(heights))
        axis.bar(
            at,
            heights,
            width * 0.9,
            yerr=np.stack([below, spread]),
            color=colour,
            ecolor=INK,
            error_kw={"elinewidth": 0.9, "capsize": 2.5, "alpha": 0.7},
            label=plain(label),
        )
        for x, height, up in zip(at, heights, spread, strict=True):
            if np.isfinite(height):
                axis.annotate(
                    f"{height:.2f}",
                    (x, height + up),
                    (0, 2),
                    textcoords="offset points",
                    ha="center",
                    va="bottom",
                    fontsize=9 if len(bars) <= 5 else 7,
                    color=INK,
                )
    axis.set_xticks(range(3), [label for _, label in _ROWS], fontsize=11)
    axis.set_ylabel("mean per frame", fontsize=10, color=INK)
    axis.margins(y=0.12)
    figure.legend(loc="upper left", bbox_to_anchor=(0.055, 1.0), ncols=7, frameon=False, fontsize=10)
    return figure
