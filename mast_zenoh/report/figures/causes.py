"""The chart of the ego's missed and false objects over time, stacked by cause."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from mast_zenoh.metrics import ATTACK_CAUSES, CAUSES, DEFENCE_CAUSES, FAULT_CAUSES
from mast_zenoh.report.figures.bands import HATCH, bands, shade
from mast_zenoh.report.figures.style import ADVERSARY_ON_LIGHT, FAULT_ON_LIGHT, INK, Figure, light_axes
from mast_zenoh.report.figures.timeaxis import padded, rows_over_time
from mast_zenoh.report.runfolder import RunFolder

_ROWS = (("truth", "missed", "missed objects"), ("track", "false", "false objects"))
#: From the bottom up: natural causes in greys, then links and faults, the defence, then attacks.
_NATURAL = tuple(cause for cause in CAUSES if cause not in (*FAULT_CAUSES, *DEFENCE_CAUSES, *ATTACK_CAUSES))
_GREYS = ("#4b535d", "#6f7883", "#939ba6", "#b4bac3", "#d0d5db", "#e6e9ec")
_HOSTILE = (ADVERSARY_ON_LIGHT, "#d35fbb", "#e391cf", "#f0c4e5")
_COLOURS = {
    **dict(zip(_NATURAL, _GREYS, strict=True)),
    **dict.fromkeys(FAULT_CAUSES, "#d9b25c"),
    **dict.fromkeys(DEFENCE_CAUSES, "#3f8f8a"),
    **dict(zip(ATTACK_CAUSES, _HOSTILE, strict=True)),
}


def causes_over_time(run: RunFolder, frame: int | None) -> Figure | None:
    """Missed and false objects of the ego's picture by time, stacked by cause.

    frame: marked by a line, if given

    Returns None if there is no link, fault or withheld object, or causes are not known.
    """
    objects, counts = run.objects, run.counts_of("picture")
    if not (run.faulted or run.withholds) or counts is None or objects is None or "cause" not in objects:
        return None
    frames = counts["frame"].astype(np.int64)
    seconds = run.seconds(frames)
    times: NDArray[np.float64] = frames.astype(np.float64) if seconds is None else seconds
    marked = bands([run], timed=seconds is not None)
    extent = float(times[0]), float(times[-1])
    figure, axes = rows_over_time(len(_ROWS), 1.9, marked, *extent)
    in_picture = objects["estimator"] == "picture"
    first, last = run.metrics.get("scored_frames") or (frames[0], frames[-1])
    scored = (frames >= first) & (frames <= last)
    for axis, (kind, outcome, label) in zip(axes, _ROWS, strict=True):
        light_axes(axis)
        shade(axis, marked, *extent, hatch=False)
        errors = in_picture & (objects["kind"] == kind) & (objects["outcome"] == outcome)
        below = np.zeros(len(frames))
        for cause, colour in _COLOURS.items():
            index = np.searchsorted(frames, objects["frame"][errors & (objects["cause"] == cause)])
            if not len(index):
                continue
            above = below + np.bincount(index, minlength=len(frames))[: len(frames)]
            hatch: dict[str, Any] = {"hatch": HATCH, "edgecolor": FAULT_ON_LIGHT} if cause in FAULT_CAUSES else {}
            axis.fill_between(times, below, above, step="mid", facecolor=colour, linewidth=0, label=cause, **hatch)
            below = above
        if frame is not None:
            time = np.interp(frame, frames, times)
            axis.axvline(float(time), color=INK, linewidth=0.9)
        axis.set_ylabel(f"{label}\nper frame", fontsize=10, color=INK)
        axis.set_ylim(0.0, max(1.08 * below[scored].max(initial=0.0), 2.0))
        axis.set_xlim(*padded(*extent))
        axis.yaxis.set_major_locator(MaxNLocator(4, integer=True))
    axes[-1].set_xlabel("frame" if seconds is None else "time (s)", fontsize=10, color=INK)
    handles = {label: handle for axis in axes for handle, label in zip(*axis.get_legend_handles_labels(), strict=True)}
    order = [cause for cause in _COLOURS if cause in handles]
    figure.legend(
        [handles[cause] for cause in order],
        order,
        loc="upper left",
        bbox_to_anchor=(0.055, 1.0),
        ncols=9,
        frameon=False,
        fontsize=10,
        columnspacing=1.3,
        handlelength=1.5,
    )
    return figure
