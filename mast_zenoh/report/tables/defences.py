"""The tables of a matrix of defences, for every format."""

from __future__ import annotations

import math
from collections.abc import Iterator

from mast_zenoh.metrics.study_results import (
    BINOMIAL,
    DEFENCE_MEASURES,
    DefenceMatrix,
    DefenceRow,
    DefenceSummary,
    Measured,
)
from mast_zenoh.report.tables.text_table import DASH, ResultTables, TextTable, digits, measured, median_delay, number

#: Measures of each table.
_COSTS = ("fn_added", "fp_added", "ospa_added_m", "honest_suspended_per_hour", "wrongly_suspended")
_DETECTION = (
    *("lies_detected", "median_delay_s", "identifiable_removed", "fp_identifiable", "fp_unidentifiable"),
    "honest_suspended_per_hour",
)
_FRAMING = ("framed", "framed_by_minority", "framed_by_majority")
_FAULTS = ("wrongly_suspended", "faulty_suspended_per_hour", "honest_suspended_per_hour", "ospa_added_m")


def tables(matrix: DefenceMatrix) -> list[TextTable]:
    """All tables that have a line, the summary last."""
    every = [_costs(matrix), *damage(matrix), _detection(matrix), _framing(matrix), _faults(matrix)]
    every += [_states_by_conduct(matrix), _characteristics(matrix), summary(matrix)]
    return [table for table in every if table.lines]


def damage(matrix: DefenceMatrix) -> Iterator[TextTable]:
    """A table for each placement: a line per adversary and number, a column per defence."""
    defences = matrix.names("defence")
    for placement in matrix.names("placement"):
        lines = []
        for attack in matrix.names("attack"):
            for count in matrix.names("n_adversaries"):
                rows = [matrix.row(defence, attack, count, placement) for defence in defences]
                if any(row is not None for row in rows):
                    lines.append([str(attack), str(count), *(_measure(row, "damage") for row in rows)])
        about = (
            "Missed and false objects added per frame to the ego's picture, compared with no attack and no defence. "
            f"Placement of the adversaries: {placement}."
        )
        yield TextTable(f"Damage, {placement}", about, ["adversary", "n", *map(str, defences)], lines, 2)


def summary(matrix: DefenceMatrix) -> TextTable:
    """What each defence is worth, over all rows."""
    headings = [
        *(
            "defence",
            DEFENCE_MEASURES["lies_detected"],
            DEFENCE_MEASURES["median_delay_s"],
            DEFENCE_MEASURES["identifiable_removed"],
        ),
        *("false alarms per hour without an attack", "frames", "FN added without an attack"),
        *("FP added without an attack", "runs with faults that suspend an agent (share)"),
        DEFENCE_MEASURES["framed_by_minority"],
    ]
    about = (
        "Over all adversaries above, each with its most harmful budget. False alarms are suspensions of honest agents "
        "in runs without an attack, of as many frames as given."
    )
    return TextTable("Summary", about, headings, [_summary(each) for each in matrix.summaries], 1)


def _summary(each: DefenceSummary) -> list[str]:
    return [
        each.defence,
        measured(each.lies_detected, 3),
        median_delay(each.median_delay_s),
        measured(each.identifiable_removed, 3),
        measured(each.alarms_per_hour),
        f"{each.frames}" if each.frames else DASH,
        measured(each.fn_added, 3),
        measured(each.fp_added, 3),
        _of_runs(each.faults_suspended),
        _of_runs(each.framed_by_minority),
    ]


def _costs(matrix: DefenceMatrix) -> TextTable:
    lines = [[row.defence, *(_measure(row, name) for name in _COSTS)] for row in matrix.rows if not row.attack]
    headings = ["defence", *(DEFENCE_MEASURES[name] for name in _COSTS)]
    return TextTable("Cost without an attack", "Compared with no defence, per frame.", headings, lines, 1)


def _detection(matrix: DefenceMatrix) -> TextTable:
    lines = []
    for row in matrix.rows:
        if row.delay is None or row.defence not in matrix.delays:
            continue
        values = [_measure(row, name) for name in _DETECTION]
        lines.append([*_cell_of(row), _budget(row), *values, f"{row.delay.detections} of {row.delay.watched}"])
    about = (
        "Lies that an honest agent could notice, and whether their object was withheld or their agent suspended; the "
        "time from the first of them to the suspension of its agent; how many of the liars were suspended."
    )
    headings = [*_CELL, "budget", *(DEFENCE_MEASURES[name] for name in _DETECTION), "suspended"]
    return TextTable("Detection", about, headings, lines, 5)


def _framing(matrix: DefenceMatrix) -> TextTable:
    judging = {each.defence for each in matrix.summaries}
    rows = [row for row in matrix.rows if row.measures["framed"].trials and row.defence in judging]
    lines = [[*_cell_of(row), *(_of_runs(row.measures[name]) for name in _FRAMING)] for row in rows]
    about = (
        "An honest agent is framed if it is suspended after the first lie of a run. Liars are in the local majority if "
        "they outnumber the honest viewers of at least half of the lies that an honest agent could notice."
    )
    return TextTable("Framing", about, [*_CELL, *(DEFENCE_MEASURES[name] for name in _FRAMING)], lines, 4)


def _faults(matrix: DefenceMatrix) -> TextTable:
    rows = [row for row in matrix.rows if any(row.state_seconds.get("faulty", {}).values())]
    lines = [[*_cell_of(row), *(_measure(row, name) for name in _FAULTS)] for row in rows]
    about = "Agents with a natural fault that did not lie."
    return TextTable("Faults", about, [*_CELL, *(DEFENCE_MEASURES[name] for name in _FAULTS)], lines, 4)


def _states_by_conduct(matrix: DefenceMatrix) -> TextTable:
    """The shares of states for each defence and conduct, over all its cells."""
    states: list[str] = []
    lines = []
    for defence, conducts in matrix.state_shares.items():
        for conduct, shares in conducts.items():
            states = list(shares)
            lines.append([defence, conduct, *(measured(each, 3) for each in shares.values())])
    about = "Share of the time in which agents were in each state of trust."
    return TextTable("States of trust by conduct", about, ["defence", "conduct", *states], lines, 2)


def _characteristics(matrix: DefenceMatrix) -> TextTable:
    lines = [
        [each.defence, measured(each.auc, 3), measured(each.partial_auc, 3), number(each.hours, 3)]
        for each in matrix.rocs
    ]
    headings = ["defence", "AUC", "partial AUC below 1 false alarm/h", "hours"]
    return TextTable("ROC", "One score for each agent and run: its greatest suspicion.", headings, lines, 1)


_CELL = ["defence", "adversary", "n", "placement"]


def _cell_of(row: DefenceRow) -> list[str]:
    return [row.defence, row.attack or DASH, str(row.n_adversaries), row.placement or DASH]


def _budget(row: DefenceRow) -> str:
    return DASH if row.budget is None else f"{row.budget:g}"


def _measure(row: DefenceRow | None, name: str) -> str:
    if row is None:
        return DASH
    each = row.measures.get(name, Measured())
    if name == "median_delay_s":
        return median_delay(each)
    return _of_runs(each) if each.interval == BINOMIAL else measured(each)


def _of_runs(each: Measured) -> str:
    """A share of runs, with their number."""
    return measured(each, 3) + (f" of {each.trials}" if each.trials else "")


_CSV_CELL = ("defence", "attack", "n_adversaries", "placement", "budget", "budgets")


#: The numbers of a summary.
_SUMMARY = (
    *("lies_detected", "median_delay_s", "identifiable_removed", "alarms_per_hour", "frames", "fn_added", "fp_added"),
    *("faults_suspended", "framed_by_minority"),
)


def defence_tables(matrix: DefenceMatrix) -> ResultTables:
    """All tables; the terminal has the damage for each placement, and the summary.

    The CSV has a row per cell and measure, then per defence.
    """
    about = (
        f"{matrix.size}. In brackets: 95 % intervals over trials, pairs of scene and seed. Differences are between "
        "runs of the same scene and seed."
    )
    headings = [*_CSV_CELL, "measure", "value", "low", "high", "interval", "trials", "trials_left_out"]
    source = summary(matrix)
    turned, *lines = zip(source.headings, *source.lines, strict=True)  # it has too many columns for a terminal
    brief = [
        *(table for table in damage(matrix) if table.lines),
        TextTable(source.title, source.about, turned, lines, 1),
    ]
    numbers = headings, list(_csv_lines(matrix))
    return ResultTables("Defences against adversaries", about, matrix.size, tables(matrix), numbers, brief)


def _csv_lines(matrix: DefenceMatrix) -> Iterator[list[object]]:
    for row in matrix.rows:
        cell = [getattr(row, name) for name in _CSV_CELL]
        for name in DEFENCE_MEASURES:
            yield [*cell, name, *_digits(row.measures.get(name, Measured()))]
        for conduct, states in row.state_seconds.items():
            for state, seconds in states.items():
                yield [*cell, f"seconds {conduct} {state}", *digits(seconds), *[""] * 5]
    for defence, name, each in _of_defences(matrix):
        yield [defence, *[""] * 5, name, *_digits(each)]


def _of_defences(matrix: DefenceMatrix) -> Iterator[tuple[str, str, Measured]]:
    """Defence, measure and number of the summaries and characteristics."""
    for each in matrix.summaries:
        frames = Measured(float(each.frames), trials=each.alarms_per_hour.trials)
        for name in _SUMMARY:
            yield each.defence, f"summary {name}", frames if name == "frames" else getattr(each, name)
    for defence, conducts in matrix.state_shares.items():
        for conduct, shares in conducts.items():
            for state, share in shares.items():
                yield defence, f"share {conduct} {state}", share
    for curve in matrix.rocs:
        yield curve.defence, "auc", curve.auc
        yield curve.defence, "partial_auc", curve.partial_auc


def _digits(each: Measured) -> list[str]:
    """The values of the columns from `value` on."""
    method = "" if math.isnan(each.value) and math.isnan(each.low) else each.interval
    return [*digits(*each[:3]), method, str(each.trials), str(each.left_out)]
