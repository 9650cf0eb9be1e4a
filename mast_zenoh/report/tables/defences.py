"""The tables of a matrix of defences for the terminal, as Markdown, CSV and LaTeX."""

from __future__ import annotations

import math
from collections.abc import Iterator

from rich.console import Group
from rich.table import Table

from mast_zenoh.report.defence_rows import MEASURES, DefenceMatrix, Measured
from mast_zenoh.report.tables import text_table
from mast_zenoh.report.tables.defence_lines import damage, summary, tables
from mast_zenoh.report.tables.text_table import digits

_CELL = ("defence", "attack", "n_adversaries", "placement", "budget", "budgets")


def as_markdown(matrix: DefenceMatrix) -> str:
    """All tables as Markdown."""
    about = (
        f"{matrix.size}. In brackets: 95 % intervals over trials, pairs of scene and seed. Differences are between "
        "runs of the same scene and seed."
    )
    return text_table.as_markdown("Defences against adversaries", about, tables(matrix))


def as_rich(matrix: DefenceMatrix) -> Group:
    """The damage in the colours of the terminal, a table for each placement, and the summary at the end."""
    return Group(*(text_table.as_rich(table) for table in damage(matrix) if table.lines), _summary_as_rich(matrix))


def as_csv(matrix: DefenceMatrix) -> str:
    """All numbers with all digits: a row per cell and measure, then per defence; empty where unknown."""
    headings = [*_CELL, "measure", "value", "low", "high", "interval", "trials", "trials_left_out"]
    return text_table.as_csv(headings, _csv_lines(matrix))


def as_latex(matrix: DefenceMatrix) -> str:
    """All tables as LaTeX tabulars, with booktabs."""
    return text_table.as_latex(matrix.size, tables(matrix))


def _csv_lines(matrix: DefenceMatrix) -> Iterator[list[object]]:
    for row in matrix.rows:
        cell = [getattr(row, name) for name in _CELL]
        for name in MEASURES:
            yield [*cell, name, *_digits(row.measures.get(name, Measured()))]
        for conduct, states in row.state_seconds.items():
            for state, seconds in states.items():
                yield [*cell, f"seconds {conduct} {state}", *digits(seconds), *[""] * 5]
    for defence, name, each in _of_defences(matrix):
        yield [defence, *[""] * 5, name, *_digits(each)]


def _of_defences(matrix: DefenceMatrix) -> Iterator[tuple[str, str, Measured]]:
    """Defence, measure and number of the summaries and characteristics."""
    for each in matrix.summaries:
        yield each.defence, "summary lies_detected", each.lies_detected
        yield each.defence, "summary median_delay_s", each.median_delay_s
        yield each.defence, "summary identifiable_removed", each.identifiable_removed
        yield each.defence, "summary alarms_per_hour", each.alarms_per_hour
        yield each.defence, "summary frames", Measured(float(each.frames), trials=each.alarms_per_hour.trials)
        yield each.defence, "summary fn_added", each.fn_added
        yield each.defence, "summary fp_added", each.fp_added
        yield each.defence, "summary faults_suspended", each.faults_suspended
        yield each.defence, "summary framed_by_minority", each.framed_by_minority
    for defence, conducts in matrix.state_shares.items():
        for conduct, shares in conducts.items():
            for state, share in shares.items():
                yield defence, f"share {conduct} {state}", share
    for curve in matrix.rocs:
        yield curve.defence, "auc", curve.auc
        yield curve.defence, "partial_auc", curve.partial_auc


def _summary_as_rich(matrix: DefenceMatrix) -> Table:
    """The summary with a line per number: it has too many columns for a terminal."""
    source = summary(matrix)
    headings, *lines = zip(source.headings, *source.lines, strict=True)
    return text_table.rich_table(source.title, source.about, headings, lines)


def _digits(each: Measured) -> list[str]:
    """The values of the columns from `value` on."""
    method = "" if math.isnan(each.value) and math.isnan(each.low) else each.interval
    return [*digits(*each[:3]), method, str(each.trials), str(each.left_out)]
