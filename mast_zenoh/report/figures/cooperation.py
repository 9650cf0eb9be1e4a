"""The figure of the study that compares fusion architectures."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import NullFormatter, ScalarFormatter

from mast_zenoh.metrics.study_results import CooperationRow, CooperationTable
from mast_zenoh.report.figures.drawing import RenderedFigure, render
from mast_zenoh.report.figures.style import MARKERS, Figure, light_axes
from mast_zenoh.report.tables.cooperation import conclusion
from mast_zenoh.viewer.palette import INK, RUN_COLOURS

#: Of each panel: a measure, its factor, and the label of its axis.
_PANELS = (
    ("harm", 1.0, "errors per frame that lies add"),
    ("deceived", 100.0, "agents deceived at a time (%)"),
    ("errors", 1.0, "errors per frame without lies"),
    ("kb_per_s", 1.0, "kB/s that an agent sends"),
)
#: Factor by which the points of neighbouring architectures are moved apart, so that bars do not overlap.
_APART = 1.035
#: Factor between the outermost numbers of agents and the ends of their axis.
_BESIDE = 1.2


def figure_of_cooperation(table: CooperationTable) -> RenderedFigure:
    """A panel for each measure, over the number of agents, with a curve for each architecture."""
    figure = Figure(figsize=(9.2, 6.8), layout="constrained", facecolor="white")
    architectures = list(dict.fromkeys(row.architecture for row in table.rows))
    agents = sorted({row.agents for row in table.rows})
    panels = figure.subplots(2, 2, sharex=True).ravel()
    for axes, (name, factor, label) in zip(panels, _PANELS, strict=True):
        light_axes(axes)
        axes.set_xscale("log")
        axes.set_xticks(agents, labels=[str(each) for each in agents], minor=False)
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.tick_params(axis="x", which="minor", length=0)
        axes.set_xlim(agents[0] / _BESIDE, agents[-1] * _BESIDE)
        for index, architecture in enumerate(architectures):
            rows = [row for row in table.rows if row.architecture == architecture]
            _curve(axes, rows, name, factor, index, _APART ** (index - (len(architectures) - 1) / 2.0))
        bottom, top = axes.get_ylim()
        if name == "kb_per_s" and bottom > 0.0 and top > 10.0 * bottom:
            axes.set_yscale("log")
            axes.yaxis.set_major_formatter(ScalarFormatter())
            axes.yaxis.set_minor_formatter(NullFormatter())
        else:
            axes.set_ylim(min(0.0, bottom), 1.05 * top)
        axes.set_ylabel(label, fontsize=9.5, color=INK)
    for axes in panels[2:]:
        axes.set_xlabel("agents", fontsize=9.5, color=INK)
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="outside upper left", ncols=max(1, len(labels)), frameon=False, fontsize=9, labelcolor=INK
    )
    caption = (
        f"Errors are missed and false objects in the ego's picture. Bars: 95 % intervals over trials ({table.size}). "
        "An agent is deceived if its picture has an error that an adversary caused."
    )
    return render("cooperation", figure, conclusion(table), caption, printed=True)


def _curve(axes: Axes, rows: list[CooperationRow], name: str, factor: float, index: int, shift: float) -> None:
    """One measure of one architecture."""
    values = np.array([[factor * each for each in getattr(row, name)[:3]] for row in rows])
    axes.errorbar(
        shift * np.array([row.agents for row in rows]),
        values[:, 0],
        yerr=np.nan_to_num(np.abs(values[:, 1:].T - values[:, 0])),
        color=RUN_COLOURS[index % len(RUN_COLOURS)],
        marker=MARKERS[index % len(MARKERS)],
        markersize=4.5,
        linewidth=1.6,
        elinewidth=0.9,
        capsize=2.0,
        label=rows[0].architecture,
    )
