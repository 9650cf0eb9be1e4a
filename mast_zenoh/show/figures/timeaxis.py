"""Stacked charts on one time axis, with bands and labelled lanes for faults and attacks."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.font_manager import FontProperties
from matplotlib.patches import Patch, Rectangle
from matplotlib.textpath import TextPath

from mast_zenoh.runs.events import absences
from mast_zenoh.runs.run import Run
from mast_zenoh.show.figures.style import Figure, plain
from mast_zenoh.show.palette import ADVERSARY_ON_LIGHT, FAULT_ON_LIGHT, INK

#: Inches: height of a lane, and gap between a band and the next label. Points: font size of labels.
LANE, _GAP, _FONT_SIZE = 0.2, 0.14, 8.5
#: Maximum number of lanes, and of characters of a label.
_MAX_LANES, _MAX_LABEL = 9, 46
HATCH = "////"


@dataclass(frozen=True, slots=True)
class Band:
    """An attack or fault between two times on the axis; end: inf for the last frame."""

    label: str
    attack: bool
    start: float
    end: float

    @property
    def colour(self) -> str:
        """The colour of attacks or of faults."""
        return ADVERSARY_ON_LIGHT if self.attack else FAULT_ON_LIGHT


@dataclass(frozen=True, slots=True)
class PlacedBand:
    """A band with its lane (0 is the lowest) and the x and alignment of its label."""

    band: Band
    lane: int
    x: float
    align: str


def bands(runs: Iterable[Run], *, timed: bool) -> list[Band]:
    """Distinct bands of the timelines of runs, sorted by start; empty without faults.

    timed: in s of scene time; else in frames
    """
    unique_bands: dict[Band, None] = {}
    for run in runs:
        unit_s = 1.0 if timed else run.period_s
        frame = run.period_s / unit_s
        for each in run.timeline:
            until = np.inf if each.get("until_s") is None else each["until_s"] / unit_s
            unique_bands[Band(str(each["label"]), each["kind"] == "attack", each["at_s"] / unit_s, until)] = None
        for node, start, end in absences(run):
            unique_bands[Band(f"{node} lost", False, start * frame, end * frame)] = None
    if all(band.attack for band in unique_bands):
        return []
    return sorted(unique_bands, key=lambda band: (band.start, band.end, band.label))


def place_bands(bands: Sequence[Band], low: float, high: float, width: float) -> tuple[list[PlacedBand], int]:
    """Place bands in the lowest free lanes.

    Returns the placed bands and the number of bands that found no lane.

    low, high: limits of the time axis, which is `width` inches wide
    """
    unit = width / max(high - low, 1e-9)
    lane_ends: list[float] = []  # inches, right end of the contents of each lane
    placed = []
    for band in bands:
        start = (min(max(band.start, low), high) - low) * unit
        end = (min(max(band.end, low), high) - low) * unit
        name = _width(shortened(band.label)) + _GAP
        if name <= end - start:  # inside
            x, align, left, right = start + _GAP / 2, "left", start, end
        elif end + name <= width:
            x, align, left, right = end + _GAP / 2, "left", start, end + name
        else:
            x, align, left, right = start - _GAP / 2, "right", max(start - name, 0.0), end
        lane = next((k for k, end_of_lane in enumerate(lane_ends) if end_of_lane + _GAP / 2 <= left), len(lane_ends))
        if lane >= _MAX_LANES:
            continue
        lane_ends[lane:] = [right, *lane_ends[lane + 1 :]]
        placed.append(PlacedBand(band, lane, low + x / unit, align))
    return placed, len(bands) - len(placed)


def lanes(placed: Sequence[PlacedBand]) -> int:
    """The number of lanes in use."""
    return max((each.lane + 1 for each in placed), default=0)


def draw_lanes(axes: Axes, placed: Sequence[PlacedBand], left_out: int, low: float, high: float) -> None:
    """Draw bands and labels on separate axes above the charts."""
    axes.set_axis_off()
    axes.set_xlim(low, high)
    axes.set_ylim(0.0, max(lanes(placed), 1))
    for each in placed:
        band = each.band
        start, end = max(band.start, low), min(band.end, high)
        style: dict[str, Any] = {"facecolor": (band.colour, 0.22), "edgecolor": band.colour, "linewidth": 0.8}
        axes.add_patch(Rectangle((start, each.lane + 0.1), end - start, 0.8, **style))
        words: dict[str, Any] = {"ha": each.align, "va": "center", "fontsize": _FONT_SIZE, "color": INK}
        axes.text(each.x, each.lane + 0.47, plain(shortened(band.label)), clip_on=False, **words)
    if left_out:
        note = f"and {left_out} more"
        axes.text(high, lanes(placed), note, ha="right", va="bottom", fontsize=_FONT_SIZE, color=INK)


def shade(axes: Axes, bands: Sequence[Band], low: float, high: float, *, hatch: bool = True) -> None:
    """Shade the periods with any fault in a chart; simultaneous faults share one area."""
    spans = _merged([(band.start, min(band.end, high)) for band in bands if not band.attack])
    for start, end in spans:
        if end <= low:
            continue
        axes.axvspan(max(start, low), end, facecolor=(FAULT_ON_LIGHT, 0.07), linewidth=0, zorder=0)
        if hatch:
            style: dict[str, Any] = {"edgecolor": (FAULT_ON_LIGHT, 0.24), "hatch": HATCH, "linewidth": 0, "fill": False}
            axes.axvspan(max(start, low), end, zorder=0, **style)


def fault_legend() -> Patch:
    """A legend entry for `shade`."""
    colours: dict[str, Any] = {"facecolor": (FAULT_ON_LIGHT, 0.07), "edgecolor": (FAULT_ON_LIGHT, 0.5)}
    return Patch(label="fault", hatch=HATCH, linewidth=0, **colours)


def shortened(label: str) -> str:
    """A label, cut to fit into a lane."""
    return label if len(label) <= _MAX_LABEL else label[: _MAX_LABEL - 1] + "…"


@cache
def _width(text: str) -> float:
    """The width of a label in inches."""
    if not text.strip():
        return 0.0
    return float(TextPath((0, 0), plain(text), size=_FONT_SIZE, prop=FontProperties()).get_extents().width) / 72.0


def _merged(spans: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """The union of spans."""
    merged: list[tuple[float, float]] = []
    for start, end in sorted(spans):
        if merged and start <= merged[-1][1]:
            merged[-1] = merged[-1][0], max(merged[-1][1], end)
        else:
            merged.append((start, end))
    return merged


def rows_over_time(
    count: int, height: float, marked: Sequence[Band], low: float, high: float
) -> tuple[Figure, Sequence[Axes]]:
    """A figure of `count` stacked charts of `height` inches, with bands above.

    marked: the bands
    low, high: the first and the last frame's time
    """
    left, width = 0.75, 10.58
    placed_bands, left_out = place_bands(marked, *padded(low, high), width)
    strip = LANE * lanes(placed_bands) + (0.08 if placed_bands else 0.0)
    gap, foot, head = 0.1 * height, 0.51, 0.42
    total = head + strip + count * height + (count - 1) * gap + foot
    figure = Figure(figsize=(11.5, total), facecolor="white")
    if placed_bands:
        names = figure.place(left, head, width, LANE * lanes(placed_bands))
        draw_lanes(names, placed_bands, left_out, *padded(low, high))
    axes: list[Axes] = []
    for row in range(count):
        axes.append(figure.place(left, head + strip + row * (height + gap), width, height))
        axes[-1].tick_params(labelbottom=row == count - 1)
        if row:
            axes[row].sharex(axes[0])
    return figure, axes


def padded(low: float, high: float) -> tuple[float, float]:
    """The ends of a time axis, a little beyond the first and the last frame."""
    pad = 0.01 * (high - low) or 0.5
    return low - pad, high + pad
