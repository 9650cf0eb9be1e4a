"""The tables of the study of driving, and its conclusion."""

from __future__ import annotations

import math
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
#: What a headline names, the worst first.
_HEADLINE = ("collisions", "needless_brakes", "progress_m")


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
    brief_heads = ("attack, defence", *_HEADINGS)
    brief_lines = [
        [f"{row.title}, {row.defence or _NONE}", *(number(each.value) for each in _every(row.measures))]
        for row in table.rows
    ]
    brief = TextTable("Driving under attack, means of a trial", summary, brief_heads, brief_lines, 1)
    note = FEW_TRIALS if any(row.trials < MIN_SEEDS for row in table.rows) else ""
    about = f"{table.size}. {summary} {_ABOUT}"
    headings = ("attack", "on", "defence", "number", "measure", *BOUNDS)
    return ResultTables(
        "Driving under attack", about, table.size, tables, (headings, numbers), [brief], note, headline(table)
    )


def headline(table: DrivingTable) -> str:
    """The attack that adds most collisions, else needless brakes, else shortens the way most; without a full stop.

    Of attacks without a defence, if any was run.
    """
    attacked = [row for row in table.rows if row.attack and row.trials]
    rows = [row for row in attacked if not row.defence] or attacked
    for name in _HEADLINE:
        harms = [(_harm(name, row.added[name]), row) for row in rows if row.added[name].known]
        harm, row = max(harms, key=lambda pair: pair[0], default=(0.0, None))
        if row is not None and harm > 0.0:
            added = measured(row.added[name])
            what = f"changes the way driven by {added} m" if name == "progress_m" else f"adds {added} {_heading(name)}"
            defended = f", with {row.defence}," if row.defence else ""
            doubt = "" if _is_shown(row.added[name]) else ": too few trials to tell"
            return f"The attack {row.title}{defended} {what} a trial{doubt}"
    return "No attack adds collisions or needless brakes, or shortens the way" if rows else ""


def conclusion(table: DrivingTable) -> str:
    """What attacks do without a defence, what defences change about it, and which rows were not run."""
    sentences = []
    defences = list(dict.fromkeys(row.defence for row in table.rows if row.defence))
    attacked = [row for row in table.rows if row.attack and row.trials]
    for row in (each for each in attacked if not each.defence):
        worse, perhaps = _shown(row.added, -1), _not_shown(row.added)
        does = [f"adds {_list(worse)}"] * bool(worse)
        does += [f"{'perhaps ' * bool(worse)}adds {_list(perhaps)}: too few trials to tell"] * bool(perhaps)
        sentences.append(f"Without a defence, {row.title} {' and '.join(does) or 'does no harm'}.")
    for defence in defences:
        rows = [row for row in attacked if row.defence == defence]
        for sign, verb in ((1, "helps against"), (-1, "makes worse")):
            against = [f"{row.title} ({_list(shown)})" for row in rows if (shown := _shown(row.spared, sign))]
            if against:
                sentences.append(f"{defence} {verb} {'; '.join(against)}.")
        unclear = [row for row in rows if not (_shown(row.spared, 1) or _shown(row.spared, -1))]
        same = [row.title for row in unclear if all(each.value == 0.0 for each in row.spared.values())]
        if same:
            sentences.append(f"{defence} changes nothing for {'; '.join(same)}.")
        if others := [row.title for row in unclear if row.title not in same]:
            sentences.append(f"Too few trials to tell what {defence} changes for {'; '.join(others)}.")
    if table.not_run:
        rows_not_run = "; ".join(f"{row.title}, {row.defence or _NONE}" for row in table.not_run)
        sentences.append(f"Not run: {rows_not_run}.")
    return " ".join(sentences)


def _shown(numbers: Mapping[str, Measured], sign: int) -> list[str]:
    """The measures that are shown to differ, for the better (1) or for the worse (-1), with their intervals."""
    return [
        f"{measured(each)} {_heading(name)}"
        for name, each in numbers.items()
        if _is_shown(each) and sign * _harm(name, each) < 0.0
    ]


def _not_shown(numbers: Mapping[str, Measured]) -> list[str]:
    """The measures that are worse in the mean, although too few trials show it."""
    return [
        f"{measured(each)} {_heading(name)}"
        for name, each in numbers.items()
        if _harm(name, each) > 0.0 and not _is_shown(each)
    ]


def _is_shown(each: Measured) -> bool:
    """Whether a mean is shown to differ from 0: by its interval, or because it is the same in enough trials."""
    same = each.trials >= MIN_SEEDS and math.isnan(each.low) and each.value != 0.0
    return each.differs_from_zero or same


def _harm(name: str, each: Measured) -> float:
    """The mean, positive where it is worse for the car."""
    return -each.value * DRIVING_MEASURES[name].better


def _heading(name: str) -> str:
    return DRIVING_MEASURES[name].heading


def _list(items: list[str]) -> str:
    return ", ".join(items)


def _names(row: DrivingRow) -> tuple[str, str, str]:
    return row.attack or _NONE, row.wire or DASH, row.defence or _NONE


def _every(numbers: Mapping[str, Measured]) -> list[Measured]:
    return [numbers.get(name, Measured()) for name in DRIVING_MEASURES]


def _cell(each: Measured) -> str:
    return measured(each) if each.known else DASH
