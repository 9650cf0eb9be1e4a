"""The tables of the study of displaced objects."""

from __future__ import annotations

from collections.abc import Iterator

from mast_zenoh.metrics.study_results import (
    MIN_SEEDS,
    DriftRow,
    DriftTable,
)
from mast_zenoh.report.tables.text_table import FEW_TRIALS, ResultTables, TextTable, digits, measured, number, percent

_CELL = ("label", "offset_m", "rate_mps", "viewers")
_COUNTS = ("episodes", "detected", "trials", "judged")
_PLAIN = ("floor_s", "floor_m")
_MEASURED = ("delay_s", "ratio", "offset_reached_m", "within", "noticed")
#: The numbers of viewers in the terminal's table.
_MAJORITY = "2 or more"


def drift_tables(table: DriftTable) -> ResultTables:
    """The tables of the study of displaced objects.

    The CSV has a row for each lie and number of viewers (empty: whole runs).
    """
    about = (
        f"{table.size}. Medians by Kaplan and Meier with bootstrap 95 % intervals over trials; shares with the "
        "interval of Clopper and Pearson. The floor is the least delay that is possible at one false alarm per hour."
    )
    ends = [name for each in _MEASURED for name in (each, f"{each}_low", f"{each}_high")]
    lines = [
        [
            *(getattr(row, name) for name in (*_CELL, *_COUNTS)),
            *digits(*(getattr(row, name) for name in _PLAIN)),
            *(text for name in _MEASURED for text in digits(*getattr(row, name)[:3])),
        ]
        for row in table.rows
    ]
    numbers = [*_CELL, *_COUNTS, *_PLAIN, *ends], lines
    brief = [_with_majority(table)]
    delays = [row.delay_s for row in table.rows if row.delay_s.known and not row.delay_s.interval]
    note = FEW_TRIALS if any(each.trials < MIN_SEEDS for each in delays) else ""
    return ResultTables("Displaced objects", about, table.size, list(_drift_tables(table)), numbers, brief, note)


def _with_majority(table: DriftTable) -> TextTable:
    """The rows with enough viewers for a majority, for the terminal."""
    title = "Displaced objects in view of two honest agents or more, until the liar is suspended"
    headings = ("lie", "detected", "delay (s)", "floor (s)", "delay / floor", f"within {table.limit_s:g} s")
    lines = [
        [
            *(row.label, f"{row.detected} of {row.episodes}", measured(row.delay_s), number(row.floor_s)),
            *(measured(row.ratio), _within(row)),
        ]
        for row in table.rows
        if row.viewers == _MAJORITY
    ]
    return TextTable(title, "", headings, lines, 1)


def _within(row: DriftRow) -> str:
    return percent(row.within, " %") + (f" of {row.judged}" if row.within.known else "")


def _drift_tables(table: DriftTable) -> Iterator[TextTable]:
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
    return [
        *(row.label, row.viewers, str(row.episodes), str(row.trials), str(row.detected)),
        *(measured(row.delay_s), number(row.floor_s), measured(row.ratio)),
        *(_within(row), percent(row.noticed, " %")),
    ]
