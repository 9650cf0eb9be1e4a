"""The figure of the study of the breakdown point: broken trials over the share of liars."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from mast_zenoh.report.figures.drawing import RenderedFigure, render
from mast_zenoh.report.figures.style import INK, LOCAL, RUN_COLOURS, Figure, light_axes, plain
from mast_zenoh.report.limit_rows import BreakdownRow, BreakdownTable

_BOUND = (0, (4, 2))
_MARKERS = ("o", "s", "^", "D", "v", "P")
#: Percentage points by which the curves of different numbers of agents are moved apart, so that bars do not overlap.
_APART = 0.5


def figure_of_breakdown(table: BreakdownTable) -> RenderedFigure:
    """A panel for each attack, and a curve for each number of agents next to its bound."""
    attacks = list(dict.fromkeys(row.attack for row in table.rows)) or [""]
    sizes = list(dict.fromkeys(row.agents for row in table.rows))
    figure = Figure(figsize=(1.2 + 4.4 * len(attacks), 4.3), layout="constrained", facecolor="white")
    panels = figure.subplots(1, len(attacks), squeeze=False, sharey=True)[0]
    for axes, attack in zip(panels, attacks, strict=True):
        light_axes(axes)
        axes.axhline(50.0, color=LOCAL, linewidth=0.8)
        for index, agents in enumerate(sizes):
            rows = [row for row in table.rows if (row.attack, row.agents) == (attack, agents) and row.trials]
            _curve(axes, rows, index, (index - (len(sizes) - 1) / 2.0) * _APART)
        axes.set_title(plain(attack), fontsize=9.5, color=INK, loc="left")
        axes.set_xlabel("liars (% of all agents)", fontsize=9.5, color=INK)
        axes.set_ylim(-3.0, 103.0)
    panels[0].set_ylabel("broken trials (%)", fontsize=9.5, color=INK)
    handles, labels = panels[0].get_legend_handles_labels()
    handles.append(Line2D([], [], color=LOCAL, linestyle=_BOUND, linewidth=1.3))
    labels.append("objects without an honest majority")
    figure.legend(
        handles, labels, loc="outside upper left", ncols=len(labels), frameon=False, fontsize=9, labelcolor=INK
    )
    caption = (
        f"Lines with markers: broken trials with 95 % intervals ({table.size}). A trial is broken if the picture is "
        "worse than the ego alone, or an honest agent is suspended before any liar. Dashed: objects without an honest "
        "majority of viewers, the bound of identification."
    )
    return render(
        "breakdown", figure, f"Broken trials over the share of liars. {_points(table)}", caption, printed=True
    )


def _curve(axes: Axes, rows: list[BreakdownRow], index: int, shift: float) -> None:
    """One number of agents: broken trials, and its bound."""
    if not rows:
        return
    colour, agents = RUN_COLOURS[index % len(RUN_COLOURS)], rows[0].agents
    x = np.array([100.0 * row.share for row in rows])
    broken = np.array([[100.0 * each for each in (r.broken.value, r.broken.low, r.broken.high)] for r in rows])
    axes.errorbar(
        x + shift,
        broken[:, 0],
        yerr=np.abs(broken[:, 1:].T - broken[:, 0]),
        color=colour,
        marker=_MARKERS[index % len(_MARKERS)],
        markersize=4.5,
        linewidth=1.6,
        elinewidth=0.9,
        capsize=2.0,
        label=f"{agents} agents",
    )
    without = [100.0 * (1.0 - row.honest_majority) for row in rows]
    axes.plot(x, without, color=colour, linestyle=_BOUND, linewidth=1.3)


def _points(table: BreakdownTable) -> str:
    parts = []
    for point in table.points.values():
        most = f"above {100.0 * point.most:.0f} %"
        values = (most if math.isinf(m.value) else f"{100.0 * m.value:.0f} %" for m in (point.point, point.bound))
        parts.append("{}, {} agents: {}, bound {}".format(point.attack, point.agents, *values))
    return f"Half of the trials are broken at: {'; '.join(parts)}." if parts else ""
