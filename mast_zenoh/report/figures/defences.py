"""The figures of studies of defences: damage, delays, ROC, trust, and the breakdown point."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.image import AxesImage
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from mast_zenoh.metrics.study_results import DefenceMatrix, Row
from mast_zenoh.report.figures.drawing import RenderedFigure, render
from mast_zenoh.report.figures.facets import curve, legend_above
from mast_zenoh.report.figures.style import (
    LINE_STYLES,
    Figure,
    hatch_cell,
    heat_map,
    light_axes,
    plain,
)
from mast_zenoh.report.figures.trust import trust_figure
from mast_zenoh.report.tables.text_table import number
from mast_zenoh.viewer.palette import INK, LOCAL, RUN_COLOURS

#: Inches of the narrowest heat map, with its scale; height of a cell in widths, where they are few.
_LEAST_WIDTH, _CELL_ASPECT = 4.8, 0.45
_ADDED = "missed and false objects added\nper frame, picture"


def figures_of_defences(matrix: DefenceMatrix) -> dict[str, RenderedFigure]:
    """The figures by file name, without empty ones."""
    figures = {}
    if matrix.names("attack"):
        figures["defence_matrix"] = _heat_maps(matrix)
        figures["damage_over_adversaries"] = _damage(matrix)
    if matrix.delays:
        figures["detection_delay"] = _delays(matrix)
    if matrix.rocs:
        figures["roc"] = _rocs(matrix)
    if matrix.panels:
        figures["trust_over_time"] = trust_figure(matrix.panels, matrix.unshown)
    return figures


def _heat_maps(matrix: DefenceMatrix) -> RenderedFigure:
    """Damage of every adversary to every defence: a row of maps per placement, a map per number of adversaries."""
    defences, attacks = matrix.names("defence"), matrix.names("attack")
    counts, placements = matrix.names("n_adversaries"), matrix.names("placement")
    width = min(22.0, 1.9 + len(counts) * (0.8 + 0.75 * len(attacks)))
    height = 0.5 + len(placements) * (1.3 + 0.34 * len(defences))
    marks = "(brackets: the 95 % interval contains 0, or there is none"
    marks += "; hatched: the adversaries never lied)" if any(row.idle for row in matrix.rows) else ")"
    label = "\n".join(["missed and false objects added per frame", *textwrap.wrap(marks, 58)])
    figure = Figure(figsize=(max(_LEAST_WIDTH, width), height + 0.95), layout="constrained", facecolor="white")
    grid = figure.subplots(len(placements), len(counts), squeeze=False, sharey=True)
    sizes = [abs(row["damage"].value) for row in matrix.rows if row.of["attack"] and not row.idle]
    scale = max((size for size in sizes if not math.isnan(size)), default=0.0) or 1.0
    for line, placement in zip(grid, placements, strict=True):
        for axes, count in zip(line, counts, strict=True):
            cells = [[matrix.row(defence, attack, count, placement) for attack in attacks] for defence in defences]
            image = _heat_map(axes, cells, scale)
            axes.set_title(f"{_agents(count)}, {placement}", fontsize=9.5, color=INK, loc="left")
            if width < _LEAST_WIDTH:  # few cells are not stretched
                axes.set_box_aspect(_CELL_ASPECT * len(defences) / len(attacks))
                axes.set_anchor("W")
            axes.set_xticks(range(len(attacks)), [plain(name) for name in attacks])
            axes.set_yticks(range(len(defences)), [plain(name) for name in defences])
            for text in axes.get_xticklabels():
                text.set(rotation=30, ha="right", rotation_mode="anchor")
    bar = figure.colorbar(image, ax=grid, orientation="horizontal", aspect=40.0, shrink=0.8)
    bar.ax.tick_params(labelsize=8.5, length=3, colors=INK)
    bar.outline.set_visible(False)
    bar.set_label(label, fontsize=9, color=INK)
    caption = (
        "Missed and false objects that each adversary adds to the ego's picture per frame, compared with no attack and "
        f"no defence ({matrix.size}). Brackets: the 95 % interval contains 0, or there is none. Hatched: the "
        "adversaries lied in none of the runs."
    )
    return render("defence_matrix", figure, f"Heat maps of damage. {_worst(matrix)}", caption, printed=True)


def _heat_map(axes: Axes, cells: list[list[Row | None]], scale: float) -> AxesImage:
    def text(row: Row | None) -> str:
        if row is None or math.isnan(_mean(row, "damage")):
            return ""
        damage = row["damage"]
        return number(damage.value) if damage.differs else f"({number(damage.value)})"

    idle = np.array([[row is not None and row.idle for row in line] for line in cells])
    means = np.where(idle, math.nan, [[_mean(row, "damage") for row in line] for line in cells])
    image = heat_map(axes, means, [[text(row) for row in line] for line in cells], scale)
    for y, x in np.argwhere(idle).tolist():
        hatch_cell(axes, x, y)
    return image


def _damage(matrix: DefenceMatrix) -> RenderedFigure:
    """Damage over the number of adversaries, a column per adversary; the bound of a majority in the last one."""
    attacks, defences = matrix.names("attack"), matrix.names("defence")
    placements, counts = matrix.names("placement"), [0, *matrix.names("n_adversaries")]
    panels = [*attacks, None]
    lines = -(-len(panels) // 4)
    columns = -(-len(panels) // lines)
    figure = Figure(figsize=(11.25, 0.8 + 2.7 * lines), layout="constrained", facecolor="white")
    grid = figure.subplots(lines, columns, squeeze=False, sharex=True).ravel()
    for axes, attack in zip(grid, panels, strict=False):
        light_axes(axes)
        if attack is None:
            _bound(axes, matrix, counts)
        else:
            axes.axhline(0.0, color=LOCAL, linewidth=0.8)
            for index, defence in enumerate(defences):
                for at, placement in enumerate(placements):
                    rows = [matrix.row(defence, attack, count, placement) for count in counts]
                    label = f"{defence}, {placement}" if len(placements) > 1 else defence
                    _curve(axes, [row for row in rows if row is not None], index, at, label)
            axes.set_title(plain(attack), fontsize=9.5, color=INK, loc="left")
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.tick_params(axis="x", labelbottom=True)
    for axes in grid[len(panels) :]:
        axes.set_visible(False)
    for axes in grid[::columns]:
        if axes is not grid[len(panels) - 1]:
            axes.set_ylabel(_ADDED, fontsize=9, color=INK)
    legend_above(figure, grid[0], columns=5)
    figure.supxlabel("number of adversaries", fontsize=9.5, color=INK)
    caption = (
        f"Damage over the number of adversaries ({matrix.size}), with 95 % intervals over trials where there are five "
        "trials or more. Last: the share of objects that more honest agents see than compromised ones. No rule that "
        "counts viewers can know more. White centre: the adversaries lied in none of the runs."
    )
    return render(
        "damage_over_adversaries", figure, f"Damage over number of adversaries. {_worst(matrix)}", caption, printed=True
    )


def _curve(axes: Axes, rows: list[Row], index: int, style: int, label: str) -> None:
    counts = [row.of["n_adversaries"] for row in rows]
    curve(axes, counts, [row["damage"] for row in rows], index, label, style=style)
    for row, count in zip(rows, counts, strict=True):
        if row.idle:
            axes.plot(count, row["damage"].value, color="white", marker=".", markersize=4.0, zorder=5)


def _bound(axes: Axes, matrix: DefenceMatrix, counts: list[int]) -> None:
    """Share of objects with an honest majority, by placement: the same for every defence and adversary."""
    for index, placement in enumerate(matrix.names("placement")):
        values = []
        for count in counts:
            shares = [
                row["honest_majority"].value
                for row in matrix.rows
                if row.of["n_adversaries"] == count and (count == 0 or row.of["placement"] == placement)
            ]
            values.append(next((share for share in shares if not math.isnan(share)), math.nan))
        style = LINE_STYLES[index % len(LINE_STYLES)]
        axes.plot(counts, values, color=INK, linestyle=style, marker=".", label=plain(placement))
    axes.set_ylim(0.0, 1.05)
    axes.set_title("honest majority (share of objects)", fontsize=9.5, color=INK, loc="left")
    axes.legend(frameon=False, fontsize=9, labelcolor=INK)


def _delays(matrix: DefenceMatrix) -> RenderedFigure:
    figure = Figure(figsize=(7.0, 3.8), layout="constrained", facecolor="white")
    axes = figure.subplots()
    light_axes(axes)
    for defence, delay in matrix.delays.items():
        label = f"{defence}: {delay.detections} of {delay.watched}"
        axes.step(delay.time_s, 100.0 * delay.undetected, where="post", **_line(matrix, defence, label))
    axes.set_xlabel("s since the first observable lie", fontsize=9.5, color=INK)
    axes.set_ylabel("liars not suspended yet (%)", fontsize=9.5, color=INK)
    axes.set_ylim(0.0, 103.0)
    axes.set_xlim(left=0.0)
    axes.legend(frameon=False, fontsize=9, labelcolor=INK, title="suspended", alignment="left")
    caption = (
        "Time from an agent's first observable lie to its suspension, over all adversaries (Kaplan-Meier). Agents that "
        "were not suspended count for as long as they were watched."
    )
    if matrix.not_suspending:
        caption += f" Not drawn, as they suspended nobody: {', '.join(matrix.not_suspending)}."
    values = "; ".join(
        f"{defence} {delay.detections} of {delay.watched}, median {number(delay.median_s)} s"
        for defence, delay in matrix.delays.items()
    )
    return render("detection_delay", figure, f"Share of liars not suspended: {values}.", caption, printed=True)


def _rocs(matrix: DefenceMatrix) -> RenderedFigure:
    figure = Figure(figsize=(5.6, 4.4), layout="constrained", facecolor="white")
    axes = figure.subplots()
    light_axes(axes)
    axes.plot([0, 100], [0, 100], color=LOCAL, linewidth=0.8)
    for each in matrix.rocs:
        x, y = 100.0 * each.roc.false_positive_rate, 100.0 * each.roc.true_positive_rate
        axes.plot(x, y, **_line(matrix, each.defence, f"{each.defence}: AUC {number(each.auc.value)}"))
    axes.set_xlabel("honest agent-runs above the threshold (%)", fontsize=9.5, color=INK)
    axes.set_ylabel("lying agent-runs above the threshold (%)", fontsize=9.5, color=INK)
    axes.legend(frameon=False, fontsize=9, labelcolor=INK, loc="lower right")
    caption = (
        "Each agent of each run has one score, its greatest suspicion. One honest agent-run is at most one false alarm "
        "in the hours of all runs together, so few runs say nothing about one alarm per hour. Runs under attack in "
        "which the adversaries never lied are left out."
    )
    values = "; ".join(f"{each.defence} {number(each.auc.value)}" for each in matrix.rocs)
    return render("roc", figure, f"Receiver operating characteristics, areas below: {values}.", caption, printed=True)


def _line(matrix: DefenceMatrix, defence: str, label: str) -> dict[str, Any]:
    """How the line of a defence looks, the same in all figures."""
    index = matrix.names("defence").index(defence)
    colour, style = RUN_COLOURS[index % len(RUN_COLOURS)], LINE_STYLES[index % len(LINE_STYLES)]
    return {"color": colour, "linestyle": style, "linewidth": 1.8, "label": plain(label)}


def _mean(row: Row | None, name: str) -> float:
    return math.nan if row is None else row[name].value


def _worst(matrix: DefenceMatrix) -> str:
    """The adversary that does the most damage to each defence."""
    parts = []
    for defence in matrix.names("defence"):
        rows = [row for row in matrix.rows if row.of["defence"] == defence and row.of["attack"]]
        rows = [row for row in rows if not math.isnan(_mean(row, "damage")) and not row.idle]
        if rows:
            row = max(rows, key=lambda each: _mean(each, "damage"))
            by = f"{row.of['attack']}, {_agents(row.of['n_adversaries'])}"
            parts.append(f"{defence}: {number(_mean(row, 'damage'))} by {by}")
    return f"Most damage to {'; '.join(parts)}." if parts else ""


def _agents(count: object) -> str:
    return f"{count} adversar{'y' if count == 1 else 'ies'}"


_BOUND_STYLE = (0, (4, 2))
#: Percentage points by which the curves of different numbers of agents are moved apart, so that bars do not overlap.
_APART = 0.5


def figure_of_breakdown(rows: Sequence[Row], words: str, size: str) -> RenderedFigure:
    """A panel for each attack, and a curve for each number of agents next to its bound."""
    attacks, sizes = (list(dict.fromkeys(row.of[name] for row in rows)) for name in ("attack", "agents"))
    figure = Figure(figsize=(1.2 + 4.4 * len(attacks), 4.3), layout="constrained", facecolor="white")
    panels = figure.subplots(1, len(attacks), squeeze=False, sharey=True)[0]
    for axes, attack in zip(panels, attacks, strict=True):
        light_axes(axes)
        axes.axhline(50.0, color=LOCAL, linewidth=0.8)
        for index, agents in enumerate(sizes):
            shown = [row for row in rows if (row.of["attack"], row.of["agents"]) == (attack, agents) and row.trials]
            if shown:
                x = np.array([100.0 * (row.of["liars"] / row.of["agents"]) for row in shown])
                shift = (index - (len(sizes) - 1) / 2.0) * _APART
                curve(axes, x + shift, [row["broken"] for row in shown], index, f"{agents} agents", 100.0)
                without = [100.0 * (1.0 - row["honest_majority"].value) for row in shown]
                colour = RUN_COLOURS[index % len(RUN_COLOURS)]
                axes.plot(x, without, color=colour, linestyle=_BOUND_STYLE, linewidth=1.3)
        axes.set_title(plain(attack), fontsize=9.5, color=INK, loc="left")
        axes.set_xlabel("liars (% of all agents)", fontsize=9.5, color=INK)
        axes.set_ylim(-3.0, 103.0)
    panels[0].set_ylabel("broken trials (%)", fontsize=9.5, color=INK)
    label = "objects without an honest majority"
    legend_above(figure, panels[0], Line2D([], [], color=LOCAL, linestyle=_BOUND_STYLE, linewidth=1.3, label=label))
    caption = (
        f"Lines with markers: broken trials with 95 % intervals ({size}). A trial is broken if the picture is "
        "worse than the ego alone, or an honest agent is suspended before any liar. Dashed: objects without an honest "
        "majority of viewers, the bound of identification."
    )
    return render("breakdown", figure, f"Broken trials over the share of liars. {words}", caption, printed=True)
