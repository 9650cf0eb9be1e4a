"""The matrix of published and own methods as tables, its scoreboard, and what papers report next to our numbers.

published.toml is the only place of the texts about papers. A figure is one that was found in an abstract or in others'
notes (then it says so, and was not checked), in the authors' code, or in the paper. Ours are computed from the trials
of a study (`field_matrix`).
"""

from __future__ import annotations

import math
import tomllib
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import msgspec

from mast_zenoh.metrics.significance import holm
from mast_zenoh.metrics.study_results import LEVEL, MIN_SEEDS, Row, Statistic
from mast_zenoh.show.findings.words import names as join_names
from mast_zenoh.show.findings.words import of_study, paragraph
from mast_zenoh.show.tables.text_table import (
    BOUNDS,
    DASH,
    ResultTables,
    TextTable,
    bounds,
    digits,
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
    MatrixTable,
    cell_text,
    csv_rows,
    defence_tables,
)

# -- what papers report of the methods that our stages and attacks follow, and why our numbers differ ------------------


@dataclass(frozen=True, slots=True)
class Published:
    """A published figure of a method, or a method without one.

    method: our stage or attack;  source: citation
    figure: of the paper, "" if none is known;  basis: how figure and method are known
    quantities: names in `QUANTITIES`, nearest to the figure;  why: ours differs
    defences, attacks: names in the matrix, of which one is the method; (): all
    """

    method: str
    source: str
    basis: str
    quantities: tuple[str, ...]
    why: str
    figure: str = ""
    defences: tuple[str, ...] = ()
    attacks: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class PublishedNumber:
    """One of our numbers next to a published figure.

    quantity: name in `QUANTITIES`
    attacks:  those of the runs that it is from, none: of runs without an attack
    """

    quantity: str
    defence: str
    attacks: Sequence[str]
    value: Statistic


#: Attacks that move what is reported, so that there is nothing to withhold: only a suspension detects them.
BY_SUSPENSION = frozenset({"PosePert"})


#: Stages, then attacks.
PUBLISHED = msgspec.convert(
    tomllib.loads(Path(__file__).with_name("published.toml").read_text("utf-8"))["method"], tuple[Published, ...]
)


# -- the scoreboard: each defence with the case that is worst for it, best first ---------------------------------------

SCOREBOARD = "Scoreboard"
_SCOREBOARD_HEADINGS = (
    *("defence", "beaten most by", "errors added", "by the attack", "minus undefended"),
    *("without an attack", "seeds"),
)
_OF_SCORE = ("defence", "attack", "n_adversaries", "placement", "scene")
_SCOREBOARD_CSV = (*_OF_SCORE, "measure", *BOUNDS, "p_holm", "worst")
#: What is read together of every cell.
_READ_TOGETHER = ("damage", "by_attack", "harm")


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class FieldTable:
    """The matrix, with what only `mast study matrix` has.

    scenes: titles of the kinds of scene, in order
    rows:   the cells of the matrix, in one kind of scene or in all (`scene` is its title, or "" for all together):
            damage:   missed and false objects added per frame, compared with no attack and no defence
            by_attack: compared with the same defence without an attack
            harm:     compared with no defence under this attack
            attacked: share of the runs in which the adversaries lied; unknown without any
            honest_suspended: share of the runs that suspend an agent while it is honest, whether anybody lied or not
            cpu_ms:   of a run, per frame
            cpu_ratio: geometric mean of the ratios to the undefended runs of one scene and seed
    breakdowns: with how many adversaries a defence breaks, see `FieldMatrix._breakdown`
    summaries: what a defence is worth, besides the summaries of the matrix:
            harm_removed: share of what all attacks add to the same picture without them that the defence takes away, in
                      runs in which they took place; negative: they add more with it
            cpu_ratio_alone, cpu_ratio_attacked: relative to no defence
    published: the figures of methods that were played, with ours
    """

    matrix: MatrixTable
    scenes: Sequence[str]
    rows: Sequence[Row]
    breakdowns: Sequence[Row]
    summaries: Sequence[Row]
    published: Sequence[tuple[Published, Sequence[PublishedNumber]]]


class DefenceScore(NamedTuple):
    """A defence: its cells with the greatest damage, of all (`worst`) and of those without an attack (`quiet`)."""

    worst: Row
    quiet: Row


class Scoreboard:
    """The scores of a matrix, the smallest worst case first; none without a defence, or without an adversary.

    rows:     the cells that scores are chosen from, by kind of scene: without faults, and attacks in which nobody lied
    adjusted: p-values by measure and cell, adjusted as one family, because a score is the greatest of many
    """

    def __init__(self, table: FieldTable) -> None:
        defences = {each.of["defence"] for each in table.summaries}  # without that of no defence
        shown = [row for row in table.rows if defences and row.of["scene"] and row["damage"].known]
        played = [row for row in shown if row["attacked"].known or not row.of["attack"]]
        self.rows = [row for row in played if not row.idle]
        values = {(name, row): row[name].p for row in self.rows for name in _READ_TOGETHER}
        tested = {key: p for key, p in values.items() if not math.isnan(p)}
        self.adjusted = dict(zip(tested, holm(list(tested.values())), strict=True))
        scores = []
        for name in dict.fromkeys(row.of["defence"] for row in self.rows):
            own = [row for row in self.rows if row.of["defence"] == name]
            if quiet := [row for row in own if not row.of["attack"]]:
                scores.append(DefenceScore(*(max(rows, key=_damage) for rows in (own, quiet))))
        self.scores = sorted(scores, key=lambda score: _damage(score.worst))
        self.defended = [score for score in self.scores if score.worst.of["defence"] in defences]

    def differs(self, name: str, row: Row) -> bool:
        """Whether a measure of a cell differs from 0 if all are read together."""
        return self.adjusted.get((name, row), 1.0) <= LEVEL

    def conclusions(self) -> list[str]:
        """Five computed sentences: the best defence, its rivals, what beats most, gain, cost; none without scores."""
        if not self.defended:
            return []
        worst, quiet = ([score[at] for score in self.defended] for at in (0, 1))
        rows = [score.worst for score in self.scores]
        return of_study("scoreboard", board=self, worst=worst, quiet=quiet, rows=rows)

    @property
    def beat_most(self) -> tuple[list[str], int]:
        """What is the worst case of most defences, and of how many."""
        counts = Counter(score.worst.of["attack"] or "their own cost" for score in self.defended)
        most = max(counts.values())
        return [name for name, count in counts.items() if count == most], most

    def named(self, name: str, rows: Iterable[Row], sign: int) -> str:
        """The defences of cells whose measure differs from 0, in one direction."""
        named = [row.of["defence"] for row in rows if self.differs(name, row) and sign * row[name].value > 0.0]
        return join_names(named) if named else "none"

    def text(self, name: str, row: Row) -> str:
        """A measure of a cell, with its mark."""
        return measured(row[name]) + "*" * self.differs(name, row)

    def table(self) -> TextTable:
        """The scores as text."""
        lines = [
            [
                *(
                    score.worst.of["defence"],
                    _case(score.worst),
                    *(self.text(name, score.worst) for name in _READ_TOGETHER),
                ),
                *(self.text("damage", score.quiet), str(score.worst["damage"].trials)),
            ]
            for score in self.scores
        ]
        about = paragraph(
            "scoreboard_about", tests=paragraph("scoreboard_tests", adjusted=self.adjusted, least=MIN_SEEDS)
        )
        return TextTable(SCOREBOARD, about, _SCOREBOARD_HEADINGS, lines, 2)


def _damage(row: Row) -> float:
    return row["damage"].value


def _case(row: Row) -> str:
    """`Ghost (2 of 4 poles, random)`."""
    return of_study("case", row=row)[0]


def scoreboard_tables(table: FieldTable) -> ResultTables:
    """The scoreboard as a page of its own; its CSV has all numbers that are read together."""
    board = Scoreboard(table)
    worst = [score.worst for score in board.scores]
    numbers = [
        [
            *(*(row.of[each] for each in _OF_SCORE), name, *bounds(row[name])),
            *(*digits(board.adjusted.get((name, row), math.nan)), int(row in worst)),
        ]
        for row in board.rows
        for name in _READ_TOGETHER
    ]
    sentences = board.conclusions()
    numbered = [f"{at}. {text}" for at, text in enumerate(sentences, 1)]
    about = "\n".join([f"{table.matrix.size}.", *([""] if numbered else []), *numbered])
    tables = [board.table()] if board.scores else []
    brief = [each._replace(about=" ".join([each.about, *sentences])) for each in tables]
    return ResultTables(
        SCOREBOARD, about, table.matrix.size, tables, (_SCOREBOARD_CSV, numbers), brief, reading=sentences
    )


# -- tables ------------------------------------------------------------------------------------------------------------

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
