"""Stacked charts on one time axis, with lanes for attacks and faults above."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from matplotlib.axes import Axes

from mast_zenoh.report.figures.bands import LANE, Band, draw_lanes, lanes, place_bands
from mast_zenoh.report.figures.style import Figure


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
        top = (total - head - LANE * lanes(placed_bands)) / total
        names = figure.add_axes((left / 11.5, top, width / 11.5, LANE * lanes(placed_bands) / total))
        draw_lanes(names, placed_bands, left_out, *padded(low, high))
    axes: list[Axes] = []
    for row in range(count):
        bottom = foot + (count - 1 - row) * (height + gap)
        share: dict[str, Any] = {"sharex": axes[0]} if axes else {}
        rectangle = (left / 11.5, bottom / total, width / 11.5, height / total)
        axes.append(figure.add_axes(rectangle, **share))
        axes[-1].tick_params(labelbottom=row == count - 1)
    return figure, axes


def padded(low: float, high: float) -> tuple[float, float]:
    """The ends of a time axis, a little beyond the first and the last frame."""
    pad = 0.01 * (high - low) or 0.5
    return low - pad, high + pad
