"""The figure of trust in single trials of a matrix of defences: small multiples of the run report's chart."""

from __future__ import annotations

from collections.abc import Sequence

from mast_zenoh.report.defence_rows import TrustPanel
from mast_zenoh.report.figures.drawing import RenderedFigure, render
from mast_zenoh.report.figures.style import INK, Figure, plain
from mast_zenoh.report.figures.timeaxis import padded
from mast_zenoh.report.figures.trust import LOG_ODDS, draw_agent, legend

#: Number of panels in a line.
_COLUMNS = 3
#: Inches: width of a panel, of its margin with the agents' names and of the gap to the next one.
_PANEL, _LEFT, _GAP = 3.8, 0.92, 0.12
#: Inches: heights of an agent's row, of a panel's title, of its time axis, and of the legend.
_ROW, _TITLE, _FOOT, _HEAD = 0.46, 0.3, 0.5, 0.42


def trust_figure(panels: Sequence[TrustPanel], unshown: int) -> RenderedFigure:
    """A panel per trial, a row per agent.

    unshown: number of pairs of a defence and an adversary without a panel
    """
    columns = min(_COLUMNS, len(panels))
    lines = [panels[start : start + columns] for start in range(0, len(panels), columns)]
    heights = [_TITLE + _ROW * max(len(panel.agents) for panel in line) + _FOOT for line in lines]
    width, height = max(columns * _PANEL, 2 * _PANEL), _HEAD + sum(heights)
    figure = Figure(figsize=(width, height), facecolor="white")
    for number, line in enumerate(lines):
        top = height - _HEAD - sum(heights[:number])
        for column, panel in enumerate(line):
            _draw_panel(figure, panel, column * _PANEL, top, (width, height))
    every = [agent for panel in panels for agent in panel.agents]
    handles = legend(every, LOG_ODDS)
    figure.legend(handles=handles, loc="upper left", ncols=len(handles), frameon=False, fontsize=9.5, columnspacing=1.3)
    caption = (
        f"The first trial of each defence that suspends, under each adversary: {LOG_ODDS.label}, drawn at the limits "
        "beyond 10. Background: the state that the command centre gave to the agent. Bands: what it did."
    )
    if unshown:
        caption += f" {unshown} more pairs are not shown."
    titles = "; ".join(panel.title for panel in panels)
    return render("trust_over_time", figure, f"Trust in agents over time in single trials: {titles}.", caption)


def _draw_panel(figure: Figure, panel: TrustPanel, left: float, top: float, size: tuple[float, float]) -> None:
    """Draw a panel below `top`, inches from the figure's lower edge; size: inches of the figure."""
    width, height = size
    title = panel.title + (f" (and {panel.left_out} more agents)" if panel.left_out else "")
    figure.text(
        (left + 0.12) / width, (top - 0.5 * _TITLE) / height, plain(title), fontsize=9.5, color=INK, va="center"
    )
    for index, agent in enumerate(panel.agents):
        bottom = top - _TITLE - (index + 1) * _ROW
        rectangle = (left + _LEFT) / width, bottom / height, (_PANEL - _LEFT - _GAP) / width, 0.86 * _ROW / height
        axes = figure.add_axes(rectangle)
        draw_agent(axes, agent, panel.end_s, LOG_ODDS, named=False)
        axes.set_xlim(*padded(0.0, panel.end_s))
        axes.tick_params(labelsize=8)
        axes.tick_params(axis="y", labelsize=7, length=2)
        axes.yaxis.label.set(fontsize=8.5)
        axes.yaxis.labelpad = 4
        last = index == len(panel.agents) - 1
        axes.tick_params(labelbottom=last)
        if last:
            axes.set_xlabel("time (s)", fontsize=8.5, color=INK, labelpad=1)
