"""The tables of the study of displaced objects: Markdown, CSV, LaTeX and the terminal's."""

from __future__ import annotations

from collections.abc import Iterator

from rich.table import Table

from mast_zenoh.report.limit_rows import DriftRow, DriftTable
from mast_zenoh.report.tables import text_table
from mast_zenoh.report.tables.study_rows import number
from mast_zenoh.report.tables.text_table import TextTable, digits, measured, percent

_CELL = ("label", "offset_m", "rate_mps", "viewers")
_COUNTS = ("episodes", "detected", "trials", "judged")
_PLAIN = ("floor_s", "floor_m")
_MEASURED = ("delay_s", "ratio", "offset_reached_m", "within", "noticed")
#: The numbers of viewers in the terminal's table.
_MAJORITY = "2 or more"


def as_markdown(table: DriftTable) -> str:
    """All tables."""
    about = (
        f"{table.size}. Medians by Kaplan and Meier with bootstrap 95 % intervals over trials; shares with the "
        "interval of Clopper and Pearson. The floor is the least delay that is possible at one false alarm per hour."
    )
    return text_table.as_markdown("Displaced objects", about, _tables(table))


def as_latex(table: DriftTable) -> str:
    """All tables as LaTeX tabulars; need no LaTeX package."""
    return text_table.as_latex(table.size, _tables(table))


def as_csv(table: DriftTable) -> str:
    """A row for each lie and number of viewers (empty: whole runs); `inf` is not reached, empty is unknown."""
    ends = [name for each in _MEASURED for name in (each, f"{each}_low", f"{each}_high")]
    lines = (
        [
            *(getattr(row, name) for name in (*_CELL, *_COUNTS)),
            *digits(*(getattr(row, name) for name in _PLAIN)),
            *(text for name in _MEASURED for text in digits(*getattr(row, name)[:3])),
        ]
        for row in table.rows
    )
    return text_table.as_csv([*_CELL, *_COUNTS, *_PLAIN, *ends], lines)


def as_rich(table: DriftTable) -> Table:
    """The rows with enough viewers for a majority, for the terminal."""
    title = "Displaced objects in view of two honest agents or more, until the liar is suspended"
    headings = ("lie", "detected", "delay (s)", "floor (s)", "delay / floor", f"within {table.limit_s:g} s")
    lines = [
        [
            *(row.label, f"{row.detected} of {row.episodes}", measured(row.delay_s), number(row.floor_s)),
            *(measured(row.ratio), percent(row.within, " %") + (f" of {row.judged}" if row.within.known else "")),
        ]
        for row in table.rows
        if row.viewers == _MAJORITY
    ]
    return text_table.as_rich(TextTable(title, "", headings, lines, 1))


def _tables(table: DriftTable) -> Iterator[TextTable]:
    """Whole runs, single objects, and the offsets of drifts."""
    limit = f"within {table.limit_s:g} s"
    objects = [row for row in table.rows if row.viewers]
    yield TextTable(
        "From the first lie to the suspension",
        "Whole runs, regardless of viewers.",
        ("lie", "runs", "suspended", "median delay (s)", limit),
        [_line_of_runs(row) for row in table.rows if not row.viewers],
        1,
    )
    yield TextTable(
        "For each displaced object, by the number of honest agents that see it",
        "",
        (
            *("lie", "honest viewers", "objects", "runs", "detected", "median delay (s)", "floor (s)", "delay / floor"),
            *(limit, f"{limit} (Kaplan-Meier, all episodes)"),
        ),
        [_line(row) for row in objects],
        2,
    )
    drifting = [row for row in objects if row.rate_mps is not None]
    if drifting:
        yield TextTable(
            "Offset that a drift reaches",
            "",
            ("drift", "honest viewers", "median offset (m)", "at the floor (m)"),
            [[row.label, row.viewers, measured(row.offset_reached_m), number(row.floor_m)] for row in drifting],
            2,
        )


def _line_of_runs(row: DriftRow) -> list[str]:
    return [row.label, str(row.trials), str(row.detected), measured(row.delay_s), percent(row.within, " %")]


def _line(row: DriftRow) -> list[str]:
    within = percent(row.within, " %")
    return [
        *(row.label, row.viewers, str(row.episodes), str(row.trials), str(row.detected)),
        *(measured(row.delay_s), number(row.floor_s), measured(row.ratio)),
        *(f"{within} of {row.judged}" if row.within.known else within, percent(row.noticed, " %")),
    ]
