"""The figure of the study of driving: what each attack adds, with each defence."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from mast_zenoh.metrics.driving_results import DRIVING_MEASURES, DrivingRow, DrivingTable
from mast_zenoh.report.figures.drawing import RenderedFigure, render
from mast_zenoh.report.figures.style import MARKERS, Figure, light_axes
from mast_zenoh.report.tables.driving_study import conclusion
from mast_zenoh.viewer.palette import INK, PALE, RUN_COLOURS

#: Distance between the points of two defences, in lines.
_APART = 0.22
#: Inches of a line, and of all that is above and below the lines.
_LINE_IN, _FRAME_IN = 0.46, 1.3


def figure_of_driving(table: DrivingTable) -> RenderedFigure:
    """A panel for each measure, with a line for each attack, and on it a point for each defence."""
    rows = [row for row in table.rows if row.attack and row.trials]
    attacks = list(dict.fromkeys(row.title for row in rows))
    defences = list(dict.fromkeys(row.defence for row in table.rows))
    size = (11.0, _FRAME_IN + _LINE_IN * max(1, len(attacks)))
    figure = Figure(figsize=size, layout="constrained", facecolor="white")
    panels = figure.subplots(1, len(DRIVING_MEASURES), sharey=True)
    for axes, (name, measure) in zip(panels, DRIVING_MEASURES.items(), strict=True):
        light_axes(axes)
        axes.grid(visible=False, axis="y")
        axes.grid(axis="x", color=PALE, linewidth=0.8)
        axes.axvline(0.0, color=INK, linewidth=0.8)
        for index, defence in enumerate(defences):
            place = _APART * (index - (len(defences) - 1) / 2.0)
            _points(axes, [row for row in rows if row.defence == defence], name, attacks, index, place)
        axes.set_xlabel(f"added {measure.heading}", fontsize=9, color=INK)
        axes.set_ylim(max(len(attacks), 1) - 0.5, -0.5)
    panels[0].set_yticks(range(len(attacks)), labels=attacks)
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper left", ncols=max(1, len(labels)), frameon=False, fontsize=9)
    caption = (
        f"What an attack adds to a trial of its twin, the same seed and defence without it ({table.size}). Bars: 95 % "
        "intervals of the paired difference; a point without a bar: all differences are equal, most are 0, or too few "
        "trials."
    )
    return render("driving", figure, " ".join(conclusion(table)), caption, printed=True)


def _points(axes: Axes, rows: list[DrivingRow], name: str, attacks: list[str], index: int, place: float) -> None:
    """One measure with one defence."""
    estimates = [row.added[name] for row in rows]
    values = np.array([(each.trial_mean, each.low, each.high) for each in estimates], np.float64).reshape(-1, 3)
    axes.errorbar(
        values[:, 0],
        np.array([attacks.index(row.title) for row in rows]) + place,
        xerr=np.nan_to_num(np.abs(values[:, 1:].T - values[:, 0])),
        color=RUN_COLOURS[index % len(RUN_COLOURS)],
        marker=MARKERS[index % len(MARKERS)],
        markersize=4.5,
        linestyle="none",
        elinewidth=1.2,
        capsize=2.0,
        label=(rows[0].defence or "no defence") if rows else "",
    )
