"""The tables of a matrix of defences for the terminal, as Markdown, CSV and LaTeX."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterator, Sequence

from rich.console import Group
from rich.table import Table

from mast_zenoh.report.defence_rows import MEASURES, DefenceMatrix, Measured
from mast_zenoh.report.tables.defence_lines import TextTable, damage, summary, tables
from mast_zenoh.report.tables.scores import DASH

_CELL = ("defence", "attack", "n_adversaries", "placement", "budget", "budgets")


def as_markdown(matrix: DefenceMatrix) -> str:
    """All tables as Markdown."""
    about = (
        f"{matrix.size}. In brackets: 95 % intervals over trials, pairs of scene and seed. Differences are between "
        "runs of the same scene and seed."
    )
    parts = ["# Defences against adversaries", about]
    for table in tables(matrix):
        parts += [f"## {table.title}", table.about, _markdown(table)]
    return "\n\n".join(parts) + "\n"


def as_rich(matrix: DefenceMatrix) -> Group:
    """The damage in the colours of the terminal, a table for each placement, and the summary at the end."""
    return Group(*(_rich(table) for table in damage(matrix) if table.lines), _summary_as_rich(matrix))


def as_csv(matrix: DefenceMatrix) -> str:
    """All numbers with all digits: a row per cell and measure, then per defence; empty where unknown."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow([*_CELL, "measure", "value", "low", "high", "interval", "trials", "trials_left_out"])
    for row in matrix.rows:
        place = ["" if getattr(row, name) is None else getattr(row, name) for name in _CELL]
        for name in MEASURES:
            writer.writerow([*place, name, *_digits(row.measures.get(name, Measured()))])
        for conduct, states in row.confusion.items():
            for state, seconds in states.items():
                writer.writerow([*place, f"seconds {conduct} {state}", repr(float(seconds)), *[""] * 5])
    for defence, name, each in _of_defences(matrix):
        writer.writerow([defence, *[""] * 5, name, *_digits(each)])
    return buffer.getvalue()


def as_latex(matrix: DefenceMatrix) -> str:
    """All tables as LaTeX tabulars; need no LaTeX package."""
    size = matrix.size.replace("\u00d7", "x")
    parts = [f"% brackets: 95 % interval over trials (pairs of scene and seed); {size}"]
    for table in tables(matrix):
        parts += [
            f"% {table.title}. {table.about}",
            r"\begin{tabular}{" + "l" * table.texts + "r" * (len(table.headings) - table.texts) + "}",
            r"\hline",
            " & ".join(map(_tex, table.headings)) + r" \\",
            r"\hline",
            *(" & ".join(map(_tex, line)) + r" \\" for line in table.lines),
            r"\hline",
            r"\end{tabular}",
        ]
    return "\n".join([*parts, ""])


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
        yield each.defence, "summary framed_by_minority", each.framed
    for defence, conducts in matrix.confusions.items():
        for conduct, shares in conducts.items():
            for state, share in shares.items():
                yield defence, f"share {conduct} {state}", share
    for curve in matrix.rocs:
        yield curve.defence, "auc", curve.auc
        yield curve.defence, "partial_auc", curve.partial_auc


def _summary_as_rich(matrix: DefenceMatrix) -> Table:
    """The summary with a line per number: it has too many columns for a terminal."""
    source = summary(matrix)
    table = Table(title=source.title, title_justify="left", caption=source.about, caption_justify="left")
    table.add_column(source.headings[0])
    for line in source.lines:
        table.add_column(line[0], justify="right")
    for heading, *values in zip(source.headings[1:], *(line[1:] for line in source.lines), strict=True):
        table.add_row(heading, *values)
    return table


def _rich(source: TextTable) -> Table:
    table = Table(title=source.title, title_justify="left", caption=source.about, caption_justify="left")
    for index, heading in enumerate(source.headings):
        table.add_column(heading, justify="left" if index == 0 else "right")
    for line in source.lines:
        table.add_row(*line)
    return table


def _markdown(table: TextTable) -> str:
    """A Markdown table."""
    rows: list[Sequence[str]] = [table.headings, ["---"] * len(table.headings), *table.lines]
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def _digits(each: Measured) -> list[str]:
    """The values of the columns from `value` on."""
    numbers = ["" if math.isnan(value) else repr(float(value)) for value in each[:3]]
    if math.isnan(each.value) and math.isnan(each.low):
        return [*numbers, "", str(each.trials), str(each.left_out)]
    return [*numbers, each.interval, str(each.trials), str(each.left_out)]


def _tex(text: str) -> str:
    replacements = (
        *(("\u2212", "$-$"), ("\u221e", r"$\infty$"), (DASH, "--"), ("_", r"\_"), ("%", r"\%"), ("&", r"\&")),
        *(("<", "$<$"), (">", "$>$")),
    )
    for character, replacement in replacements:
        text = text.replace(character, replacement)
    return text
