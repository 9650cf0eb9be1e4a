"""Consequences of the estimates for driving, as a chart over time."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from mast_zenoh.report.figures.bands import bands, shade
from mast_zenoh.report.figures.style import ADVERSARY_ON_LIGHT, INK, LOCAL, RUN_COLOURS, Figure, light_axes
from mast_zenoh.report.figures.timeaxis import padded, rows_over_time
from mast_zenoh.report.files import Table, rows
from mast_zenoh.report.narrative.changes import scored
from mast_zenoh.report.runfolder import RunFolder
from mast_zenoh.report.tables.driving import ESTIMATES

_COLOURS = {"truth": INK, "local": LOCAL, "mission": RUN_COLOURS[1]}
_STYLES = {"truth": (0, (4, 2)), "local": (0, (1, 1)), "mission": "-"}
#: s, the largest time to collision in the chart.
_MAX_TTC_S = 10.0
#: Colour and label of braking decisions by estimate and truth.
_BRAKING = {
    "brake": ("#9aa3ad", "brakes, and so does the truth"),
    "needless": ("#d62839", "brakes needlessly"),
    "omitted": ("#e0a800", "fails to brake when it must"),
}


def driving_over_time(run: RunFolder, frame: int | None) -> Figure | None:
    """Time to collision, wrong objects and braking over time; None: not a vehicle."""
    if run.driving is None or not np.any(run.driving["agent"] == run.ego):
        return None
    ego_rows = rows(run.driving, run.driving["agent"] == run.ego)
    parts = {
        name: rows(ego_rows, ego_rows["estimate"] == name) for name in ESTIMATES if np.any(ego_rows["estimate"] == name)
    }
    frames = parts[next(iter(parts))]["frame"].astype(np.int64)
    seconds = run.seconds(frames)
    times = frames.astype(np.float64) if seconds is None else seconds
    marked = bands([run], timed=seconds is not None)
    extent = float(times[0]), float(times[-1])
    figure, axes = rows_over_time(3, 1.5, marked, *extent)
    for axis in axes:
        light_axes(axis)
        shade(axis, marked, *extent, hatch=False)
        axis.set_xlim(*padded(*extent))
        if frame is not None:
            axis.axvline(float(np.interp(frame, frames, times)), color=INK, linewidth=0.9)
        if run.attack_frames is not None:
            first, last = np.interp(run.attack_frames, frames, times)
            axis.axvspan(float(first), float(last), color=ADVERSARY_ON_LIGHT, alpha=0.07, linewidth=0)
    _draw_collision(axes[0], times, parts)
    _draw_corridor(axes[1], times, parts, scored(run, frames))
    _draw_braking(axes[2], times, parts)
    axes[-1].set_xlabel("frame" if seconds is None else "time (s)", fontsize=10, color=INK)
    handles: dict[str, Any] = {}
    for axis in axes:
        handles |= {label: handle for handle, label in zip(*axis.get_legend_handles_labels(), strict=True)}
    figure.legend(
        list(handles.values()),
        list(handles),
        loc="upper left",
        bbox_to_anchor=(0.055, 1.0),
        ncols=8,
        frameon=False,
        fontsize=9,
        columnspacing=1.0,
        handlelength=1.6,
    )
    return figure


def _draw_collision(axis: Axes, times: np.ndarray, parts: dict[str, Table]) -> None:
    for name, part in parts.items():
        ttc = np.nan_to_num(part["ttc_s"].astype(np.float64), nan=np.inf)
        visible = np.where(ttc <= _MAX_TTC_S, ttc, np.nan)
        axis.plot(
            times,
            visible,
            color=_COLOURS[name],
            linestyle=_STYLES[name],
            linewidth=1.8,
            marker=".",
            markersize=3,
            label=ESTIMATES[name],
        )
    if not any((part["ttc_s"].astype(np.float64) <= _MAX_TTC_S).any() for part in parts.values()):
        _annotate(axis, f"nothing in the way within {_MAX_TTC_S:.0f} s in any of the three")
    axis.set_ylim(0.0, _MAX_TTC_S)
    axis.set_ylabel("time to\ncollision (s)", fontsize=10, color=INK)


def _draw_corridor(axis: Axes, times: np.ndarray, parts: dict[str, Table], in_scored_frames: np.ndarray) -> None:
    maximum = 1.0
    for name, part in parts.items():
        wrong = (part["false"] + part["missed"]).astype(np.float64)
        if name != "truth":
            axis.plot(times, wrong, color=_COLOURS[name], linestyle=_STYLES[name], drawstyle="steps-mid", linewidth=1.6)
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
    axis.set_yticks(
        np.arange(len(parts)) + 0.5,
        [ESTIMATES[name].replace(" with ", " with\n") for name in reversed(parts)],
        fontsize=8,
    )
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
