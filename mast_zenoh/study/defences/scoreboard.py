"""The scoreboard of a matrix: each defence with the case that is worst for it, best first.

What papers report of the methods that our stages and attacks follow, next to our numbers, and why these differ.

published.toml is the only place of the texts about papers. A figure is one that was found in an abstract or in others'
notes (then it says so, and was not checked), in the authors' code, or in the paper. Ours are computed from the trials
of a study (`field_matrix`).
"""

from __future__ import annotations

import math
import tomllib
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import msgspec

from mast_zenoh.metrics.study_results import LEVEL, MIN_SEEDS, NAN, Row, Statistic, holm
from mast_zenoh.run_folder import finding
from mast_zenoh.show.findings.words import of_study, paragraph
from mast_zenoh.show.number_text import DASH, measured, median_delay
from mast_zenoh.show.tables.text_table import ResultTables, TextTable, numbers_of_rows, shown, table_of_rows
from mast_zenoh.study.defences.matrix_table import MatrixTable, Published

SCOREBOARD = "Scoreboard"
#: What is read together of every cell, and its headings.
_READ_TOGETHER = {"damage": "errors added", "by_attack": "by the attack", "harm": "minus undefended"}


class DefenceScore(NamedTuple):
    """A defence: its cells with the greatest damage, of all (`worst`) and of those without an attack (`quiet`)."""

    worst: Row
    quiet: Row


class Scoreboard:
    """The scores of a matrix, the smallest worst case first; none without a defence, or without an adversary.

    rows:  the cells that scores are chosen from, by kind of scene: without faults, and attacks in which nobody lied.
           Their p-values are adjusted as one family, because a score is the greatest of many
    tests: their number
    """

    def __init__(self, table: MatrixTable) -> None:
        defences = {row.of["defence"] for row in table.summaries if "harm_removed" in row.numbers}  # those attacked
        shown = [row for row in table.by_scene if defences and row.of["scene"] and row["damage"].known]
        played = [row for row in shown if row["attacked"].known or not row.of["attack"]]
        tested = [
            (row, name) for row in played if not row.idle for name in _READ_TOGETHER if not math.isnan(row[name].p)
        ]
        adjusted = dict(zip(tested, holm([row[name].p for row, name in tested]), strict=True))
        self.tests = len(tested)
        self.rows = [
            replace(
                row, numbers={name: row[name]._replace(p=adjusted.get((row, name), NAN)) for name in _READ_TOGETHER}
            )
            for row in played
            if not row.idle
        ]
        scores = []
        for name in dict.fromkeys(row.of["defence"] for row in self.rows):
            own = [row for row in self.rows if row.of["defence"] == name]
            if quiet := [row for row in own if not row.of["attack"]]:
                scores.append(DefenceScore(*(max(rows, key=_damage) for rows in (own, quiet))))
        self.scores = sorted(scores, key=lambda score: _damage(score.worst))
        self.defended = [score for score in self.scores if score.worst.of["defence"] in defences]

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
        named = [row.of["defence"] for row in rows if row[name].p <= LEVEL and sign * row[name].value > 0.0]
        return finding.names(named) if named else "none"

    def text(self, name: str, row: Row) -> str:
        """A measure of a cell, with its mark."""
        return _marked(row[name])

    def table(self) -> TextTable:
        """The scores as text."""
        quiet = {score.worst: score.quiet for score in self.scores}
        columns = {"beaten most by": _case} | {each: shown(name, _marked) for name, each in _READ_TOGETHER.items()}
        columns["without an attack"] = lambda row: _marked(quiet[row]["damage"])
        columns["seeds"] = lambda row: str(row["damage"].trials)
        tests = paragraph("scoreboard_tests", adjusted=range(self.tests), least=MIN_SEEDS)
        about = paragraph("scoreboard_about", tests=tests)
        return table_of_rows(SCOREBOARD, about, [*quiet], columns, {"defence": "defence"}, texts=2)


def _marked(each: Statistic) -> str:
    return measured(each) + "*" * (each.p <= LEVEL)


def _damage(row: Row) -> float:
    return row["damage"].value


def _case(row: Row) -> str:
    """`Ghost (2 of 4 poles, random)`."""
    return of_study("case", row=row)[0]


def scoreboard_tables(table: MatrixTable) -> ResultTables:
    """The scoreboard as a page of its own; its CSV has all numbers that are read together."""
    board = Scoreboard(table)
    worst = [score.worst for score in board.scores]
    numbers = numbers_of_rows([replace(row, of=row.of | {"worst": int(row in worst)}) for row in board.rows])
    sentences = board.conclusions()
    numbered = [f"{at}. {text}" for at, text in enumerate(sentences, 1)]
    about = "\n".join([f"{table.size}.", *([""] if numbered else []), *numbered])
    tables = [board.table()] if board.scores else []
    brief = [each._replace(about=" ".join([each.about, *sentences])) for each in tables]
    return ResultTables(SCOREBOARD, about, table.size, tables, numbers, brief, reading=sentences)


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

#: Attacks that move what is reported, so that there is nothing to withhold: only a suspension detects them.
BY_SUSPENSION = frozenset({"PosePert"})
#: Stages, then attacks.
PUBLISHED = msgspec.convert(
    tomllib.loads(Path(__file__).with_name("published.toml").read_text("utf-8"))["method"], tuple[Published, ...]
)

_PUBLISHED_TITLE = "The paper's figure, ours on tracks, why different"
_PUBLISHED_HEADINGS = (
    *("stage or attack", "after", "the paper's figure", "known from", "ours on tracks", "why different"),
)
#: Widths of columns in LaTeX, shares of the line.
_PUBLISHED_WIDTHS = (0.1, 0.13, 0.14, 0.1, 0.2, 0.2)
_NO_FIGURE = "none known to us"
#: Attacks that a cell names; more are counted, as the text above the table names them.
_MOST_NAMED = 4


def published_tables(table: MatrixTable) -> ResultTables:
    """The published figures of what was played, each with our numbers and why they differ."""
    if not table.published:
        about = "This study played no method of which a published figure is known, so there is nothing to compare."
        return ResultTables(_PUBLISHED_TITLE, about, table.size, [], numbers_of_rows([]), [])
    attacks = ", ".join(table.names("attack"))
    about = paragraph("field_published", size=table.size, attacks=attacks)
    lines = [
        [each.method, each.source, each.figure or _NO_FIGURE, each.basis, _ours(numbers), each.why]
        for each, numbers in table.published
    ]
    latex = "".join(rf"p{{{width:g}\linewidth}}" for width in _PUBLISHED_WIDTHS)
    page = TextTable("Published figures", "", _PUBLISHED_HEADINGS, lines, len(_PUBLISHED_HEADINGS), latex)
    rows = [replace(row, of=_of_paper(each) | row.of) for each, of_method in table.published for row in of_method]
    return ResultTables(_PUBLISHED_TITLE, about, table.size, [page], numbers_of_rows(rows), [])


def _of_paper(each: Published) -> dict[str, str]:
    return dict(
        method=each.method, source=each.source, figure=each.figure, known_from=each.basis, why_different=each.why
    )


def _ours(rows: Sequence[Row]) -> str:
    """`lies detected (share): Cad 0.50 [0.30, 0.70], under Flood; …`, by quantity and attacks."""
    texts: dict[tuple[str, str], list[str]] = {}
    for row in rows:
        attacks = row.of["attack"]
        count = len(attacks.split(", "))
        under = f", under {attacks if count <= _MOST_NAMED else f'all {count} attacks'}" if attacks else ""
        for quantity, value in row.numbers.items():
            text = median_delay(value) if quantity == "median_delay_s" else measured(value, 3)
            texts.setdefault((QUANTITIES[quantity], under), []).append(f"{row.of['defence']} {text}")
    return "; ".join(f"{name}: {', '.join(values)}{under}" for (name, under), values in texts.items()) or DASH
