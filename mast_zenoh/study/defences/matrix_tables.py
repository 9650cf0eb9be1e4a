"""The tables of a matrix of defences, for every format."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Any

from mast_zenoh.metrics.significance import clearest
from mast_zenoh.metrics.study_results import Row, Statistic, Survival, TrustPanel, plural
from mast_zenoh.metrics.trust import Roc
from mast_zenoh.show.findings.words import paragraph
from mast_zenoh.show.tables.text_table import (
    DASH,
    ResultTables,
    TextTable,
    measured,
    median_delay,
    number,
    numbers_of_rows,
    shown,
    table_of_rows,
    whole,
)
from mast_zenoh.study.defences.kinds import few_trials

#: Measures of a cell, and their headings. Objects are counted per frame in the ego's picture.
DEFENCE_MEASURES = {
    "damage": "missed and false objects added",
    "fn_added": "FN added",
    "fp_added": "FP added",
    "ospa_added_m": "OSPA added (m)",
    "fn_vs_undefended": "FN, minus undefended",
    "fp_vs_undefended": "FP, minus undefended",
    "ospa_vs_undefended_m": "OSPA, minus undefended (m)",
    "fp_identifiable": "false objects inserted, identifiable",
    "fp_unidentifiable": "false objects inserted, not identifiable",
    "attacked": "runs with a lie (share)",
    "identifiable_removed": "identifiable false objects removed (share)",
    "lies_detected": "observable lies detected (share)",
    "median_delay_s": "median delay (s)",
    "honest_suspended_per_hour": "honest agents suspended per hour",
    "faulty_suspended_per_hour": "faulty agents suspended per hour",
    "wrongly_suspended": "runs without lies that suspend an agent (share)",
    "framed": "runs with a lie in which an honest agent is framed (share)",
    "framed_by_minority": "framed, liars below the local majority (share)",
    "framed_by_majority": "framed, liars in the local majority (share)",
    "honest_majority": "objects with an honest majority (share)",
    "liars_watched": "liars with an observable lie",
    "liars_suspended": "of these suspended",
    "suspended_before": "suspended before",
}


@dataclass(frozen=True, slots=True, eq=False)
class DefenceRoc:
    """How well one defence's suspicion tells liars from honest agents, one score for each agent-run.

    partial_auc: mean share of liars detected below one false alarm per hour; unknown for less than an hour
    hours: of all runs together
    """

    defence: str
    roc: Roc
    auc: Statistic
    partial_auc: Statistic
    hours: float


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class MatrixTable:
    """The cells of a study, and a characteristic and a summary for each defence that judges agents.

    rows: a defence against one adversary, with its most harmful budget: the numbers of DEFENCE_MEASURES (damage is
           relative to no defence and no attack, with the same scene and seed), and s by conduct and state of trust
           (`seconds faulty suspended`), over all agents and trials. They are of: attack, "" without one; budget: lies
           per second of each adversary, None: the attack's own; budgets: number of budgets that were tried
    own:   of the same cells, the user's metrics of the ego's picture, and how much they differ from no defence and no
           attack
    summaries: what a defence is worth, over all rows: shares of DEFENCE_MEASURES over all runs under attack;
           alarms_per_hour: suspensions of honest agents in runs without an attack, of `frames` frames together;
           fn_added, fp_added: objects per frame without an attack; faults_suspended: share of the runs with faults
           alone that suspend an agent
    state_shares: by defence, conduct and state of trust, the share of the time with this conduct, over all cells
    panels: the trust of single trials;  unshown: number of pairs of a defence and an adversary without a panel
    not_suspending: defences that judge agents and suspended nobody in any run; they have no delays
    """

    rows: Sequence[Row]
    rocs: Sequence[DefenceRoc]
    delays: Mapping[str, Survival]
    summaries: Sequence[Row]
    size: str
    own: Sequence[Row] = ()
    state_shares: Mapping[str, Mapping[str, Mapping[str, Statistic]]] = field(default_factory=dict)
    panels: Sequence[TrustPanel] = ()
    unshown: int = 0
    not_suspending: Sequence[str] = ()

    def names(self, key: str) -> list[Any]:
        """The values of a name in order of appearance, without those of runs without an attack."""
        return list(dict.fromkeys(row.of[key] for row in self.rows if row.of["attack"] or key == "defence"))

    def row(self, defence: object, attack: object, n_adversaries: object, placement: object) -> Row | None:
        """The row of a cell; None if there is none. Without adversaries, it is the same for every attack."""
        for row in self.rows:
            quiet = row.of["n_adversaries"] == n_adversaries == 0
            place = row.of["attack"], row.of["n_adversaries"], row.of["placement"]
            if row.of["defence"] == defence and (quiet or place == (attack, n_adversaries, placement)):
                return row
        return None


#: Texts of a row by heading.
Columns = Mapping[str, Callable[[Row], str]]
_FRAMING = ("framed", "framed_by_minority", "framed_by_majority", "wrongly_suspended")
#: Names of a defence, and of a cell, by heading.
_DEFENCE = {"defence": "defence"}
CELL = _DEFENCE | {"adversary": "attack", "n": "n_adversaries", "placement": "placement"}
#: After the number of a cell whose attack never took place, and what it means.
IDLE = "(no lie)"
ABOUT_IDLE = f" {IDLE}: the adversaries, which hear how they are judged, lied in none of these runs."


def _share(each: Statistic) -> str:
    return measured(each, 3)


def _of_runs(each: Statistic) -> str:
    """A share of runs, with their number."""
    return _share(each) + (f" of {each.trials}" if each.trials else "")


#: How measures are shown, unless with two decimals.
_SHOWN = {"median_delay_s": median_delay, "ospa_added_m": _share} | dict.fromkeys(_FRAMING, _of_runs)


def _text(name: str) -> Callable[[Row], str]:
    return shown(name, _SHOWN.get(name, measured))


def _columns(*names: str) -> dict[str, Callable[[Row], str]]:
    return {DEFENCE_MEASURES[name]: _text(name) for name in names}


def tables(matrix: MatrixTable, summed: TextTable) -> list[TextTable]:
    """All tables that have a line, the summary last."""
    judging = {each.of["defence"] for each in matrix.summaries}
    attacked = [row for row in matrix.rows if row["attacked"].known and row.of["defence"] in judging]
    framed = [row for row in attacked if row["framed"].known or row["wrongly_suspended"].known]
    faulty = [row for row in matrix.rows if any(row[name].value for name in row.numbers if "seconds faulty " in name)]
    quiet = [row for row in matrix.rows if not row.of["attack"]]
    names = dict.fromkeys(name for row in matrix.own for name in row.numbers)
    own = {name.replace(" difference", ", difference"): _if_any(name) for name in names}
    costs = _columns("fn_added", "fp_added", "ospa_added_m", "honest_suspended_per_hour", "wrongly_suspended")
    detection = _columns("lies_detected", "median_delay_s", "identifiable_removed", "fp_identifiable")
    detection |= _columns("fp_unidentifiable", "honest_suspended_per_hour")
    detection |= {"suspended": _suspended, "suspended before": shown("suspended_before", whole)}
    faults = _columns("wrongly_suspended", "faulty_suspended_per_hour", "honest_suspended_per_hour", "ospa_added_m")
    no_delay = f" Suspended nobody in any run, so without a delay: {', '.join(matrix.not_suspending)}."
    about = paragraph("matrix_detection") + no_delay * bool(matrix.not_suspending)
    every = [
        table_of_rows("Cost without an attack", "Compared with no defence, per frame.", quiet, costs, _DEFENCE),
        *damage(matrix),
        # What attacks do that move objects without hiding any.
        *by_adversary(matrix, "ospa_added_m", "Distance between picture and truth", _ABOUT_DISTANCE),
        table_of_rows("Your metrics", _ABOUT_OWN, matrix.own if names else [], own, CELL, texts=4),
        table_of_rows("Detection", about, attacked, _LIED | detection, CELL | {"budget": "budget"}, texts=5),
        table_of_rows("Framing", paragraph("matrix_framing"), framed, _LIED | _columns(*_FRAMING), CELL, texts=4),
        table_of_rows("Faults", "Agents with a natural fault that did not lie.", faulty, faults, CELL, texts=4),
        _states_by_conduct(matrix),
        TextTable(
            "ROC",
            "One score for each agent and run: its greatest suspicion. Less than one hour says nothing about one false "
            "alarm per hour.",
            ["defence", "AUC", "partial AUC below 1 false alarm/h", "hours"],
            [[of.defence, _share(of.auc), _share(of.partial_auc), number(of.hours, 3)] for of in matrix.rocs],
            1,
        ),
        summed,
    ]
    return [table for table in every if table.lines]


_ABOUT_DISTANCE = "OSPA added in m, compared with no attack and no defence: positions that are off count, too."
_ABOUT_OWN = "Of the ego's picture; differences are from no defence and no attack."
_ABOUT_DAMAGE = "Missed and false objects added per frame to the ego's picture, compared with no attack and no defence."


def damage(matrix: MatrixTable) -> Iterator[TextTable]:
    """The damage, by placement."""
    return by_adversary(matrix, "damage", "Damage", _ABOUT_DAMAGE)


def by_adversary(matrix: MatrixTable, measure: str, title: str, about: str) -> Iterator[TextTable]:
    """A table for each placement: a line per adversary and number, a column per defence."""
    idle = ABOUT_IDLE if any(row.idle for row in matrix.rows) else ""
    defences = matrix.names("defence")
    for placement in matrix.names("placement"):
        lines = []
        for attack, count in product(matrix.names("attack"), matrix.names("n_adversaries")):
            rows = [matrix.row(defence, attack, count, placement) for defence in defences]
            if any(row is not None for row in rows):
                lines.append([attack, str(count), *(cell_text(row, measure) for row in rows)])
        placed = f"{about} Placement of the adversaries: {placement}.{idle}"
        yield TextTable(f"{title}, {placement}", placed, ["adversary", "n", *defences], lines, 2)


def cell_text(row: Row | None, measure: str) -> str:
    """A measure of a cell; whether its attack never took place."""
    return DASH if row is None else _text(measure)(row) + f" {IDLE}" * row.idle


#: Columns of the summary.
_SUMMARY = {
    DEFENCE_MEASURES["lies_detected"]: shown("lies_detected", _share),
    DEFENCE_MEASURES["median_delay_s"]: shown("median_delay_s", median_delay),
    DEFENCE_MEASURES["identifiable_removed"]: shown("identifiable_removed", _share),
    "false alarms per hour without an attack": shown("alarms_per_hour"),
    "frames": shown("frames", lambda each: whole(each) if each.value else DASH),
    "FN added without an attack": shown("fn_added", _share),
    "FP added without an attack": shown("fp_added", _share),
    "runs with faults that suspend an agent (share)": shown("faults_suspended", _of_runs),
    DEFENCE_MEASURES["framed_by_minority"]: shown("framed_by_minority", _of_runs),
}


def summary(matrix: MatrixTable, added: Columns, about_added: str) -> TextTable:
    """What each defence is worth, over all rows; without columns that do not apply to any.

    added: more columns, of which none is left out
    """
    budgets = ", each with its most harmful budget" if any(row.of["budgets"] > 1 for row in matrix.rows) else ""
    about = paragraph("matrix_summary", budgets=budgets, about_added=about_added)
    table = table_of_rows("Summary", about, matrix.summaries, {**_SUMMARY, **added}, _DEFENCE)
    columns = zip(table.headings, *table.lines, strict=True)
    applying = (column for column in columns if column[0] in added or {*column[1:]} != {DASH})
    headings, *lines = zip(*applying, strict=True)
    return table._replace(headings=headings, lines=lines)


def _if_any(name: str) -> Callable[[Row], str]:
    return lambda row: measured(row.numbers.get(name, Statistic()))


def _suspended(row: Row) -> str:
    """Of how many liars: `3 of 5`."""
    watched, suspended = (row[name] for name in ("liars_watched", "liars_suspended"))
    return f"{whole(suspended)} of {whole(watched)}" if watched.value else DASH


def _lied(share: Statistic) -> str:
    """In how many runs the adversaries lied: `3 of 4`."""
    return f"{round(share.value * share.trials)} of {share.trials}"


_LIED = {"runs with a lie": shown("attacked", _lied)}


def _states_by_conduct(matrix: MatrixTable) -> TextTable:
    """The shares of states for each defence and conduct, over all its cells."""
    states: list[str] = []
    lines = []
    for defence, conducts in matrix.state_shares.items():
        for conduct, shares in conducts.items():
            states = list(shares)
            lines.append([defence, conduct, *(measured(each, 3) for each in shares.values())])
    about = "Share of the time in which agents were in each state of trust."
    return TextTable("States of trust by conduct", about, ["defence", "conduct", *states], lines, 2)


def defence_tables(matrix: MatrixTable, added: Columns | None = None, about_added: str = "") -> ResultTables:
    """All tables; the terminal has the damage for each placement, and the summary.

    The CSV has a row per cell and measure, then per defence. added, about_added: more columns of the summary
    """
    about = paragraph("matrix_about", size=matrix.size)
    source = summary(matrix, added or {}, about_added)
    turned, *lines = zip(source.headings, *source.lines, strict=True)  # it has too many columns for a terminal
    brief = [
        *(table for table in damage(matrix) if table.lines),
        TextTable(source.title, source.about, turned, lines, 1),
    ]
    title = "Defences against adversaries"
    return ResultTables(
        title,
        about,
        matrix.size,
        tables(matrix, source),
        numbers_of_rows(csv_rows(matrix)),
        brief,
        few_trials(each for row in matrix.rows for each in row.numbers.values()),
        headline(matrix),
    )


#: What a headline names, and how.
_HEADLINE = {"damage": "{} missed and false objects a frame", "ospa_added_m": "{} m of OSPA"}


def headline(matrix: MatrixTable) -> str:
    """The clearest damage by an adversary; without a full stop. Empty: too few trials for a test."""
    rows = [row for row in matrix.rows if row.of["attack"]]
    effects = {(index, name): row[name] for index, row in enumerate(rows) for name in _HEADLINE}
    for index, name in clearest(effects):
        row = rows[index]
        of, added = row.of, _HEADLINE[name].format(_text(name)(row))
        liars = f"{of['attack']} ({plural(of['n_adversaries'], 'agent')}, {of['placement']})"
        return f"The clearest damage: {liars} against {of['defence']} adds {added}"
    tests = sum(not math.isnan(each.p) for each in effects.values())
    return f"No adversary does distinguishable damage, in {plural(tests, 'comparison')}" if tests else ""


def csv_rows(matrix: MatrixTable) -> list[Row]:
    """What the CSV has: cells, then defences."""
    summaries = [
        replace(each, numbers={f"summary {name}": value for name, value in each.numbers.items()})
        for each in matrix.summaries
    ]
    shares = [
        Row({"defence": defence}, 0, {f"share {conduct} {state}": each for state, each in states.items()})
        for defence, conducts in matrix.state_shares.items()
        for conduct, states in conducts.items()
    ]
    rocs = ((each.defence, {"auc": each.auc, "partial_auc": each.partial_auc}) for each in matrix.rocs)
    areas = [Row({"defence": defence}, 0, numbers) for defence, numbers in rocs]
    return [*matrix.rows, *matrix.own, *summaries, *shares, *areas]
