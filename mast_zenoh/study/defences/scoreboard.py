"""The scoreboard of a matrix: each defence with the case that is worst for it, best first."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable
from typing import NamedTuple

from mast_zenoh.metrics.significance import holm
from mast_zenoh.metrics.study_results import LEVEL, MIN_SEEDS, Row
from mast_zenoh.run_folder import finding
from mast_zenoh.show.findings.words import of_study, paragraph
from mast_zenoh.show.tables.text_table import BOUNDS, ResultTables, TextTable, bounds, digits, measured
from mast_zenoh.study.defences.matrix_table import MatrixTable

SCOREBOARD = "Scoreboard"
_SCOREBOARD_HEADINGS = (
    *("defence", "beaten most by", "errors added", "by the attack", "minus undefended"),
    *("without an attack", "seeds"),
)
_OF_SCORE = ("defence", "attack", "n_adversaries", "placement", "scene")
_SCOREBOARD_CSV = (*_OF_SCORE, "measure", *BOUNDS, "p_holm", "worst")
#: What is read together of every cell.
_READ_TOGETHER = ("damage", "by_attack", "harm")


class DefenceScore(NamedTuple):
    """A defence: its cells with the greatest damage, of all (`worst`) and of those without an attack (`quiet`)."""

    worst: Row
    quiet: Row


class Scoreboard:
    """The scores of a matrix, the smallest worst case first; none without a defence, or without an adversary.

    rows:     the cells that scores are chosen from, by kind of scene: without faults, and attacks in which nobody lied
    adjusted: p-values by measure and cell, adjusted as one family, because a score is the greatest of many
    """

    def __init__(self, table: MatrixTable) -> None:
        defences = {row.of["defence"] for row in table.summaries if "harm_removed" in row.numbers}  # those attacked
        shown = [row for row in table.by_scene if defences and row.of["scene"] and row["damage"].known]
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
        return finding.names(named) if named else "none"

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


def scoreboard_tables(table: MatrixTable) -> ResultTables:
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
    about = "\n".join([f"{table.size}.", *([""] if numbered else []), *numbered])
    tables = [board.table()] if board.scores else []
    brief = [each._replace(about=" ".join([each.about, *sentences])) for each in tables]
    return ResultTables(SCOREBOARD, about, table.size, tables, (_SCOREBOARD_CSV, numbers), brief, reading=sentences)
