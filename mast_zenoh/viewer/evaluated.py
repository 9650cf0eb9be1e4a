"""Tables of the evaluator, by frame: outcomes of objects, scores, changes by interposers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.states import Floats, Ints
from mast_zenoh.metrics.record import Series
from mast_zenoh.metrics.scores import OUTCOMES, UNEVALUATED

#: A table: one array per column, all of one length.
Table = Mapping[str, NDArray[Any]]


class Outcomes(NamedTuple):
    """How the evaluator judged n objects.

    code: (n,) index into metrics.scores.OUTCOMES; "unevaluated" also if it did not judge them, such as out of range
    match_id: (n,) id of the object that each was matched with, -1: none
    """

    code: Ints
    match_id: Ints

    @property
    def names(self) -> list[str]:
        """The outcome of each object as a word."""
        return [OUTCOMES[code] for code in self.code.tolist()]


class Score(NamedTuple):
    """Counts of objects of one estimate of an agent in a frame; rmse_m: m, NaN without a pair."""

    fn: int
    fp: int
    tp: int
    rmse_m: float
    id_switches: int


class Changes(NamedTuple):
    """n measured effects of interposers on messages about a frame.

    interposer, role, wire, effect: (n,) text, see docs/effects.md
    before, after: (n, 3) m, world frame; NaN where there was no object, or none after
    """

    interposer: NDArray[Any]
    role: NDArray[Any]
    wire: NDArray[Any]
    effect: NDArray[Any]
    before: Floats
    after: Floats

    def sentences(self) -> list[str]:
        """One line of text for each change."""
        lines = []
        for k in range(len(self.effect)):
            places = [
                f"{word} ({', '.join(f'{value:.1f}' for value in place[k])})"
                for word, place in (("from", self.before), ("to", self.after))
                if np.isfinite(place[k]).all()
            ]
            lines.append(" ".join([f"{self.interposer[k]} on {self.wire[k]}: {self.effect[k]}", *places]))
        return lines


class Judgements:
    """Outcomes of objects by frame and series.

    table: objects.parquet;  same_as: by agent, the estimate with the same messages of others

    Raises KeyError or ValueError for other tables.
    """

    def __init__(self, table: Table, same_as: Mapping[str, Mapping[str, str]]) -> None:
        self._table, self._same_as = table, same_as
        self._codes = np.array([OUTCOMES.index(str(name)) for name in table["outcome"]], np.int64)
        self._rows = _grouped(table, ("frame", "agent", "estimator", "kind"))

    @classmethod
    def none(cls) -> Judgements:
        """Of a run that was not evaluated."""
        return cls(dict.fromkeys(("frame", "agent", "estimator", "kind", "outcome", "id", "match_id"), _NOTHING), {})

    def of(self, frame: int, series: Series, kind: str, ids: Ints) -> Outcomes:
        """The outcomes of objects with ids (n,), in a frame, for an agent's estimate.

        kind: "track" for the objects of the estimate itself, "truth" for those of the scene
        """
        code, match = np.full(len(ids), UNEVALUATED, np.int64), np.full(len(ids), -1, np.int64)
        estimator = self._same_as.get(series.agent, {}).get(series.estimator, series.estimator)
        rows = self._rows.get((frame, series.agent, estimator, kind))
        if rows is not None and len(ids):
            known = self._table["id"][rows]
            order = np.argsort(known, kind="stable")
            place = order[np.searchsorted(known, ids, sorter=order).clip(max=len(rows) - 1)]
            judged = known[place] == ids
            code[judged] = self._codes[rows[place[judged]]]
            match[judged] = self._table["match_id"][rows[place[judged]]]
        return Outcomes(code, match)


class ScoreTable:
    """Scores by frame. table: metrics.parquet; raises KeyError or ValueError for other tables"""

    def __init__(self, table: Table) -> None:
        self._columns = [table[name].astype(np.float64) for name in Score._fields]
        if any(
            np.isnan(column).any()
            for name, column in zip(Score._fields, self._columns, strict=True)
            if name != "rmse_m"
        ):
            raise ValueError("found missing counts, expected a number in every row")
        self._rows = _grouped(table, ("frame", "agent", "estimator"))
        self.series = list(dict.fromkeys(Series(agent, estimator) for _, agent, estimator in self._rows))

    @classmethod
    def none(cls) -> ScoreTable:
        """Of a run that was not evaluated."""
        return cls(dict.fromkeys(("frame", "agent", "estimator", *Score._fields), _NOTHING))

    def of(self, frame: int, series: Series) -> Score | None:
        """The score of an agent's estimate in a frame; None: not scored."""
        rows = self._rows.get((frame, *series))
        if rows is None:
            return None
        fn, fp, tp, rmse_m, id_switches = (column[rows[0]] for column in self._columns)
        return Score(int(fn), int(fp), int(tp), float(rmse_m), int(id_switches))


class ChangeTable:
    """Changes by frame. table: attacks.parquet; raises KeyError for other tables"""

    def __init__(self, table: Table) -> None:
        self._rows = _grouped(table, ("frame",))
        vectors = [np.stack([table[f"{when}_{axis}"] for axis in "xyz"], axis=1) for when in ("before", "after")]
        columns = [table[name] for name in ("interposer", "role", "wire", "effect")]
        self._changes = Changes(*columns, *(vector.astype(np.float64) for vector in vectors))

    @classmethod
    def none(cls) -> ChangeTable:
        """Of a run that was not evaluated."""
        places = [f"{when}_{axis}" for when in ("before", "after") for axis in "xyz"]
        return cls(dict.fromkeys(("frame", "interposer", "role", "wire", "effect", *places), _NOTHING))

    def of(self, frame: int) -> Changes:
        """The changes of a frame."""
        rows = self._rows.get((frame,), np.zeros(0, np.int64))
        values: list[Any] = [column[rows] for column in self._changes]
        return Changes(*values)


_NOTHING = np.zeros(0)


def _grouped(table: Table, names: Sequence[str]) -> dict[tuple[Any, ...], Ints]:
    """Ascending rows (k,) for each combination of values of some columns."""
    if not len(table[names[0]]):
        return {}
    values, codes = zip(*(np.unique(table[name], return_inverse=True) for name in names), strict=True)
    order = np.lexsort(codes[::-1])
    changes = np.any([np.diff(code[order]) != 0 for code in codes], axis=0).nonzero()[0] + 1
    groups = np.split(order, changes)
    keys = (tuple(v[code[rows[0]]].item() for v, code in zip(values, codes, strict=True)) for rows in groups)
    return dict(zip(keys, groups, strict=True))
