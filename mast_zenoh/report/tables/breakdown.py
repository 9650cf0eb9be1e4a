"""The tables of the study of the breakdown point: Markdown, CSV and the terminal's."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence

from rich.console import Group
from rich.table import Table

from mast_zenoh.report.defence_rows import Measured
from mast_zenoh.report.limit_rows import BreakdownPoint, BreakdownRow, BreakdownTable
from mast_zenoh.report.tables.scores import DASH
from mast_zenoh.report.tables.study_rows import number

_POINT_HEADINGS = ("attack", "agents", "breakdown point (%)", "bound (%)", "difference (percentage points)")
_ROW_HEADINGS = (
    *("attack", "agents", "liars", "liars (%)", "trials", "broken (%)", "picture worse than the ego alone (%)"),
    *("honest agent suspended first (%)", "honest agents suspended (%)", "objects with an honest majority (%)"),
)
#: Of the terminal's table, in per cent.
_SHORT_HEADINGS = ("attack", "liars", "broken", "worse", "framed", "suspended", "majority")
_SHARES = ("broken", "worse", "framed")


def as_markdown(table: BreakdownTable) -> str:
    """All tables."""
    parts = [
        "# Where the defence breaks",
        f"{table.size}. A trial is broken if the ego's picture has more missed and false objects than its own tracks "
        "from the start of the attack on, or if an honest agent is suspended before any liar. A suspension that "
        "happens in the run without liars of the same scene and seed, too, is a false alarm that no liar caused: it "
        "counts only as a suspended honest agent.",
        "## Breakdown points",
        "Smallest share of liars at which half of the trials are broken, next to that at which half of the objects "
        "have no honest majority of viewers. Bootstrap 95 % intervals over trials.",
        _lines(_POINT_HEADINGS, [_point(each) for each in table.points.values()]),
        "## Broken trials",
        "With the 95 % interval of Clopper and Pearson.",
        _lines(_ROW_HEADINGS, [_row(row) for row in table.rows]),
    ]
    return "\n\n".join(parts) + "\n"


def as_csv(table: BreakdownTable) -> str:
    """A row for each attack and numbers of agents and liars, then one for each point; shares from 0 to 1.

    The column `liars` is empty in the rows of points; `inf` is not reached, empty is unknown.
    """
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(["attack", "agents", "liars", "trials", "measure", "value", "low", "high"])
    for row in table.rows:
        place = [row.attack, row.agents, row.liars, row.trials]
        for name in _SHARES:
            writer.writerow([*place, name, *_digits(getattr(row, name))])
        writer.writerow([*place, "honest_suspended", *_digits(Measured(row.suspended))])
        writer.writerow([*place, "honest_majority", *_digits(Measured(row.bound))])
    for point in table.points.values():
        for name in ("point", "bound", "difference"):
            writer.writerow([point.attack, point.agents, "", "", f"breakdown_{name}", *_digits(getattr(point, name))])
    return buffer.getvalue()


def as_rich(table: BreakdownTable) -> Group:
    """The points and the rows for the terminal."""
    points = Table(title="Breakdown points", title_justify="left")
    rows = Table(title="Broken trials (%)", title_justify="left")
    for result, headings in ((points, _POINT_HEADINGS), (rows, _SHORT_HEADINGS)):
        for index, heading in enumerate(headings):
            result.add_column(heading, justify="left" if index == 0 else "right")
    for point in table.points.values():
        points.add_row(*_point(point))
    for row in table.rows:
        shares = (number(100.0 * each, 0) for each in (row.worse.value, row.framed.value, row.suspended, row.bound))
        rows.add_row(row.attack, f"{row.liars} of {row.agents}", _percent(row.broken), *shares)
    return Group(points, rows)


def _point(point: BreakdownPoint) -> list[str]:
    most = f"> {100.0 * point.most:.0f}"
    numbers = [_percent(point.point, most), _percent(point.bound, most)]
    beyond = 100.0 * (point.most - point.bound.value)
    return [point.attack, str(point.agents), *numbers, _percent(point.difference, f"> {number(beyond, 0)}")]


def _row(row: BreakdownRow) -> list[str]:
    place = [row.attack, str(row.agents), str(row.liars), f"{100.0 * row.share:.0f}", str(row.trials)]
    means = (_percent(Measured(each)) for each in (row.suspended, row.bound))
    return [*place, *(_percent(getattr(row, name)) for name in _SHARES), *means]


def _percent(measured: Measured, beyond: str = "") -> str:
    """`44 [38, 47]`, in per cent; beyond: what stands for an infinite number."""
    if not measured.known:
        return DASH
    ends = (measured.value, measured.low, measured.high)
    value, low, high = (beyond if math.isinf(each) else number(100.0 * each, 0) for each in ends)
    return value if math.isnan(measured.low) else f"{value} [{low}, {high}]"


def _digits(measured: Measured) -> list[str]:
    numbers = (measured.value, measured.low, measured.high)
    return ["" if math.isnan(each) else repr(float(each)) for each in numbers]


def _lines(headings: Sequence[str], lines: Sequence[Sequence[str]]) -> str:
    rows = [headings, ["---"] * len(headings), *lines]
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)
