"""The tables of a matrix of defences, for every format."""

from __future__ import annotations

import math
from collections.abc import Iterator

from mast_zenoh.metrics.significance import clearest
from mast_zenoh.metrics.study_results import (
    DEFENCE_MEASURES,
    MIN_SEEDS,
    DefenceMatrix,
    DefenceRow,
    DefenceSummary,
    Measured,
    plural,
)
from mast_zenoh.report.tables.text_table import (
    BOUNDS,
    DASH,
    FEW_TRIALS,
    ResultTables,
    TextTable,
    bounds,
    digits,
    measured,
    median_delay,
    number,
)

#: Measures of each table.
_COSTS = ("fn_added", "fp_added", "ospa_added_m", "honest_suspended_per_hour", "wrongly_suspended")
_DETECTION = (
    *("lies_detected", "median_delay_s", "identifiable_removed", "fp_identifiable", "fp_unidentifiable"),
    "honest_suspended_per_hour",
)
_FRAMING = ("framed", "framed_by_minority", "framed_by_majority", "wrongly_suspended")
#: Shares of runs, whose number is shown, too.
_OF_RUNS = {"wrongly_suspended", "framed", "framed_by_minority", "framed_by_majority"}
#: After the number of a cell whose attack never took place, and what it means.
IDLE = "(no lie)"
ABOUT_IDLE = f" {IDLE}: the adversaries, which hear how they are judged, lied in none of these runs."
_FAULTS = ("wrongly_suspended", "faulty_suspended_per_hour", "honest_suspended_per_hour", "ospa_added_m")


def tables(matrix: DefenceMatrix) -> list[TextTable]:
    """All tables that have a line, the summary last."""
    every = [_costs(matrix), *damage(matrix), *_distance(matrix)]
    every += [_own(matrix), _detection(matrix), _framing(matrix), _faults(matrix)]
    every += [_states_by_conduct(matrix), _characteristics(matrix), summary(matrix)]
    return [table for table in every if table.lines]


def damage(matrix: DefenceMatrix) -> Iterator[TextTable]:
    """The damage, by placement."""
    return _by_adversary(
        matrix,
        "damage",
        "Damage",
        "Missed and false objects added per frame to the ego's picture, compared with no attack and no defence.",
    )


def _distance(matrix: DefenceMatrix) -> Iterator[TextTable]:
    """What attacks do that move objects without hiding any, by placement."""
    return _by_adversary(
        matrix,
        "ospa_added_m",
        "Distance between picture and truth",
        "OSPA added in m, compared with no attack and no defence: positions that are off count, too.",
    )


def _by_adversary(matrix: DefenceMatrix, measure: str, title: str, about: str) -> Iterator[TextTable]:
    """A table for each placement: a line per adversary and number, a column per defence."""
    idle = ABOUT_IDLE if any(row.idle for row in matrix.rows) else ""
    defences = matrix.names("defence")
    for placement in matrix.names("placement"):
        lines = []
        for attack in matrix.names("attack"):
            for count in matrix.names("n_adversaries"):
                rows = [matrix.row(defence, attack, count, placement) for defence in defences]
                if any(row is not None for row in rows):
                    cells = (_measure(row, measure) + (f" {IDLE}" if row and row.idle else "") for row in rows)
                    lines.append([str(attack), str(count), *cells])
        placed = f"{about} Placement of the adversaries: {placement}.{idle}"
        yield TextTable(f"{title}, {placement}", placed, ["adversary", "n", *map(str, defences)], lines, 2)


def summary(matrix: DefenceMatrix) -> TextTable:
    """What each defence is worth, over all rows; without columns that do not apply to any."""
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
    budgets = ", each with its most harmful budget" if any(row.budgets > 1 for row in matrix.rows) else ""
    about = (
        f"Over all adversaries above{budgets}. False alarms are suspensions of honest agents in runs without an "
        "attack, of as many frames as given."
    )
    columns = zip(headings, *(_summary(each) for each in matrix.summaries), strict=True)
    applying = [column for column in columns if {*column[1:]} != {DASH}]
    headings, *lines = map(list, zip(*applying, strict=True))
    return TextTable("Summary", about, headings, lines, 1)


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


def _own(matrix: DefenceMatrix) -> TextTable:
    """The user's metrics, each with its difference from no defence and no attack."""
    names = list(dict.fromkeys(name for row in matrix.rows for name in row.own))
    missing = Measured(), Measured()
    lines = [
        [*_cell_of(row), *(measured(each) for name in names for each in row.own.get(name, missing))]
        for row in matrix.rows
    ]
    headings = [heading for name in names for heading in (name, f"{name}, difference")]
    about = "Of the ego's picture; differences are from no defence and no attack."
    return TextTable("Your metrics", about, [*_CELL, *headings], lines if names else [], 4)


def _detection(matrix: DefenceMatrix) -> TextTable:
    lines = []
    for row in _attacked(matrix):
        values = [_measure(row, name) for name in _DETECTION]
        detected = DASH if row.delay is None else f"{row.delay.detections} of {row.delay.watched}"
        lines.append([*_cell_of(row), _budget(row), _lied(row), *values, detected, str(row.suspended_before)])
    about = (
        "Lies that an honest agent could notice, and whether their object was withheld or their agent suspended; the "
        "time from the first of them to the suspension of its agent; how many of the liars were suspended. Liars that "
        "were suspended before their first such lie have no delay, but their lies count as detected: false alarms "
        "make this share greater."
    )
    if matrix.not_suspending:
        about += f" Suspended nobody in any run, so without a delay: {', '.join(matrix.not_suspending)}."
    headings = [*_CELL, "budget", "runs with a lie", *(DEFENCE_MEASURES[name] for name in _DETECTION)]
    return TextTable("Detection", about, [*headings, "suspended", "suspended before"], lines, 5)


def _framing(matrix: DefenceMatrix) -> TextTable:
    lines = [
        [*_cell_of(row), _lied(row), *(_measure(row, name) for name in _FRAMING)]
        for row in _attacked(matrix)
        if row.measures["framed"].known or row.measures["wrongly_suspended"].known
    ]
    about = (
        "An honest agent is framed if it is suspended after the first lie of a run; runs in which nobody lied have the "
        "last column. Liars are in the local majority if they outnumber the honest viewers of at least half of the "
        "lies that an honest agent could notice."
    )
    headings = [*_CELL, "runs with a lie", *(DEFENCE_MEASURES[name] for name in _FRAMING)]
    return TextTable("Framing", about, headings, lines, 4)


def _attacked(matrix: DefenceMatrix) -> list[DefenceRow]:
    """The rows of defences with adversaries."""
    judging = {each.defence for each in matrix.summaries}
    return [row for row in matrix.rows if row.measures["attacked"].known and row.defence in judging]


def _lied(row: DefenceRow) -> str:
    """In how many runs the adversaries lied: `3 of 4`."""
    share = row.measures["attacked"]
    return f"{round(share.value * share.trials)} of {share.trials}"


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
    about = (
        "One score for each agent and run: its greatest suspicion. Less than one hour says nothing about one false "
        "alarm per hour."
    )
    return TextTable("ROC", about, headings, lines, 1)


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
    if name == "ospa_added_m":
        return measured(each, 3)
    return _of_runs(each) if name in _OF_RUNS else measured(each)


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
        f"{matrix.size}. In brackets: 95 % intervals, of means over seeds. Differences are between runs of the same "
        "scene and seed; where most are 0, the mean has no interval, which would be too narrow."
    )
    headings = [*_CSV_CELL, "measure", *BOUNDS]
    source = summary(matrix)
    turned, *lines = zip(source.headings, *source.lines, strict=True)  # it has too many columns for a terminal
    brief = [
        *(table for table in damage(matrix) if table.lines),
        TextTable(source.title, source.about, turned, lines, 1),
    ]
    numbers = headings, list(_csv_lines(matrix))
    every = [each for row in matrix.rows for each in row.measures.values()]
    few = any(each.known and not each.interval and each.trials < MIN_SEEDS for each in every)
    note = FEW_TRIALS if few else ""
    title = "Defences against adversaries"
    return ResultTables(title, about, matrix.size, tables(matrix), numbers, brief, note, headline(matrix))


#: What a headline names, and how.
_HEADLINE = {"damage": "{} missed and false objects a frame", "ospa_added_m": "{} m of OSPA"}


def headline(matrix: DefenceMatrix) -> str:
    """The clearest damage by an adversary; without a full stop. Empty: too few trials for a test."""
    rows = [row for row in matrix.rows if row.attack]
    effects = {
        (index, name): row.measures.get(name, Measured()) for index, row in enumerate(rows) for name in _HEADLINE
    }
    for index, name in clearest(effects):
        row = rows[index]
        added = _HEADLINE[name].format(measured(row.measures[name], 3 if name == "ospa_added_m" else 2))
        number_of = plural(row.n_adversaries, "agent")
        return f"The clearest damage: {row.attack} ({number_of}, {row.placement}) against {row.defence} adds {added}"
    tests = sum(not math.isnan(each.p) for each in effects.values())
    return f"No adversary does distinguishable damage, in {plural(tests, 'comparison')}" if tests else ""


def _csv_lines(matrix: DefenceMatrix) -> Iterator[list[object]]:
    for row in matrix.rows:
        cell = [getattr(row, name) for name in _CSV_CELL]
        for name in DEFENCE_MEASURES:
            yield [*cell, name, *bounds(row.measures.get(name, Measured()))]
        for name, (mean, added) in row.own.items():
            yield [*cell, name, *bounds(mean)]
            yield [*cell, f"{name} difference", *bounds(added)]
        for conduct, states in row.state_seconds.items():
            for state, seconds in states.items():
                yield [*cell, f"seconds {conduct} {state}", *digits(seconds), *[""] * 5]
    for defence, name, each in _of_defences(matrix):
        yield [defence, *[""] * 5, name, *bounds(each)]


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
