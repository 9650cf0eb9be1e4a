"""The figures of a matrix of defences: damage, delays, ROC and trust."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import product
from typing import Any

from matplotlib.axes import Axes

from mast_zenoh.metrics.study_results import Row, Statistic
from mast_zenoh.show.figures.drawing import RenderedFigure, render
from mast_zenoh.show.figures.facets import Axis, HeatMap, facet, heat_facet, marks
from mast_zenoh.show.figures.plots import trust_figure
from mast_zenoh.show.figures.style import LINE_STYLES, Figure, light_axes, plain
from mast_zenoh.show.findings.words import paragraph
from mast_zenoh.show.number_text import number
from mast_zenoh.show.palette import INK, LOCAL, RUN_COLOURS
from mast_zenoh.study.defences.matrix_table import MatrixTable


def figures_of_defences(matrix: MatrixTable) -> dict[str, RenderedFigure]:
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
    return harm_by_scene(matrix) | figures


def _heat_maps(matrix: MatrixTable) -> RenderedFigure:
    """Damage of every adversary to every defence: a line of maps per placement, a map per number of adversaries."""
    defences, attacks = matrix.names("defence"), matrix.names("attack")
    maps = [
        [
            HeatMap(
                f"{_agents(count)}, {placement}",
                attacks,
                [[matrix.row(defence, attack, count, placement) for defence in defences] for attack in attacks],
            )
            for count in matrix.names("n_adversaries")
        ]
        for placement in matrix.names("placement")
    ]
    figure = heat_facet(maps, defences, "damage", "wrong objects added per frame")
    caption = paragraph("figure_damage_of_adversaries", size=matrix.size, marked=" ".join(marks(matrix.rows)))
    return render("defence_matrix", figure, f"Heat maps of damage. {_worst(matrix)}", caption, printed=True)


def _damage(matrix: MatrixTable) -> RenderedFigure:
    """Damage over the number of adversaries, a panel per adversary; the bound of a majority in the last one."""
    placements, counts = matrix.names("placement"), [0, *matrix.names("n_adversaries")]
    rows = []
    for attack, defence, placement, count in product(
        matrix.names("attack"), matrix.names("defence"), placements, counts
    ):
        row = matrix.row(defence, attack, count, placement)
        if row is not None:
            curve = f"{defence}, {placement}" if len(placements) > 1 else defence
            rows.append(replace(row, of={"panel": attack, "curve": curve, "n": count}))
    # The share of objects with an honest majority is the same for every defence and adversary.
    for placement, count in product(placements, counts):
        places = [row for row in matrix.rows if row.of["n_adversaries"] == count]
        shares = [row["honest_majority"] for row in places if count == 0 or row.of["placement"] == placement]
        share = next((each for each in shares if each.known), Statistic())
        of = {"panel": "honest majority (share of objects)", "curve": f"honest majority, {placement}", "n": count}
        rows.append(Row(of, 0, {"damage": Statistic(share.value)}))
    axis = Axis("damage", "missed and false objects added\nper frame, picture")
    columns = min(4, len({row.of["panel"] for row in rows}))
    figure = facet(
        rows, "n", [axis], "curve", by="panel", columns=columns, label="number of adversaries", size=(2.9, 2.7)
    )
    caption = paragraph("figure_damage_over_adversaries", size=matrix.size)
    return render(
        "damage_over_adversaries", figure, f"Damage over number of adversaries. {_worst(matrix)}", caption, printed=True
    )


def _delays(matrix: MatrixTable) -> RenderedFigure:
    figure, axes = _empty((7.0, 3.8), "s since the first observable lie", "liars not suspended yet (%)")
    for defence, delay in matrix.delays.items():
        label = f"{defence}: {delay.detections} of {delay.watched}"
        axes.step(delay.time_s, 100.0 * delay.undetected, where="post", **_line(matrix, defence, label))
    axes.set_ylim(0.0, 103.0)
    axes.set_xlim(left=0.0)
    axes.legend(frameon=False, fontsize=9, labelcolor=INK, title="suspended", alignment="left")
    caption = paragraph("figure_delays")
    if matrix.not_suspending:
        caption += f" Not drawn, as they suspended nobody: {', '.join(matrix.not_suspending)}."
    values = "; ".join(
        f"{defence} {delay.detections} of {delay.watched}, median {number(delay.median_s)} s"
        for defence, delay in matrix.delays.items()
    )
    return render("detection_delay", figure, f"Share of liars not suspended: {values}.", caption, printed=True)


def _rocs(matrix: MatrixTable) -> RenderedFigure:
    above = "agent-runs above the threshold (%)"
    figure, axes = _empty((5.6, 4.4), f"honest {above}", f"lying {above}")
    axes.plot([0, 100], [0, 100], color=LOCAL, linewidth=0.8)
    areas = {
        row.of["defence"]: number(row["auc"].value) for row in matrix.summaries if row.of["defence"] in matrix.rocs
    }
    for defence, area in areas.items():
        curve = matrix.rocs[defence]
        x, y = 100.0 * curve.false_positive_rate, 100.0 * curve.true_positive_rate
        axes.plot(x, y, **_line(matrix, defence, f"{defence}: AUC {area}"))
    axes.legend(frameon=False, fontsize=9, labelcolor=INK, loc="lower right")
    caption = paragraph("figure_roc")
    values = "; ".join(f"{defence} {area}" for defence, area in areas.items())
    return render("roc", figure, f"Receiver operating characteristics, areas below: {values}.", caption, printed=True)


def _empty(size: tuple[float, float], x_label: str, y_label: str) -> tuple[Figure, Axes]:
    """A figure of this size, in inches, with one pair of axes."""
    figure = Figure(figsize=size, layout="constrained", facecolor="white")
    axes = figure.subplots()
    light_axes(axes)
    axes.set_xlabel(x_label, fontsize=9.5, color=INK)
    axes.set_ylabel(y_label, fontsize=9.5, color=INK)
    return figure, axes


def _line(matrix: MatrixTable, defence: str, label: str) -> dict[str, Any]:
    """How the line of a defence looks, the same in all figures."""
    index = matrix.names("defence").index(defence)
    colour, style = RUN_COLOURS[index % len(RUN_COLOURS)], LINE_STYLES[index % len(LINE_STYLES)]
    return {"color": colour, "linestyle": style, "linewidth": 1.8, "label": plain(label)}


def _worst(matrix: MatrixTable) -> str:
    """The adversary that does the most damage to each defence."""
    parts = []
    for defence in matrix.names("defence"):
        rows = [row for row in matrix.rows if row.of["defence"] == defence and row.of["attack"]]
        rows = [row for row in rows if not math.isnan(row["damage"].value) and not row.idle]
        if rows:
            row = max(rows, key=lambda each: each["damage"].value)
            by = f"{row.of['attack']}, {_agents(row.of['n_adversaries'])}"
            parts.append(f"{defence}: {number(row['damage'].value)} by {by}")
    return f"Most damage to {'; '.join(parts)}." if parts else ""


def _agents(count: object) -> str:
    return f"{count} adversar{'y' if count == 1 else 'ies'}"


def harm_by_scene(matrix: MatrixTable) -> dict[str, RenderedFigure]:
    """For a paper: a panel for each kind of scene (lines), and number and placement of the adversaries (columns)."""
    defences, attacks = matrix.names("defence")[1:], ["", *matrix.names("attack")]
    if not (matrix.scenes and defences) or len(attacks) == 1:
        return {}
    cells = {tuple(row.of.values()): row for row in matrix.by_scene}
    places = list(dict.fromkeys(key[3:] for key in cells if key[2]))
    several = [len({place[at] for place in places}) > 1 for at in (0, 1)]
    maps: list[list[HeatMap]] = []
    for scene in matrix.scenes:
        maps.append([])
        for column, place in enumerate(places):
            shown = attacks[bool(column) :]  # without an attack, the numbers are the same in all columns
            parts = [f"n = {place[0]}"] * (len(places) > 1) + [place[1]] * several[1]
            lines = [
                [cells.get((scene, name, attack, *(place if attack else (0, "")))) for name in defences]
                for attack in shown
            ]
            maps[-1].append(HeatMap(", ".join([scene, *parts]), [attack or "no attack" for attack in shown], lines))
    figure = heat_facet(maps, defences, "harm", "wrong objects per frame, minus no defence")
    adversaries = f"{_agents(places[0][0])}, {places[0][1]}" if len(places) == 1 else "n: number of adversaries"
    caption = paragraph(
        "figure_harm",
        size=matrix.size,
        adversaries=adversaries,
        marked=" ".join(marks([row for row in matrix.by_scene if row.of["scene"]])),
    )
    alt = f"Heat maps of harm relative to no defence. {_best(matrix)}"
    return {"harm_by_scene": render("harm_by_scene", figure, alt, caption, printed=True)}


def _best(matrix: MatrixTable) -> str:
    """By scene, the cells in which a defence helps and harms most."""
    parts = []
    for scene in matrix.scenes:
        rows = [row for row in matrix.by_scene if row.of["scene"] == scene and row["harm"].known and not row.idle]
        rows = [row for row in rows if row.of["defence"] in matrix.names("defence")[1:]]
        if rows:
            least, most = (choose(rows, key=lambda row: row["harm"].value) for choose in (min, max))
            texts = (
                f"{number(each['harm'].value)} by {each.of['defence']} against {each.of['attack'] or 'no attack'}"
                for each in (least, most)
            )
            parts.append(f"{scene}: {' to '.join(texts)}")
    return f"{'; '.join(parts)}." if parts else ""
