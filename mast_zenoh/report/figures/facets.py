"""Figures of the rows of a study: a panel for each measure, and in it a curve for each value of a name."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.ticker import NullFormatter, ScalarFormatter
from numpy.typing import ArrayLike

from mast_zenoh.metrics.study_results import Measured, Row
from mast_zenoh.report.figures.style import LINE_STYLES, MARKERS, Figure, light_axes, plain
from mast_zenoh.viewer.palette import INK, RUN_COLOURS

#: Factor by which the points of neighbouring curves are moved apart, so that bars do not overlap.
_APART = 1.035
#: Factor between the outermost values of x and the ends of their axis.
_BESIDE = 1.2
#: Factor between the ends of the axis of positive numbers from which it is logarithmic.
_LOG = 10.0


def facet(rows: Sequence[Row], x: str, hue: str, panels: Sequence[tuple[str, float, str]], *, log: str = "") -> Figure:
    """Measures over a whole number, on a logarithmic axis; two panels in a line.

    x, hue: names of what rows are of: the number, and what curves differ by;  rows: one or more
    panels: a measure, its factor, and the label of its axis;  log: the measure whose axis may be logarithmic
    """
    figure = Figure(figsize=(9.2, 3.4 * len(panels) / 2.0), layout="constrained", facecolor="white")
    grid = figure.subplots(-(-len(panels) // 2), 2, sharex=True, squeeze=False)
    ticks = sorted({row.of[x] for row in rows})
    hues = list(dict.fromkeys(row.of[hue] for row in rows))
    for axes, (measure, factor, label) in zip(grid.ravel(), panels, strict=True):
        light_axes(axes)
        axes.set_xscale("log")
        axes.set_xticks(ticks, labels=[str(each) for each in ticks], minor=False)
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.tick_params(axis="x", which="minor", length=0)
        axes.set_xlim(ticks[0] / _BESIDE, ticks[-1] * _BESIDE)
        for index, each in enumerate(hues):
            of_hue = [row for row in rows if row.of[hue] == each]
            shift = _APART ** (index - (len(hues) - 1) / 2.0)
            at = shift * np.array([row.of[x] for row in of_hue])
            curve(axes, at, [row[measure] for row in of_hue], index, str(each), factor)
        bottom, top = axes.get_ylim()
        if measure == log and bottom > 0.0 and top > _LOG * bottom:
            axes.set_yscale("log")
            axes.yaxis.set_major_formatter(ScalarFormatter())
            axes.yaxis.set_minor_formatter(NullFormatter())
        else:
            axes.set_ylim(min(0.0, bottom), 1.05 * top)
        axes.set_ylabel(label, fontsize=9.5, color=INK)
    for axes in grid[-1]:
        axes.set_xlabel(x, fontsize=9.5, color=INK)
    legend_above(figure, grid[0, 0])
    return figure


def curve(
    axes: Axes,
    x: ArrayLike,
    numbers: Sequence[Measured],
    index: int,
    label: str,
    factor: float = 1.0,
    *,
    style: int = 0,
) -> None:
    """Numbers with their intervals, in the colour and with the marker of an index; style: index of the line's."""
    values = factor * np.array([each[:3] for each in numbers]).reshape(-1, 3)
    axes.errorbar(
        x,
        values[:, 0],
        yerr=np.nan_to_num(np.abs(values[:, 1:].T - values[:, 0])),
        color=RUN_COLOURS[index % len(RUN_COLOURS)],
        marker=MARKERS[index % len(MARKERS)],
        linestyle=LINE_STYLES[style % len(LINE_STYLES)],
        markersize=4.5,
        linewidth=1.6,
        elinewidth=0.9,
        capsize=2.0,
        label=plain(label),
    )


def legend_above(figure: Figure, axes: Axes, *others: Artist, columns: int = 0) -> None:
    """The legend of the curves of a panel and of others, above all panels; columns: 0: all in one line."""
    handles, labels = axes.get_legend_handles_labels()
    handles, labels = [*handles, *others], [*labels, *(str(other.get_label()) for other in others)]
    figure.legend(
        handles,
        labels,
        loc="outside upper left",
        ncols=columns or max(1, len(labels)),
        frameon=False,
        fontsize=9,
        labelcolor=INK,
    )
