"""The scoreboard of a matrix: each defence with the case that is worst for it, best first, and what follows from it."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from mast_zenoh.metrics.significance import holm
from mast_zenoh.metrics.study_results import LEVEL, MIN_SEEDS, Row
from mast_zenoh.report.findings.words import names as join_names
from mast_zenoh.report.findings.words import of_study, paragraph
from mast_zenoh.report.tables.text_table import BOUNDS, ResultTables, TextTable, bounds, digits, measured
from mast_zenoh.study.defences.matrix_tables import MatrixTable
from mast_zenoh.study.defences.published import Published, PublishedNumber

TITLE = "Scoreboard"
_HEADINGS = (
    *("defence", "beaten most by", "errors added", "by the attack", "minus undefended"),
    *("without an attack", "seeds"),
)
_NAMES = ("defence", "attack", "n_adversaries", "placement", "scene")
_CSV = (*_NAMES, "measure", *BOUNDS, "p_holm", "worst")
#: What is read together of every cell.
_READ = ("damage", "by_attack", "harm")


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
        values = {(name, row): row[name].p for row in self.rows for name in _READ}
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
                *(score.worst.of["defence"], _case(score.worst), *(self.text(name, score.worst) for name in _READ)),
                *(self.text("damage", score.quiet), str(score.worst["damage"].trials)),
            ]
            for score in self.scores
        ]
        about = paragraph(
            "scoreboard_about", tests=paragraph("scoreboard_tests", adjusted=self.adjusted, least=MIN_SEEDS)
        )
        return TextTable(TITLE, about, _HEADINGS, lines, 2)


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
            *(*(row.of[each] for each in _NAMES), name, *bounds(row[name])),
            *(*digits(board.adjusted.get((name, row), math.nan)), int(row in worst)),
        ]
        for row in board.rows
        for name in _READ
    ]
    sentences = board.conclusions()
    numbered = [f"{at}. {text}" for at, text in enumerate(sentences, 1)]
    about = "\n".join([f"{table.matrix.size}.", *([""] if numbered else []), *numbered])
    tables = [board.table()] if board.scores else []
    brief = [each._replace(about=" ".join([each.about, *sentences])) for each in tables]
    return ResultTables(TITLE, about, table.matrix.size, tables, (_CSV, numbers), brief, reading=sentences)
