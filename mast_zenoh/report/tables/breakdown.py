"""The tables of the study of the breakdown point: Markdown, CSV, LaTeX and the terminal's."""

from __future__ import annotations

from collections.abc import Iterator

from rich.console import Group

from mast_zenoh.report.defence_rows import Measured
from mast_zenoh.report.limit_rows import BreakdownPoint, BreakdownRow, BreakdownTable
from mast_zenoh.report.tables import text_table
from mast_zenoh.report.tables.study_rows import number
from mast_zenoh.report.tables.text_table import TextTable, digits, percent

_POINT_HEADINGS = ("attack", "agents", "breakdown point (%)", "bound (%)", "difference (percentage points)")
_ROW_HEADINGS = (
    *("attack", "agents", "liars", "liars (%)", "trials", "broken (%)", "picture worse than the ego alone (%)"),
    *("honest agent suspended first (%)", "honest agents suspended (%)", "objects with an honest majority (%)"),
)
#: Of the terminal's table, in per cent.
_SHORT_HEADINGS = ("attack", "liars", "broken", "worse", "honest first", "honest suspended", "majority")
_SHARES = ("broken", "worse", "honest_first")
_MEANS = ("honest_suspended", "honest_majority")
_CSV_HEADINGS = ("attack", "agents", "liars", "trials", "measure", "value", "low", "high")


def as_markdown(table: BreakdownTable) -> str:
    """All tables."""
    about = (
        f"{table.size}. A trial is broken if the ego's picture has more missed and false objects than its own tracks "
        "from the start of the attack on, or if an honest agent is suspended before any liar. A suspension that "
        "happens in the run without liars of the same scene and seed, too, is a false alarm that no liar caused: it "
        "counts only as a suspended honest agent."
    )
    return text_table.as_markdown("Breakdown point", about, _tables(table))


def as_latex(table: BreakdownTable) -> str:
    """All tables as LaTeX tabulars, with booktabs."""
    return text_table.as_latex(table.size, _tables(table))


def as_csv(table: BreakdownTable) -> str:
    """A row for each attack and numbers of agents and liars, then one for each point; shares from 0 to 1.

    The column `liars` is empty in the rows of points; `inf` is not reached, empty is unknown.
    """
    return text_table.as_csv(_CSV_HEADINGS, _csv_lines(table))


def as_rich(table: BreakdownTable) -> Group:
    """The points and the rows for the terminal."""
    points, _ = _tables(table)
    rows = TextTable("Broken trials (%)", "", _SHORT_HEADINGS, [_short_line(row) for row in table.rows], 1)
    return Group(text_table.as_rich(points._replace(about="")), text_table.as_rich(rows))


def _tables(table: BreakdownTable) -> tuple[TextTable, TextTable]:
    """The points, and the rows."""
    about_points = (
        "Smallest share of liars at which half of the trials are broken, next to that at which half of the objects "
        "have no honest majority of viewers. Bootstrap 95 % intervals over trials."
    )
    points = [_point(each) for each in table.points.values()]
    about_rows = "With the 95 % interval of Clopper and Pearson."
    return (
        TextTable("Breakdown points", about_points, _POINT_HEADINGS, points, 1),
        TextTable("Broken trials", about_rows, _ROW_HEADINGS, [_row(row) for row in table.rows], 1),
    )


def _csv_lines(table: BreakdownTable) -> Iterator[list[object]]:
    for row in table.rows:
        cell = (row.attack, row.agents, row.liars, row.trials)
        for name in _SHARES:
            yield [*cell, name, *digits(*getattr(row, name)[:3])]
        for name in _MEANS:
            yield [*cell, name, *digits(*Measured(getattr(row, name))[:3])]
    for point in table.points.values():
        for name in ("point", "bound", "difference"):
            yield [point.attack, point.agents, "", "", f"breakdown_{name}", *digits(*getattr(point, name)[:3])]


def _short_line(row: BreakdownRow) -> list[str]:
    shares = (row.worse.value, row.honest_first.value, row.honest_suspended, row.honest_majority)
    return [
        *(row.attack, f"{row.liars} of {row.agents}", percent(row.broken)),
        *(number(100.0 * each, 0) for each in shares),
    ]


def _point(point: BreakdownPoint) -> list[str]:
    most = f"> {100.0 * point.most:.0f}"
    numbers = [percent(point.point, beyond=most), percent(point.bound, beyond=most)]
    beyond = f"> {number(100.0 * (point.most - point.bound.value), 0)}"
    return [point.attack, str(point.agents), *numbers, percent(point.difference, beyond=beyond)]


def _row(row: BreakdownRow) -> list[str]:
    cell = [row.attack, str(row.agents), str(row.liars), f"{100.0 * row.share:.0f}", str(row.trials)]
    means = (percent(Measured(getattr(row, name))) for name in _MEANS)
    return [*cell, *(percent(getattr(row, name)) for name in _SHARES), *means]
