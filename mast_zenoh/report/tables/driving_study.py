"""The tables of the study of driving, and its conclusion."""

from __future__ import annotations

from collections.abc import Mapping

from mast_zenoh.metrics.driving_results import DRIVING_MEASURES, DrivingRow, DrivingTable
from mast_zenoh.metrics.study_results import MIN_SEEDS, Measured
from mast_zenoh.report.tables.text_table import (
    BOUNDS,
    DASH,
    FEW_TRIALS,
    ResultTables,
    TextTable,
    bounds,
    measured,
    number,
)

_ABOUT = (
    "Per trial. Each trial under attack is paired with its twin: the same scene, seed and defence without the attack. "
    "Each trial with a defence is paired with the same scene, seed and attack without one. Brackets: bootstrap 95 % "
    "intervals over trials; none where all differences are equal."
)
_NONE = "none"
_HEADINGS = tuple(measure.heading for measure in DRIVING_MEASURES.values())
_BRIEF = ("collisions", "needless_brakes", "hard_brakes", "progress_m")


def driving_tables(table: DrivingTable) -> ResultTables:
    """The tables of the study; the CSV has a row for each attack, defence, measure and kind of number."""
    row_heads = ("attack", "on", "defence", "trials")
    happened = [[*_names(row), str(row.trials), *map(_cell, _every(row.measures))] for row in table.rows]
    added = [[*_names(row), str(row.trials), *map(_cell, _every(row.added))] for row in table.rows if row.attack]
    spared = [[*_names(row), str(row.trials), *map(_cell, _every(row.spared))] for row in table.rows if row.defence]
    numbers = [
        [*_names(row), kind, name, *bounds(numbers[name])]
        for row in table.rows
        for kind, numbers in (("mean", row.measures), ("added", row.added), ("spared", row.spared))
        for name in numbers
    ]
    summary = conclusion(table)
    tables = [
        TextTable("What happened", "", (*row_heads, *_HEADINGS), happened, 3),
        TextTable("What the attack adds", "Differences from the twin.", (*row_heads, *_HEADINGS), added, 3),
        TextTable("What the defence changes", "Differences from no defence.", (*row_heads, *_HEADINGS), spared, 3),
    ]
    brief_heads = ("attack, defence", *(DRIVING_MEASURES[name].heading for name in _BRIEF))
    brief_lines = [
        [f"{row.title}, {row.defence or _NONE}", *(number(row.measures[name].value) for name in _BRIEF)]
        for row in table.rows
    ]
    brief = TextTable("Driving under attack, means of a trial", summary, brief_heads, brief_lines, 1)
    note = FEW_TRIALS if any(row.trials < MIN_SEEDS for row in table.rows) else ""
    about = f"{table.size}. {summary} {_ABOUT}"
    headings = ("attack", "on", "defence", "number", "measure", *BOUNDS)
    return ResultTables("Driving under attack", about, table.size, tables, (headings, numbers), [brief], note)


def conclusion(table: DrivingTable) -> str:
    """What attacks do without a defence, what defences change about it, and which rows were not run."""
    sentences = []
    defences = list(dict.fromkeys(row.defence for row in table.rows if row.defence))
    attacked = [row for row in table.rows if row.attack and row.trials]
    for row in (each for each in attacked if not each.defence):
        worse = _shown(row.added, -1)
        does = f"adds {_list(worse)}" if worse else "does no harm that is shown"
        sentences.append(f"Without a defence, {row.title} {does}.")
    for defence in defences:
        rows = [row for row in attacked if row.defence == defence]
        for sign, verb in ((1, "helps against"), (-1, "makes worse")):
            against = [f"{row.title} ({_list(shown)})" for row in rows if (shown := _shown(row.spared, sign))]
            if against:
                sentences.append(f"{defence} {verb} {'; '.join(against)}.")
        nothing = [row.title for row in rows if not (_shown(row.spared, 1) or _shown(row.spared, -1))]
        if nothing:
            sentences.append(f"No change by {defence} is shown for {'; '.join(nothing)}.")
    if table.not_run:
        rows_not_run = "; ".join(f"{row.title}, {row.defence or _NONE}" for row in table.not_run)
        sentences.append(f"Not run: {rows_not_run}.")
    return " ".join(sentences)


def _shown(numbers: Mapping[str, Measured], sign: int) -> list[str]:
    """The measures that are shown to differ, for the better (1) or for the worse (-1), with their intervals."""
    return [
        f"{measured(each)} {DRIVING_MEASURES[name].heading}"
        for name, each in numbers.items()
        if each.differs_from_zero and sign * each.value * DRIVING_MEASURES[name].better > 0.0
    ]


def _list(items: list[str]) -> str:
    return ", ".join(items)


def _names(row: DrivingRow) -> tuple[str, str, str]:
    return row.attack or _NONE, row.wire or DASH, row.defence or _NONE


def _every(numbers: Mapping[str, Measured]) -> list[Measured]:
    return [numbers.get(name, Measured()) for name in DRIVING_MEASURES]


def _cell(each: Measured) -> str:
    return measured(each) if each.known else DASH
