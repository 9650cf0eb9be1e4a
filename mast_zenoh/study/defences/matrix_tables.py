"""The tables of a matrix of defences, for every format."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace

from mast_zenoh.errors import plural
from mast_zenoh.metrics.study_results import Row, Statistic, clearest
from mast_zenoh.show.findings.words import paragraph
from mast_zenoh.show.number_text import DASH, measured, median_delay, number, percent, whole
from mast_zenoh.show.tables.text_table import ResultTables, TextTable, numbers_of_rows, shown, table_of_rows
from mast_zenoh.study.defences.kinds import few_trials
from mast_zenoh.study.defences.matrix_table import DEFENCE_MEASURES, MatrixTable
from mast_zenoh.study.defences.scoreboard import QUANTITIES, scoreboard_tables

_FRAMING = ("framed", "framed_by_minority", "framed_by_majority", "wrongly_suspended")
#: Measures of a cell in a kind of scene, and their headings.
FIELD_MEASURES = {
    "harm": "missed and false objects, minus undefended",
    "attacked": "runs with a lie (share)",
    "honest_suspended": "runs that suspend an honest agent (share)",
    "cpu_ms": "processor time (ms per frame)",
    "cpu_ratio": "processor time, relative to undefended",
}
#: Texts of a row by heading.
Columns = dict[str, Callable[[Row], str]]
#: Names of a defence, and of a cell, by heading.
_DEFENCE = {"defence": "defence"}
_CELL = _DEFENCE | {"adversary": "attack", "n": "n_adversaries", "placement": "placement"}
#: After the number of a cell whose attack never took place, and what it means.
_IDLE = "(no lie)"
_ABOUT_IDLE = f" {_IDLE}: the adversaries, which hear how they are judged, lied in none of these runs."
#: Of all kinds of scene together.
_ALL_SCENES = "all"


def _share(each: Statistic) -> str:
    return measured(each, 3)


def _of_runs(each: Statistic) -> str:
    """A share of runs, with their number."""
    return _share(each) + (f" of {each.trials}" if each.trials else "")


#: How measures are shown, unless with two decimals.
_SHOWN = {"median_delay_s": median_delay, "ospa_added_m": _share} | dict.fromkeys(_FRAMING, _of_runs)


def _text(name: str) -> Callable[[Row], str]:
    return shown(name, _SHOWN.get(name, measured))


def _columns(*names: str) -> Columns:
    return {DEFENCE_MEASURES[name]: _text(name) for name in names}


def _lied(share: Statistic) -> str:
    """In how many runs the adversaries lied: `3 of 4`."""
    return f"{round(share.value * share.trials)} of {share.trials}"


_LIED: Columns = {"runs with a lie": shown("attacked", _lied)}


def tables(matrix: MatrixTable) -> list[TextTable]:
    """All tables that have a line, but the scoreboard; the summary last."""
    judging = {each.of["defence"] for each in matrix.summaries}
    attacked = [row for row in matrix.rows if row["attacked"].known and row.of["defence"] in judging]
    framed = [row for row in attacked if row["framed"].known or row["wrongly_suspended"].known]
    faulty = [row for row in matrix.rows if any(row[name].value for name in row.numbers if "seconds faulty " in name)]
    quiet = [row for row in matrix.rows if not row.of["attack"]]
    own = dict.fromkeys(name for row in matrix.rows for name in row.numbers if name.startswith("own "))
    of_user = {name.removeprefix("own ").replace(" difference", ", difference"): _text(name) for name in own}
    costs = _columns("fn_added", "fp_added", "ospa_added_m", "honest_suspended_per_hour", "wrongly_suspended")
    detection = _columns("lies_detected", "median_delay_s", "identifiable_removed", "fp_identifiable")
    detection |= _columns("fp_unidentifiable", "honest_suspended_per_hour")
    detection |= {"suspended": _suspended, "suspended before": shown("suspended_before", whole)}
    faults = _columns("wrongly_suspended", "faulty_suspended_per_hour", "honest_suspended_per_hour", "ospa_added_m")
    no_delay = f" Suspended nobody in any run, so without a delay: {', '.join(matrix.not_suspending)}."
    about = paragraph("matrix_detection") + no_delay * bool(matrix.not_suspending)
    states = {name: shown(name, _share) for row in matrix.states for name in row.numbers}
    areas = {"AUC": shown("auc", _share), "partial AUC below 1 false alarm/h": shown("partial_auc", _share)}
    areas |= {"hours": shown("hours", lambda each: number(each.value, 3))}
    judged = [row for row in matrix.summaries if row.of["defence"] in matrix.rocs]
    every = [
        table_of_rows("Cost without an attack", "Compared with no defence, per frame.", quiet, costs, _DEFENCE),
        *damage(matrix),
        # What attacks do that move objects without hiding any.
        *_by_adversary(matrix, "ospa_added_m", "Distance between picture and truth", _ABOUT_DISTANCE),
        table_of_rows("Your metrics", _ABOUT_OWN, matrix.rows if own else [], of_user, _CELL, texts=4),
        table_of_rows("Detection", about, attacked, _LIED | detection, _CELL | {"budget": "budget"}, texts=5),
        table_of_rows("Framing", paragraph("matrix_framing"), framed, _LIED | _columns(*_FRAMING), _CELL, texts=4),
        table_of_rows("Faults", "Agents with a natural fault that did not lie.", faulty, faults, _CELL, texts=4),
        table_of_rows("States of trust by conduct", _ABOUT_STATES, matrix.states, states, texts=2),
        table_of_rows("ROC", _ABOUT_AREAS, judged, areas, _DEFENCE),
        *(_harm(matrix, scene) for scene in matrix.scenes),
        _processor_time(matrix),
        _breakdown(matrix),
        summary(matrix),
    ]
    return [table for table in every if table.lines]


_ABOUT_DISTANCE = "OSPA added in m, compared with no attack and no defence: positions that are off count, too."
_ABOUT_OWN = "Of the ego's picture; differences are from no defence and no attack."
_ABOUT_DAMAGE = "Missed and false objects added per frame to the ego's picture, compared with no attack and no defence."
_ABOUT_STATES = "Share of the time in which agents were in each state of trust."
_ABOUT_AREAS = (
    "One score for each agent and run: its greatest suspicion. Less than one hour says nothing about one false "
    "alarm per hour."
)
_ABOUT_HARM = (
    "Missed and false objects per frame in the ego's picture with the defence, minus those without it under the same "
    "attack. Negative: the defence helps."
)


def damage(matrix: MatrixTable) -> Iterator[TextTable]:
    """The damage, by placement."""
    return _by_adversary(matrix, "damage", "Damage", _ABOUT_DAMAGE)


def _by_adversary(matrix: MatrixTable, measure: str, title: str, about: str) -> Iterator[TextTable]:
    """A table for each placement."""
    names = {"adversary": "attack", "n": "n_adversaries"}
    for placement in matrix.names("placement"):
        rows = [row for row in matrix.rows if row.of["attack"] and row.of["placement"] == placement]
        placed = f"{about} Placement of the adversaries: {placement}."
        yield _grid(f"{title}, {placement}", placed, rows, measure, names, matrix.names("defence"))


def _harm(matrix: MatrixTable, scene: str) -> TextTable:
    rows = [row for row in matrix.by_scene if row.of["scene"] == scene]
    names = {"adversary": "attack", "n": "n_adversaries", "placement": "placement"}
    return _grid(
        f"Harm with and without defence, {scene}", _ABOUT_HARM, rows, "harm", names, matrix.names("defence")[1:]
    )


def _grid(
    title: str, about: str, rows: Sequence[Row], measure: str, names: Mapping[str, str], defences: Sequence[str]
) -> TextTable:
    """A line per adversary, and a column per defence. names: of what tells adversaries apart, by heading"""
    cells: dict[tuple[object, ...], dict[str, Row]] = {}
    for row in rows:
        cells.setdefault(tuple(row.of[name] for name in names.values()), {})[row.of["defence"]] = row
    lines = [
        [
            *(_named(name, each) for name, each in zip(names, of, strict=True)),
            *(_cell(line.get(each), measure) for each in defences),
        ]
        for of, line in cells.items()
    ]
    idle = _ABOUT_IDLE * any(row.idle for row in rows)
    return TextTable(title, about + idle, [*names, *defences], lines if defences else [], len(names))


def _named(heading: str, value: object) -> str:
    return str(value) if value != "" else "none" if heading == "adversary" else DASH


def _cell(row: Row | None, measure: str) -> str:
    """A measure of a cell; whether its attack never took place."""
    return DASH if row is None else _text(measure)(row) + f" {_IDLE}" * row.idle


def _processor_time(matrix: MatrixTable) -> TextTable:
    rows = [
        replace(row, of=row.of | {"attack": row.of["attack"] or "none"})
        for row in matrix.by_scene
        if not row.of["scene"] and row["cpu_ms"].known
    ]
    columns = {FIELD_MEASURES[name]: _text(name) for name in ("cpu_ms", "cpu_ratio")}
    return table_of_rows("Processor time", paragraph("field_processor_time"), rows, columns, _CELL, texts=4)


def _breakdown(matrix: MatrixTable) -> TextTable:
    rows = [
        replace(row, of=row.of | {"scene": row.of["scene"] or _ALL_SCENES, "agents": row.of["agents"] or ""})
        for row in matrix.breakdowns
    ]
    counts = sorted({count for row in rows for count in counts_of(row)})
    columns: Columns = {f"broken with {count} (%)": shown(f"broken {count}", percent) for count in counts}
    columns |= {
        "breaks at (adversaries)": _breaks_at,
        "of all agents (%)": _share_of_liars,
        "weakest against": _weakest,
    }
    names = {name: name for name in ("defence", "scene", "agents")}
    return table_of_rows("Breakdown", paragraph("field_breaking"), rows, columns, names, texts=3)


def counts_of(breakdown: Row) -> list[int]:
    """The numbers of adversaries that were tried."""
    return [int(name.removeprefix("broken ")) for name in breakdown.numbers if name.startswith("broken ")]


def _breaks_at(row: Row) -> str:
    """`1.50 [1.20, 2.00]`, or `> 2` if it is beyond what was tried, or `\u2264 2` if nothing less was."""
    point = row["breaks_at"]
    if not math.isinf(point.value):
        return _at_most(row, point.value) or measured(point)
    low = f" [{number(point.low)}, \u221e)" if math.isfinite(point.low) else ""
    return f"> {max(counts_of(row))}{low}"


def _at_most(row: Row, value: float) -> str:
    """`\u2264 2` if the only number of adversaries that was tried is enough to break it; otherwise empty."""
    tried = {*counts_of(row)} - {0}
    return f"\u2264 {max(tried)}" if len(tried) == 1 and 0.0 < value <= max(tried) else ""


def _share_of_liars(row: Row) -> str:
    point, agents, most = row["breaks_at"], row.of["agents"], max(counts_of(row))
    if not agents or not point.known:
        return DASH
    if _at_most(row, point.value):
        return f"\u2264 {100.0 * most / agents:.0f}"
    scaled = point._replace(**{name: getattr(point, name) / agents for name in ("value", "low", "high")})
    return percent(scaled, beyond=f"> {100.0 * most / agents:.0f}")


def _weakest(row: Row) -> str:
    at = row["weakest_at"].value
    return f"{row.of['weakest']} ({_at_most(row, at) or number(at)})" if row.of["weakest"] else "none"


def _suspended(row: Row) -> str:
    """Of how many liars: `3 of 5`."""
    watched, suspended = (row[name] for name in ("liars_watched", "liars_suspended"))
    return f"{whole(suspended)} of {whole(watched)}" if watched.value else DASH


def summary(matrix: MatrixTable) -> TextTable:
    """What each defence is worth, over all rows; without columns that do not apply to any."""
    breakdowns = {row.of["defence"]: row for row in matrix.breakdowns if not row.of["scene"]}
    budgets = ", each with its most harmful budget" if any(row.of["budgets"] > 1 for row in matrix.rows) else ""
    relative = "processor time {}, relative to undefended".format
    columns: Columns = {
        DEFENCE_MEASURES["lies_detected"]: shown("lies_detected", _share),
        DEFENCE_MEASURES["median_delay_s"]: _text("median_delay_s"),
        DEFENCE_MEASURES["identifiable_removed"]: shown("identifiable_removed", _share),
        "false alarms per hour without an attack": _text("alarms_per_hour"),
        "frames": shown("frames", lambda each: whole(each) if each.value else DASH),
        "FN added without an attack": shown("fn_added", _share),
        "FP added without an attack": shown("fp_added", _share),
        "runs with faults that suspend an agent (share)": shown("faults_suspended", _of_runs),
        DEFENCE_MEASURES["framed_by_minority"]: _text("framed_by_minority"),
        QUANTITIES["harm_removed"]: shown("harm_removed", _share),
    }
    if breakdowns:
        columns["breaks at (adversaries)"] = lambda row: _breaks_at(breakdowns[row.of["defence"]])
        columns["weakest against"] = lambda row: _weakest(breakdowns[row.of["defence"]])
    columns[relative("without an attack")] = _text("cpu_ratio_alone")
    columns[relative("under attack")] = _text("cpu_ratio_attacked")
    about = paragraph("matrix_summary", budgets=budgets, about_added=paragraph("field_added") if breakdowns else "")
    table = table_of_rows("Summary", about, matrix.summaries, columns, _DEFENCE)
    columns_of_text = enumerate(zip(table.headings, *table.lines, strict=True))
    applying = [at for at, (_, *cells) in columns_of_text if {*cells} != {DASH}]
    return table.columns(applying)


def matrix_tables(matrix: MatrixTable) -> ResultTables:
    """All tables; the terminal has the scoreboard, or else the damage for each placement, and the summary.

    The CSV has a line per cell and measure, then per defence; of `mast study matrix` it has a column `scene`, and then
    the lines by kind of scene (`all`: of all), which the others have not.
    """
    board = scoreboard_tables(matrix) if matrix.scenes else None
    own = tables(matrix)
    source = summary(matrix)
    turned, *lines = zip(source.headings, *source.lines, strict=True)  # it has too many columns for a terminal
    brief = board.brief if board else [table for table in damage(matrix) if table.lines]
    return ResultTables(
        "Published and own defences against published and own attacks" if board else "Defences against adversaries",
        paragraph("matrix_about", size=matrix.size),
        matrix.size,
        [*(board.tables if board else ()), *own],
        numbers_of_rows(csv_rows(matrix)),
        [*brief, TextTable(source.title, source.about, turned, lines, 1)],
        few_trials(each for row in matrix.rows for each in row.numbers.values()),
        headline(matrix),
        board.reading if board else (),
    )


#: What a headline names, and how.
_HEADLINE = {"damage": "{} missed and false objects a frame", "ospa_added_m": "{} m of OSPA"}


def headline(matrix: MatrixTable) -> str:
    """The clearest damage by an adversary; without a full stop. Empty: too few trials for a test."""
    rows = [row for row in matrix.rows if row.of["attack"]]
    effects = {(index, name): row[name] for index, row in enumerate(rows) for name in _HEADLINE}
    for index, name in clearest(effects):
        row = rows[index]
        if row[name].value <= 0.0:
            continue  # what a defence leaves may be fewer errors than without attack and defence
        of, added = row.of, _HEADLINE[name].format(_text(name)(row))
        liars = f"{of['attack']} ({plural(of['n_adversaries'], 'agent')}, {of['placement']})"
        return f"The clearest damage: {liars} against {of['defence']} adds {added}"
    tests = sum(not math.isnan(each.p) for each in effects.values())
    return f"No adversary does distinguishable damage, in {plural(tests, 'comparison')}" if tests else ""


def csv_rows(matrix: MatrixTable) -> list[Row]:
    """What the CSV has: cells, then defences, then kinds of scene."""
    summaries = [
        replace(each, numbers={f"summary {name}": value for name, value in each.numbers.items()})
        for each in matrix.summaries
    ]
    shares = [
        replace(row, numbers={f"share {row.of['conduct']} {state}": each for state, each in row.numbers.items()})
        for row in matrix.states
    ]
    rows = [*matrix.rows, *summaries, *shares]
    if not matrix.scenes:
        return rows
    everywhere = [replace(row, of={"scene": ""} | row.of) for row in rows]
    of_scenes = (replace(row, of=row.of | {"scene": row.of["scene"] or _ALL_SCENES}) for row in _rows_by_scene(matrix))
    return [*everywhere, *of_scenes]


def _rows_by_scene(matrix: MatrixTable) -> Iterator[Row]:
    """The numbers by scene; that of the breakdown has its number of adversaries."""
    for row in matrix.by_scene:
        yield replace(row, numbers={name: row[name] for name in FIELD_MEASURES})
    for row in matrix.breakdowns:
        of = {"scene": row.of["scene"], "defence": row.of["defence"]}
        for count in counts_of(row):
            share = row[f"broken {count}"]
            yield Row(of | {"n_adversaries": count}, share.trials, {"broken": share})
        yield Row(of, row["breaks_at"].trials, {"breaks_at": row["breaks_at"]})
        yield Row(of | {"attack": row.of["weakest"]}, 0, {"weakest_at": row["weakest_at"]})
