"""The tables of the study of driving, and its conclusion."""

from __future__ import annotations

import math
from collections.abc import Mapping

from mast_zenoh.metrics.driving_results import DRIVING_MEASURES, Affected, DrivingRow, DrivingTable
from mast_zenoh.metrics.significance import clearest
from mast_zenoh.metrics.study_results import Estimate, plural
from mast_zenoh.report.tables.study_rows import over_trials, value
from mast_zenoh.report.tables.text_table import (
    BOUNDS,
    DASH,
    ResultTables,
    TextTable,
    digits,
    number,
    whole_percent,
)

_ABOUT = (
    "Per trial. Each trial under attack is paired with its twin: the same scene, seed and defence without the attack. "
    "Each trial with a defence is paired with the same scene, seed and attack without one. Brackets: 95 % intervals, "
    "Student's t over seeds, or over scenes if there are fewer than five seeds but not scenes (n: their number); none "
    "where all are equal."
)
_ZEROS = "(0 in N % [a, b]): the share of pairs without a difference, and its exact 95 % interval."
_NONE = "none"
_HEADINGS = tuple(measure.heading for measure in DRIVING_MEASURES.values())
#: What a headline names if no effect is clear, the worst first.
_HEADLINE = ("collisions", "needless_brakes", "progress_m")
_NO_HARM = "No attack adds collisions or needless brakes, or shortens the way"


def driving_tables(table: DrivingTable) -> ResultTables:
    """The tables of the study; the CSV has a row for each attack, defence, measure and kind of number."""
    row_heads = ("attack", "on", "defence", "trials")
    numbers = [
        [*_names(row), kind, name, *_digits(estimates[name], row.trials)]
        for row in table.rows
        for kind, estimates in (("mean", row.measures), ("added", row.added), ("spared", row.spared))
        for name in estimates
    ] + [
        [*_names(row), kind, name, *_digits(each, row.trials)]
        for row in table.rows
        for name, both in row.own.items()
        for kind, each in zip(("mean", "added"), both, strict=True)
    ]
    own = list(dict.fromkeys(name for row in table.rows for name in row.own))
    sentences = conclusion(table)
    tables = [
        TextTable(title, about, (*row_heads, *_HEADINGS), lines, 3)
        for title, about, lines in (
            ("What the car did", "", [_line(row, row.measures) for row in table.rows]),
            (
                "What the attack adds to what the car did",
                f"Differences from the twin. {_ZEROS}",
                [_line(row, row.added) for row in table.rows if row.added],
            ),
            (
                "What the defence changes of what the car did",
                f"Differences from no defence. {_ZEROS}",
                [_line(row, row.spared) for row in table.rows if row.spared],
            ),
        )
        if lines
    ]
    if own:
        heads = [heading for name in own for heading in (name, f"{name}, added by the attack")]
        missing = Estimate(), Estimate()
        lines = [
            [*_names(row), str(row.trials), *(over_trials(each) for name in own for each in row.own.get(name, missing))]
            for row in table.rows
        ]
        tables.append(TextTable("Your metrics", "Of what the car's agent acts on.", (*row_heads, *heads), lines, 3))
    brief_heads = ("attack, defence", *_HEADINGS)
    brief_lines = [
        [f"{row.title}, {row.defence or _NONE}", *(number(row.measures[name].mean) for name in DRIVING_MEASURES)]
        for row in table.rows
    ]
    brief = TextTable("Driving under attack, means of a trial", " ".join(sentences), brief_heads, brief_lines, 1)
    about = " ".join([f"{table.size}.", *sentences, _ABOUT])
    headings = ("attack", "on", "defence", "number", "measure", *BOUNDS, "zero_share", "zero_low", "zero_high")
    return ResultTables(
        "Driving under attack",
        about,
        table.size,
        tables,
        (headings, numbers),
        [brief],
        headline=headline(table),
        reading=sentences,
    )


def headline(table: DrivingTable) -> str:
    """The clearest harm by an attack; else the worst that one adds; without a full stop.

    Of attacks without a defence, if any was run. Without a harm, what did not take part comes first.
    """
    rows = [row for row in _first_rows(table) if row.harmed.pairs]
    effects = {(index, name): each for index, row in enumerate(rows) for name, each in row.added.items()}
    clear = [(rows[index], name) for index, name in clearest(effects)]
    same = [(row, name) for name in _HEADLINE for row in rows if row.added[name].certain]
    for row, name in (*clear, *same):
        if _harm(name, row.added[name]) > 0.0:
            return _effect(row, name)
    for name in _HEADLINE:
        harms = [(_harm(name, row.added[name]), row) for row in rows if not math.isnan(row.added[name].trial_mean)]
        harm, worst = max(harms, key=lambda pair: pair[0], default=(0.0, None))
        if worst is not None and harm > 0.0:
            alone = "distinguishable alone, but not when all are read together"
            return f"{_effect(worst, name)}: {alone if worst.added[name].differs else 'too few trials to tell'}"
    if any(row.flawed for row in rows):
        return next(iter(flaws(table)), "").removesuffix(".")
    if not rows:
        return ""
    harmed, pairs = sum(row.harmed.happened for row in rows), sum(row.harmed.pairs for row in rows)
    return f"{_NO_HARM} in the mean" if harmed else f"No attack did harm in any of {plural(pairs, 'pair')}"


def _effect(row: DrivingRow, name: str) -> str:
    """`The attack phantom_queue on picture changes the way driven by -54 [-62, -46] m a trial`."""
    added, heading = row.added[name], DRIVING_MEASURES[name].heading
    what = f"changes {heading} by {over_trials(added)}"
    if name == "progress_m":
        what = f"changes the way driven by {over_trials(added)} m"
    elif _harm(name, added) > 0.0:
        what = f"adds {_worded(name, added)}"
    return f"The attack {row.title}{f', with {row.defence},' if row.defence else ''} {what} a trial"


def conclusion(table: DrivingTable) -> list[str]:
    """Sentences: what did not take part, what attacks do, what defences change about it, and what was not run."""
    sentences = flaws(table)
    attacked = [row for row in table.rows if row.attack and row.trials]
    sentences += map(_attack_sentence, _first_rows(table))
    for defence in dict.fromkeys(row.defence for row in table.rows if row.defence):
        rows = [row for row in attacked if row.defence == defence and row.changed.pairs]
        for sign, verb in ((1, "helps against"), (-1, "makes worse")):
            against = [f"{row.title} ({', '.join(shown)})" for row in rows if (shown := _shown(row.spared, sign))]
            if against:
                sentences.append(f"{defence} {verb} {'; '.join(against)}.")
        unclear = [row for row in rows if not (_shown(row.spared, 1) or _shown(row.spared, -1))]
        if flawed := [row.title for row in unclear if row.flawed]:
            sentences.append(f"What {defence} changes for {'; '.join(flawed)} was not tried in every run: see above.")
        tried = [row for row in unclear if not row.flawed]
        if same := [f"{row.title} ({_none_of(row.changed)})" for row in tried if not row.changed.happened]:
            sentences.append(f"No change by {defence} was seen for {'; '.join(same)}.")
        if others := [row.title for row in tried if row.changed.happened]:
            sentences.append(f"Too few trials to tell what {defence} changes for {'; '.join(others)}.")
    if table.not_run:
        rows_not_run = "; ".join(f"{row.title}, {row.defence or _NONE}" for row in table.not_run)
        sentences.append(f"Not run: {rows_not_run}.")
    return sentences


def flaws(table: DrivingTable) -> list[str]:
    """A sentence for each thing that did not take part as the scenario says, with its number of runs."""
    where: dict[tuple[str, int, int], list[str]] = {}
    for row in table.rows:
        flawed = row.flaws
        counted = [
            ("no command of the driver was accepted", flawed.no_command),
            ("the car had no new command in some frames", flawed.uncommanded),
            ("the driver had no estimate in some frames", flawed.no_estimate),
            *((f"{name} changed no message", count) for name, count in flawed.idle.items()),
        ]
        for what, count in counted:
            if count:
                defended = f" and {row.defence}" if row.defence else ""
                where.setdefault((what, count, row.trials), []).append(f"{row.title}{defended}")
    played = [row.trials for row in table.rows if row.trials]
    sentences = []
    for (what, count, trials), titles in where.items():
        if count == trials and len(titles) == len(played):
            sentences.append(f"In all {sum(played)} runs, {what}.")
        else:
            each = "each " * (len(titles) > 1)
            sentences.append(f"In {count} of {trials} runs {each}with {'; '.join(titles)}, {what}.")
    return sentences


def _first_rows(table: DrivingTable) -> list[DrivingRow]:
    """The rows under attack without a defence, or all if there is none."""
    attacked = [row for row in table.rows if row.attack and row.trials]
    return [row for row in attacked if not row.defence] or attacked


def _attack_sentence(row: DrivingRow) -> str:
    """What an attack adds."""
    defended = f"With {row.defence}" if row.defence else "Without a defence"
    worse, perhaps = _shown(row.added, -1), _not_shown(row.added)
    does = [f"adds {', '.join(worse)}"] * bool(worse)
    does += [f"{'perhaps ' * bool(worse)}adds {', '.join(perhaps)}: too few trials to tell"] * bool(perhaps)
    if does:
        return f"{defended}, {row.title} {' and '.join(does)}."
    if not row.harmed.pairs:
        return f"{row.title[:1].upper()}{row.title[1:]} has no pair with a run without it."
    if row.flawed:
        return f"{defended}, what {row.title} does was not tried in every run: see above."
    if not row.harmed.happened:
        return f"{defended}, no harm by {row.title} was seen {_none_of(row.harmed)}."
    pairs = f"{row.harmed.happened} of {plural(row.harmed.pairs, 'pair')}"
    return f"{defended}, {row.title} does harm in {pairs}, and none in the mean."


def _none_of(affected: Affected) -> str:
    """`in 5 of 5 pairs; its chance is below 52 % (exact, 95 %)`, for what did not happen."""
    bound = whole_percent(affected.chance.high)
    return f"in {affected.pairs} of {plural(affected.pairs, 'pair')}; its chance is below {bound} % (exact, 95 %)"


def _shown(numbers: Mapping[str, Estimate], sign: int) -> list[str]:
    """The measures that are shown to differ, for the better (1) or for the worse (-1), with their intervals."""
    return [_worded(name, each) for name, each in numbers.items() if each.differs and sign * _harm(name, each) < 0.0]


def _not_shown(numbers: Mapping[str, Estimate]) -> list[str]:
    """The measures that are worse in the mean, although too few trials show it."""
    return [_worded(name, each) for name, each in numbers.items() if _harm(name, each) > 0.0 and not each.differs]


def _harm(name: str, each: Estimate) -> float:
    """The mean, positive where it is worse for the car."""
    return -each.trial_mean * DRIVING_MEASURES[name].better


def _worded(name: str, each: Estimate) -> str:
    """`3.03 [2.51, 3.56] needless brakes`, or `0.27 collisions (0 in 73 % [54, 88] of the pairs)`."""
    heading = DRIVING_MEASURES[name].heading
    if not each.mostly_zero:
        return f"{over_trials(each)} {heading}"
    share, low, high = map(whole_percent, (each.zero_share, each.zero_low, each.zero_high))
    return f"{value(each)} {heading} (0 in {share} % [{low}, {high}] of the pairs)"


def _names(row: DrivingRow) -> tuple[str, str, str]:
    return row.attack or _NONE, row.wire or DASH, row.defence or _NONE


def _line(row: DrivingRow, estimates: Mapping[str, Estimate]) -> list[str]:
    return [*_names(row), str(row.trials), *(over_trials(estimates[name]) for name in DRIVING_MEASURES)]


def _digits(each: Estimate, done: int) -> list[str]:
    """BOUNDS of an estimate, and its share of zeros. done: number of trials"""
    trials = each.scenes * each.seeds
    interval = "" if math.isnan(each.low) else "Student's t"
    zeros = digits(each.zero_share, each.zero_low, each.zero_high)
    return [*digits(each.trial_mean, each.low, each.high), interval, str(trials), str(done - trials), *zeros]
