"""The tables of the matrix of published and own methods, and of published figures next to ours."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

from mast_zenoh.metrics.study_results import Row, Statistic
from mast_zenoh.report.findings.words import paragraph
from mast_zenoh.report.tables.text_table import (
    BOUNDS,
    DASH,
    ResultTables,
    TextTable,
    bounds,
    measured,
    median_delay,
    number,
    numbers_of_rows,
    percent,
    shown,
    table_of_rows,
)
from mast_zenoh.study.defences.matrix_tables import (
    ABOUT_IDLE,
    CELL,
    cell_text,
    csv_rows,
    defence_tables,
)
from mast_zenoh.study.defences.published import PublishedNumber
from mast_zenoh.study.defences.scoreboard import FieldTable, scoreboard_tables

#: Measures of a cell, and their headings.
FIELD_MEASURES = {
    "harm": "missed and false objects, minus undefended",
    "attacked": "runs with a lie (share)",
    "honest_suspended": "runs that suspend an honest agent (share)",
    "cpu_ms": "processor time (ms per frame)",
    "cpu_ratio": "processor time, relative to undefended",
}
#: Our numbers next to published figures, and their headings.
QUANTITIES = {
    "lies_detected": "observable lies detected (share)",
    "harm_removed": "removed of what attacks add (share)",
    "honest_suspended_time": "time in which honest agents are suspended (share)",
    "median_delay_s": "median time to suspension (s)",
    "targets_suspended": "agents attacked that are suspended (share)",
    "fn_added_alone": "missed objects added per frame without an attack",
    "fp_added": "false objects added per frame",
    "damage": "missed and false objects added per frame",
    "ospa_vs_undefended_m": "OSPA, minus undefended (m)",
    "cpu_growth": "processor time, relative to the other attacks",
}


ALL_SCENES = "all"


def field_tables(table: FieldTable) -> ResultTables:
    """The scoreboard and the tables of the matrix, with those of this study before the summary, which has more columns.

    The CSV has all lines of the matrix, and those by kind of scene, with the column `scene` (empty: all).
    """
    added = _added_to_summaries(table)
    of_matrix = defence_tables(table.matrix, added, paragraph("field_added") if added else "")
    board = scoreboard_tables(table)
    others, last = of_matrix.tables[:-1], of_matrix.tables[-1:]  # the last is the summary, if there is any
    own = [*(_harm(table, scene) for scene in table.scenes), _processor_time(table), _breakdown(table)]
    everywhere = [replace(row, of={"scene": ""} | row.of) for row in csv_rows(table.matrix)]
    return of_matrix._replace(
        title="Published and own defences against published and own attacks",
        tables=[*board.tables, *others, *(each for each in own if each.lines), *last],
        numbers=numbers_of_rows([*everywhere, *_csv_rows(table)]),
        brief=[*board.brief, of_matrix.brief[-1]],  # a column for each defence
        reading=board.reading,
    )


def _added_to_summaries(table: FieldTable) -> dict[str, Callable[[Row], str]]:
    """Columns of the summary of the matrix; {} without an attack."""
    own = {row.of["defence"]: row for row in table.summaries}
    breaks_at = {each.of["defence"]: each for each in table.breakdowns if not each.of["scene"]}
    relative = "{}, relative to undefended".format
    columns: dict[str, Callable[[Row], str]] = {
        QUANTITIES["harm_removed"]: lambda row: measured(own[row.of["defence"]]["harm_removed"], 3),
        "breaks at (adversaries)": lambda row: _breaks_at(breaks_at[row.of["defence"]]),
        "weakest against": lambda row: _weakest(breaks_at[row.of["defence"]]),
        relative("processor time without an attack"): lambda row: measured(own[row.of["defence"]]["cpu_ratio_alone"]),
        relative("processor time under attack"): lambda row: measured(own[row.of["defence"]]["cpu_ratio_attacked"]),
    }
    return columns if own else {}


def _harm(table: FieldTable, scene: str) -> TextTable:
    """A line for each attack, and a column for each defence."""
    rows = [row for row in table.rows if row.of["scene"] == scene]
    defences = table.matrix.names("defence")[1:]
    by_place: dict[tuple[str, int, str], dict[str, Row]] = {}
    for row in rows:
        by_place.setdefault(tuple(row.of.values())[2:], {})[row.of["defence"]] = row
    lines = [
        [attack or "none", str(count), placement or DASH, *(cell_text(cells[each], "harm") for each in defences)]
        for (attack, count, placement), cells in by_place.items()
    ]
    about = (
        "Missed and false objects per frame in the ego's picture with the defence, minus those without it under the "
        f"same attack. Negative: the defence helps.{ABOUT_IDLE if any(row.idle for row in rows) else ''}"
    )
    headings = ["adversary", "n", "placement", *defences]
    return TextTable(f"Harm with and without defence, {scene}", about, headings, lines if defences else [], 3)


def _processor_time(table: FieldTable) -> TextTable:
    about = paragraph("field_processor_time")
    rows = [
        replace(row, of=row.of | {"attack": row.of["attack"] or "none"})
        for row in table.rows
        if not row.of["scene"] and row["cpu_ms"].known
    ]
    columns = {FIELD_MEASURES[name]: shown(name) for name in ("cpu_ms", "cpu_ratio")}
    return table_of_rows("Processor time", about, rows, columns, CELL, texts=4)


def _breakdown(table: FieldTable) -> TextTable:
    counts = sorted({count for each in table.breakdowns for count in counts_of(each)})
    lines = [
        [
            *(each.of["defence"], each.of["scene"] or ALL_SCENES, str(each.of["agents"] or DASH)),
            *(percent(each.numbers.get(f"broken {count}", Statistic())) for count in counts),
            *(_breaks_at(each), _share_of_liars(each), _weakest(each)),
        ]
        for each in table.breakdowns
    ]
    headings = [
        *("defence", "scene", "agents", *(f"broken with {count} (%)" for count in counts)),
        *("breaks at (adversaries)", "of all agents (%)", "weakest against"),
    ]
    return TextTable("Breakdown", paragraph("field_breaking"), headings, lines, 3)


def counts_of(breakdown: Row) -> list[int]:
    """The numbers of adversaries that were tried."""
    return [int(name.removeprefix("broken ")) for name in breakdown.numbers if name.startswith("broken ")]


def _breaks_at(each: Row) -> str:
    """`1.50 [1.20, 2.00]`, or `> 2` if it is beyond what was tried, or `\u2264 2` if nothing less was."""
    point = each["breaks_at"]
    if not math.isinf(point.value):
        return _at_most(each, point.value) or measured(point)
    low = f" [{number(point.low)}, \u221e)" if math.isfinite(point.low) else ""
    return f"> {max(counts_of(each))}{low}"


def _at_most(each: Row, value: float) -> str:
    """`\u2264 2` if the only number of adversaries that was tried is enough to break it; otherwise empty."""
    tried = {*counts_of(each)} - {0}
    return f"\u2264 {max(tried)}" if len(tried) == 1 and 0.0 < value <= max(tried) else ""


def _share_of_liars(each: Row) -> str:
    point, agents, most = each["breaks_at"], each.of["agents"], max(counts_of(each))
    if not agents or not point.known:
        return DASH
    if _at_most(each, point.value):
        return f"\u2264 {100.0 * most / agents:.0f}"
    scaled = point._replace(**{name: getattr(point, name) / agents for name in ("value", "low", "high")})
    return percent(scaled, beyond=f"> {100.0 * most / agents:.0f}")


def _weakest(each: Row) -> str:
    at = each["weakest_at"].value
    return f"{each.of['weakest']} ({_at_most(each, at) or number(at)})" if each.of["weakest"] else "none"


def _csv_rows(table: FieldTable) -> Iterator[Row]:
    """The numbers by scene; that of a defence has no attack, that of the breakdown its number of adversaries."""
    for row in table.rows:
        of = row.of | {"scene": row.of["scene"] or ALL_SCENES}
        yield Row(of, row.trials, {name: row[name] for name in FIELD_MEASURES})
    for each in table.breakdowns:
        of = {"scene": each.of["scene"] or ALL_SCENES, "defence": each.of["defence"]}
        for count in counts_of(each):
            share = each[f"broken {count}"]
            yield Row(of | {"n_adversaries": count}, share.trials, {"broken": share})
        yield Row(of, each["breaks_at"].trials, {"breaks_at": each["breaks_at"]})
        yield Row(of | {"attack": each.of["weakest"]}, 0, {"weakest_at": each["weakest_at"]})
    for row in table.summaries:
        numbers = {f"summary {name}": each for name, each in row.numbers.items()}
        yield Row({"scene": ALL_SCENES} | row.of, row.trials, numbers)


# -- published figures -------------------------------------------------------------------------------------------------

_PUBLISHED_TITLE = "The paper's figure, ours on tracks, why different"
_PUBLISHED_HEADINGS = (
    *("stage or attack", "after", "the paper's figure", "known from", "ours on tracks", "why different"),
)
_PUBLISHED_CSV = (
    *("method", "source", "figure", "known_from", "measure", "defence", "attack", *BOUNDS, "why_different"),
)
#: Widths of columns in LaTeX, shares of the line.
_PUBLISHED_WIDTHS = (0.1, 0.13, 0.14, 0.1, 0.2, 0.2)
_NO_FIGURE = "none known to us"
#: Attacks that a cell names; more are counted, as the text above the table names them.
_MOST_NAMED = 4


def published_tables(table: FieldTable) -> ResultTables:
    """The published figures of what was played, each with our numbers and why they differ."""
    if not table.published:
        about = "This study played no method of which a published figure is known, so there is nothing to compare."
        return ResultTables(_PUBLISHED_TITLE, about, table.matrix.size, [], (_PUBLISHED_CSV, []), [])
    attacks = ", ".join(table.matrix.names("attack"))
    about = paragraph("field_published", size=table.matrix.size, attacks=attacks)
    lines = [
        [each.method, each.source, each.figure or _NO_FIGURE, each.basis, _ours(numbers), each.why]
        for each, numbers in table.published
    ]
    latex = "".join(rf"p{{{width:g}\linewidth}}" for width in _PUBLISHED_WIDTHS)
    page = TextTable("Published figures", "", _PUBLISHED_HEADINGS, lines, len(_PUBLISHED_HEADINGS), latex)
    numbers = [
        [
            *(each.method, each.source, each.figure, each.basis),
            *(QUANTITIES[ours.quantity], ours.defence, ", ".join(ours.attacks), *bounds(ours.value), each.why),
        ]
        for each, of_method in table.published
        for ours in of_method
    ]
    return ResultTables(_PUBLISHED_TITLE, about, table.matrix.size, [page], (_PUBLISHED_CSV, numbers), [])


def _ours(numbers: Sequence[PublishedNumber]) -> str:
    """`lies detected (share): Cad 0.50 [0.30, 0.70], under Flood; …`, by quantity and attacks."""
    texts: dict[tuple[str, str], list[str]] = {}
    for ours in numbers:
        named = ", ".join(ours.attacks) if len(ours.attacks) <= _MOST_NAMED else f"all {len(ours.attacks)} attacks"
        text = median_delay(ours.value) if ours.quantity == "median_delay_s" else measured(ours.value, 3)
        under = f", under {named}" if named else ""
        texts.setdefault((QUANTITIES[ours.quantity], under), []).append(f"{ours.defence} {text}")
    return "; ".join(f"{name}: {', '.join(values)}{under}" for (name, under), values in texts.items()) or DASH
