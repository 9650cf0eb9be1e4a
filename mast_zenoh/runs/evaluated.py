"""What the evaluator says about the frames of a run: outcomes and scores of objects, and what interposers changed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.states import Floats, Ints
from mast_zenoh.metrics.record import Series
from mast_zenoh.metrics.scores import OUTCOMES, UNEVALUATED
from mast_zenoh.runs.files import Table


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

    @classmethod
    def of(cls, counts: Table, row: int) -> Score:
        """From a row of metrics.parquet."""
        fn, fp, tp, rmse_m, id_switches = (float(counts[name][row]) for name in cls._fields)
        return cls(int(fn), int(fp), int(tp), rmse_m, int(id_switches))


class MeasuredEffects(NamedTuple):
    """n measured effects of interposers on messages about a frame.

    interposer, role, wire, effect: (n,) text, see docs/explanation-metrics-and-causes.md
    before, after: (n, 3) m, world frame; NaN where there was no object, or none after
    """

    interposer: NDArray[Any]
    role: NDArray[Any]
    wire: NDArray[Any]
    effect: NDArray[Any]
    before: Floats
    after: Floats

    @classmethod
    def of(cls, effects: Table) -> MeasuredEffects:
        """From rows of attacks.parquet."""
        before, after = (
            np.stack([effects[f"{when}_{axis}"] for axis in "xyz"], axis=1).astype(np.float64)
            for when in ("before", "after")
        )
        return cls(effects["interposer"], effects["role"], effects["wire"], effects["effect"], before, after)

    @classmethod
    def none(cls) -> MeasuredEffects:
        """No change."""
        text, places = np.zeros(0, str), np.zeros((0, 3))
        return cls(text, text, text, text, places, places)

    @property
    def added(self) -> Floats:
        """(k, 3) m, where they inserted an object."""
        added: Floats = self.after[self.effect == "inserted"]
        return added

    @property
    def removed(self) -> Floats:
        """(k, 3) m, where they took one away."""
        removed: Floats = self.before[self.effect == "removed"]
        return removed

    @property
    def moved(self) -> Floats:
        """(k, 2, 3) m, from where to where they moved one."""
        moved = self.effect == "moved"
        return np.stack([self.before[moved], self.after[moved]], axis=1)

    def joined(self, other: MeasuredEffects) -> MeasuredEffects:
        """These changes and others."""
        return MeasuredEffects(*(np.concatenate(columns) for columns in zip(self, other, strict=True)))

    @property
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


class Evaluated:
    """Tables of the evaluator, grouped by frame.

    objects, counts, effects: objects.parquet, metrics.parquet, attacks.parquet; None: absent
    same_as: by agent, the estimate with the same messages of others
    """

    def __init__(
        self,
        objects: Table | None,
        counts: Table | None,
        effects: Table | None,
        same_as: Mapping[str, Mapping[str, str]],
    ) -> None:
        self._objects, self._same_as = objects, same_as
        outcomes = [] if objects is None else objects["outcome"].tolist()
        self._codes = np.array([OUTCOMES.index(name) for name in outcomes], np.int64)
        self._boxes = _grouped(objects, ("frame", "agent", "estimator", "kind"))
        self._counts, self._scores = counts, _grouped(counts, ("frame", "agent", "estimator"))
        self._effects, self._changes = effects, _grouped(effects, ("frame",))

    @property
    def series(self) -> list[Series]:
        """Agents and estimates with scores."""
        return list(dict.fromkeys(Series(agent, estimator) for _, agent, estimator in self._scores))

    def outcomes(self, frame: int, series: Series, kind: str, ids: Ints) -> Outcomes:
        """The outcomes of objects with ids (n,), in a frame, for an agent's estimate.

        kind: "track" for the objects of the estimate itself, "truth" for those of the scene
        """
        code, match = np.full(len(ids), UNEVALUATED, np.int64), np.full(len(ids), -1, np.int64)
        estimator = self._same_as.get(series.agent, {}).get(series.estimator, series.estimator)
        found = self._boxes.get((frame, series.agent, estimator, kind))
        if found is not None and self._objects is not None and len(ids):
            known = self._objects["id"][found]
            order = np.argsort(known, kind="stable")
            place = order[np.searchsorted(known, ids, sorter=order).clip(max=len(found) - 1)]
            judged = known[place] == ids
            code[judged] = self._codes[found[place[judged]]]
            match[judged] = self._objects["match_id"][found[place[judged]]]
        return Outcomes(code, match)

    def score(self, frame: int, series: Series) -> Score | None:
        """The score of an agent's estimate in a frame; None: not scored."""
        found = self._scores.get((frame, *series))
        return None if found is None or self._counts is None else Score.of(self._counts, int(found[0]))

    def changes(self, frame: int) -> MeasuredEffects:
        """The changes of a frame."""
        if self._effects is None:
            return MeasuredEffects.none()
        found = self._changes.get((frame,), np.zeros(0, np.int64))
        return MeasuredEffects.of({name: values[found] for name, values in self._effects.items()})


def _grouped(table: Table | None, names: Sequence[str]) -> dict[tuple[Any, ...], Ints]:
    """Ascending rows (k,) for each combination of values of some columns."""
    if table is None or not len(table[names[0]]):
        return {}
    values, codes = zip(*(np.unique(table[name], return_inverse=True) for name in names), strict=True)
    order = np.lexsort(codes[::-1])
    changes = np.any([np.diff(code[order]) != 0 for code in codes], axis=0).nonzero()[0] + 1
    groups = np.split(order, changes)
    keys = (tuple(v[code[found[0]]].item() for v, code in zip(values, codes, strict=True)) for found in groups)
    return dict(zip(keys, groups, strict=True))
