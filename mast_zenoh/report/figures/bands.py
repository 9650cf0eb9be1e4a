"""When which fault and which attack was on: bands through charts over time, named in lanes above them."""

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

from mast_zenoh.messagelog.churn import LOST
from mast_zenoh.report.figures.style import ADVERSARY_ON_LIGHT, FAULT_ON_LIGHT, INK, plain
from mast_zenoh.report.runfolder import RunFolder

#: Inches: a lane, and the gap between a band and the next one's name. Points: the size of names.
LANE, _GAP, _POINTS = 0.2, 0.14, 8.5
#: More lanes than these are not drawn, and a longer name is cut.
_MOST_LANES, _LONGEST = 9, 46
HATCH = "////"


@dataclass(frozen=True, slots=True)
class Band:
    """From `start` to `end` (inf: to the last frame), in the unit of the time axis; attack, or else fault."""

    label: str
    attack: bool
    start: float
    end: float

    @property
    def colour(self) -> str:
        """Of its family."""
        return ADVERSARY_ON_LIGHT if self.attack else FAULT_ON_LIGHT


@dataclass(frozen=True, slots=True)
class Placed:
    """A band in a lane (0 is the lowest), and where its name stands: at x, to the left or to the right of it."""

    band: Band
    lane: int
    x: float
    align: str


def bands(runs: Iterable[RunFolder], *, timed: bool) -> list[Band]:
    """The bands of the timelines of runs, each once, by start; none if there is no fault in them.

    timed: in s of scene time; else in frames
    """
    found: dict[Band, None] = {}
    for run in runs:
        unit_s = 1.0 if timed else run.period_s
        frame = run.period_s / unit_s
        for each in run.timeline:
            until = np.inf if each.get("until_s") is None else each["until_s"] / unit_s
            found[Band(str(each["label"]), each["kind"] == "attack", each["at_s"] / unit_s, until)] = None
        for node, start, end in _absences(run):
            found[Band(f"{node} lost", False, start * frame, end * frame)] = None
    if all(band.attack for band in found):
        return []
    return sorted(found, key=lambda band: (band.start, band.end, band.label))


def _absences(run: RunFolder) -> list[tuple[str, float, float]]:
    """(node, first frame, frame in which it came back) of nodes that were lost."""
    found, gone = [], dict[str, float]()
    for each in run.lost:
        if each["what"] == LOST:
            gone.setdefault(each["node"], each["frame"])
        elif each["node"] in gone:
            found.append((each["node"], gone.pop(each["node"]), float(each["frame"])))
    return [*found, *((node, start, np.inf) for node, start in gone.items())]


def placed(bands: Sequence[Band], low: float, high: float, width: float) -> tuple[list[Placed], int]:
    """Each band in the lowest lane in which neither it nor its name lies on another; how many found no lane.

    low, high: ends of the time axis, which is `width` inches wide
    """
    unit = width / max(high - low, 1e-9)
    ends: list[float] = []  # inches, of what lies in each lane
    found = []
    for band in bands:
        start = (min(max(band.start, low), high) - low) * unit
        end = (min(max(band.end, low), high) - low) * unit
        name = _extent(shortened(band.label)) + _GAP
        if name <= end - start:  # inside
            x, align, left, right = start + _GAP / 2, "left", start, end
        elif end + name <= width:
            x, align, left, right = end + _GAP / 2, "left", start, end + name
        else:
            x, align, left, right = start - _GAP / 2, "right", max(start - name, 0.0), end
        lane = next((k for k, taken in enumerate(ends) if taken + _GAP / 2 <= left), len(ends))
        if lane >= _MOST_LANES:
            continue
        ends[lane:] = [right, *ends[lane + 1 :]]
        found.append(Placed(band, lane, low + x / unit, align))
    return found, len(bands) - len(found)


def lanes(found: Sequence[Placed]) -> int:
    """How many there are."""
    return max((each.lane + 1 for each in found), default=0)


def draw_lanes(axes: Axes, found: Sequence[Placed], left_out: int, low: float, high: float) -> None:
    """The bands and their names, on axes of their own that stand above the charts."""
    axes.set_axis_off()
    axes.set_xlim(low, high)
    axes.set_ylim(0.0, max(lanes(found), 1))
    for each in found:
        band = each.band
        start, end = max(band.start, low), min(band.end, high)
        look: dict[str, Any] = {"facecolor": (band.colour, 0.22), "edgecolor": band.colour, "linewidth": 0.8}
        axes.add_patch(Rectangle((start, each.lane + 0.1), end - start, 0.8, **look))
        axes.text(
            each.x,
            each.lane + 0.47,
            plain(shortened(band.label)),
            ha=each.align,
            va="center",
            fontsize=_POINTS,
            color=INK,
            clip_on=False,
        )
    if left_out:
        note = f"and {left_out} more"
        axes.text(high, lanes(found), note, ha="right", va="bottom", fontsize=_POINTS, color=INK)


def shade(axes: Axes, found: Sequence[Band], low: float, high: float, *, hatch: bool = True) -> None:
    """Mark on a chart when any fault was on: one area, hatched unless said, however many there were at a time."""
    spans = _union([(band.start, min(band.end, high)) for band in found if not band.attack])
    for start, end in spans:
        if end <= low:
            continue
        axes.axvspan(max(start, low), end, facecolor=(FAULT_ON_LIGHT, 0.07), linewidth=0, zorder=0)
        if hatch:
            look: dict[str, Any] = {"edgecolor": (FAULT_ON_LIGHT, 0.24), "hatch": HATCH, "linewidth": 0, "fill": False}
            axes.axvspan(max(start, low), end, zorder=0, **look)


def fault_key() -> Patch:
    """What `shade` draws, for a legend."""
    look: dict[str, Any] = {
        "facecolor": (FAULT_ON_LIGHT, 0.07),
        "edgecolor": (FAULT_ON_LIGHT, 0.5),
        "hatch": HATCH,
        "linewidth": 0,
    }
    return Patch(label="fault", **look)


def shortened(label: str) -> str:
    """A name that is not too long for a lane."""
    return label if len(label) <= _LONGEST else label[: _LONGEST - 1] + "…"


@cache
def _extent(text: str) -> float:
    """Inches that a name takes."""
    if not text.strip():
        return 0.0
    return float(TextPath((0, 0), plain(text), size=_POINTS, prop=FontProperties()).get_extents().width) / 72.0


def _union(spans: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """The times that any of the spans covers."""
    found: list[tuple[float, float]] = []
    for start, end in sorted(spans):
        if found and start <= found[-1][1]:
            found[-1] = found[-1][0], max(found[-1][1], end)
        else:
            found.append((start, end))
    return found
