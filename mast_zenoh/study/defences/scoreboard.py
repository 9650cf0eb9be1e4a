"""The scoreboard of a matrix: each defence with the case that is worst for it, best first, and what follows from it."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from mast_zenoh.metrics.significance import holm
from mast_zenoh.metrics.study_results import LEVEL, MIN_SEEDS, Row, Statistic, plural
from mast_zenoh.report.findings.words import names as join_names
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

    def row(self, scene: str, defence: str, attack: str, n_adversaries: int, placement: str) -> Row:
        """The row of a cell; raises KeyError if there is none."""
        key = (scene, defence, attack, n_adversaries, placement)
        for row in self.rows:
            if tuple(row.of.values()) == key:
                return row
        raise KeyError(key)


class DefenceScore(NamedTuple):
    """A defence: its cells with the greatest damage, of all and of those without an attack."""

    worst: Row
    quiet: Row

    @property
    def defence(self) -> str:
        """The name of the defence."""
        return str(self.worst.of["defence"])

    @property
    def damage(self) -> Statistic:
        """Of the worst case."""
        return self.worst["damage"]

    @property
    def cost(self) -> Statistic:
        """What the defence adds without an attack."""
        return self.quiet["damage"]


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
        self.scores = sorted(self._scores(), key=lambda score: score.damage.value)
        self.defended = [score for score in self.scores if score.defence in defences]

    def _scores(self) -> Iterator[DefenceScore]:
        for name in dict.fromkeys(row.of["defence"] for row in self.rows):
            own = [row for row in self.rows if row.of["defence"] == name]
            if quiet := [row for row in own if not row.of["attack"]]:
                yield DefenceScore(*(max(rows, key=lambda row: row["damage"].value) for rows in (own, quiet)))

    def differs(self, name: str, row: Row) -> bool:
        """Whether a measure of a cell differs from 0 if all are read together."""
        return self.adjusted.get((name, row), 1.0) <= LEVEL

    def conclusions(self) -> list[str]:
        """Five computed sentences: the best defence, its rivals, what beats most, gain, cost; none without scores."""
        if not self.defended:
            return []
        best, costly = self.scores[0], max(self.defended, key=lambda score: score.cost.value)
        name = best.defence if best in self.defended else "no defence at all"
        quiet, worst = [score.quiet for score in self.defended], [score.worst for score in self.defended]
        return [
            f"The best worst case of {plural(len(self.defended), 'defence')} has {name}: with {_case(best.worst)}, "
            f"{self._text('damage', best.worst)} errors a frame are added, compared with no attack and no defence"
            f"{self._share_of_attack(best.worst)}.",
            self._rivals(best),
            self._beaten(),
            f"In its worst case, better than no defence: {self._named('harm', worst, -1)}; "
            f"worse: {self._named('harm', worst, 1)}; for all others, that is open.",
            f"Without an attack, clearly more errors than without a defence: {self._named('damage', quiet, 1)}; "
            f"fewer: {self._named('damage', quiet, -1)}; "
            f"the {'greatest cost' if costly.cost.value >= 0.0 else 'smallest gain'} is that of "
            f"{costly.defence}: {self._text('damage', costly.quiet)} a frame.",
        ]

    def _share_of_attack(self, row: Row) -> str:
        """What the attack adds, as a defence also removes errors of the sensors; empty without an attack."""
        return f", of which the attack adds {self._text('by_attack', row)}" if row.of["attack"] else ""

    def _rivals(self, best: DefenceScore) -> str:
        high = best.damage.high
        if math.isnan(high):
            return "That number has no interval, so the order of the rows is open."
        others = [each.defence for each in self.scores if each is not best and not each.damage.low > high]
        if others:
            return f"Not told apart from it, as intervals overlap or are missing: {join_names(others)}."
        return "No other row's interval overlaps with its own."

    def _beaten(self) -> str:
        counts = Counter(score.worst.of["attack"] or "their own cost" for score in self.defended)
        names = [name for name, count in counts.items() if count == max(counts.values())]
        share = f"{max(counts.values())} of {len(self.defended)}{' each' if len(names) > 1 else ''}"
        bare = [each.worst for each in self.scores if each not in self.defended]
        undefended = (f"; without a defence, {_case(row)} adds {self._text('by_attack', row)}" for row in bare)
        return f"What beats defences most is {join_names(names)} ({share}){''.join(undefended)}."

    def _named(self, name: str, rows: Iterable[Row], sign: int) -> str:
        """The defences of cells whose measure differs from 0, in one direction."""
        named = [row.of["defence"] for row in rows if self.differs(name, row) and sign * row[name].value > 0.0]
        return join_names(named) if named else "none"

    def _text(self, name: str, row: Row) -> str:
        return measured(row[name]) + "*" * self.differs(name, row)

    def table(self) -> TextTable:
        """The scores as text."""
        lines = [
            [
                *(score.defence, _case(score.worst), *(self._text(name, score.worst) for name in _READ)),
                *(self._text("damage", score.quiet), str(score.damage.trials)),
            ]
            for score in self.scores
        ]
        about = (
            "Errors are missed and false objects per frame in the ego's picture. Of each defence the case with the "
            "most errors added, of all attacks and kinds of scene, compared with no attack and no defence. Negative: "
            "the defence takes more of the sensors' own errors away than the attack adds. Then the same case compared "
            f"with the same defence without the attack, and with no defence under it. {self._about_tests()} As the "
            "greatest of many is chosen, errors added are a little too many."
        )
        return TextTable(TITLE, about, _HEADINGS, lines, 2)

    def _about_tests(self) -> str:
        if not self.adjusted:
            return f"No number can be tested: there are fewer than {MIN_SEEDS} seeds, or most differences are equal."
        return (
            "* differs from 0 after Holm's procedure, over the "
            f"{plural(len(self.adjusted), 'number')} of all cases that have a test."
        )


def _case(row: Row) -> str:
    """`Ghost (2 of 4 poles, random)`."""
    text = "{attack} ({n_adversaries} of {scene}, {placement})" if row.of["attack"] else "no attack ({scene})"
    return text.format_map(row.of)


def scoreboard_tables(table: FieldTable) -> ResultTables:
    """The scoreboard as a page of its own; its CSV has all numbers that are read together."""
    board = Scoreboard(table)
    worst = [score.worst for score in board.scores]
    numbers = []
    for row in board.rows:
        for name in _READ:
            cell = [row.of[each] for each in _NAMES]
            adjusted = digits(board.adjusted.get((name, row), math.nan))
            numbers.append([*cell, name, *bounds(row[name]), *adjusted, int(row in worst)])
    sentences = board.conclusions()
    numbered = [f"{at}. {text}" for at, text in enumerate(sentences, 1)]
    about = "\n".join([f"{table.matrix.size}.", *([""] if numbered else []), *numbered])
    tables = [board.table()] if board.scores else []
    brief = [each._replace(about=" ".join([each.about, *sentences])) for each in tables]
    return ResultTables(TITLE, about, table.matrix.size, tables, (_CSV, numbers), brief, reading=sentences)
