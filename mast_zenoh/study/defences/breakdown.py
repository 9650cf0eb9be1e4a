"""Where a defence breaks, from the trials of all numbers of agents and liars. Pure."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mast_zenoh.metrics import Table
from mast_zenoh.report.limit_rows import BreakdownPoint, BreakdownRow, BreakdownTable
from mast_zenoh.streams import stream
from mast_zenoh.study.defences.crossing import crossing
from mast_zenoh.study.defences.intervals import bootstrap, share
from mast_zenoh.study.defences.limits import BreakdownCell

#: Scene and seed of a trial.
Place = tuple[str, int]


@dataclass(frozen=True, slots=True)
class BreakdownRecord:
    """What the tables need of one trial.

    worse:  whether the picture has more missed and false objects than the ego alone, in all frames from the start of
            the attack on
    framed: whether an honest agent is suspended before any compromised one
    honest_majority: share of the objects that more honest agents see than compromised ones
    """

    worse: bool
    framed: bool
    honest_majority: float

    @property
    def broken(self) -> bool:
        """Whether the defence did more harm than good, or punished the wrong agent."""
        return self.worse or self.framed

    @classmethod
    def of(cls, cell: BreakdownCell, metrics: Mapping[str, Any], per_frame: Table) -> BreakdownRecord:
        """The record of a trial from its metrics.json with the part `defence`, and its metrics.parquet."""
        part = metrics["defence"]
        suspended = {
            name: [each["from_s"] for each in agent["suspensions"]]
            for name, agent in metrics.get("integrity", {}).get("agents", {}).items()
        }
        compromised = set(part["compromised"])
        honest_s = min((s for name, times in suspended.items() if name not in compromised for s in times), default=None)
        liar_s = min((s for name in compromised for s in suspended.get(name, ())), default=math.inf)
        first, last = metrics.get("scored_frames") or (0, -1)
        start = int(np.searchsorted(part["frames_s"], cell.attack_start_s - 1e-6))
        frames = range(max(first, start), last + 1)
        ego = "ego" if "ego" in metrics["agents"] else next(iter(metrics["agents"]))
        return cls(
            _errors(per_frame, ego, "picture", frames) > _errors(per_frame, ego, "local", frames),
            honest_s is not None and honest_s < liar_s,
            float(part["honest_majority"]),
        )


class BreakdownCollection:
    """The records of all trials by cell, scene and seed."""

    def __init__(self, cells: Mapping[str, BreakdownCell], size: str) -> None:
        """cells: by label of configuration;  size: seeds and scenes, for tables."""
        self._cells, self._size = dict(cells), size
        self._records: dict[BreakdownCell, dict[Place, BreakdownRecord]] = {cell: {} for cell in cells.values()}

    def add(self, label: str, place: Place, metrics: Mapping[str, Any], per_frame: Table) -> None:
        """Add a trial of the configuration `label`."""
        cell = self._cells[label]
        self._records[cell][place] = BreakdownRecord.of(cell, metrics, per_frame)

    def table(self) -> BreakdownTable:
        """A row for each cell, and a breakdown point for each attack and number of agents."""
        attacks = dict.fromkeys(cell.attack for cell in self._records if cell.attack)
        rows, points = [], {}
        for attack in attacks:
            for agents in dict.fromkeys(cell.agents for cell in self._records):
                cells = [c for c in self._records if c.agents == agents and c.attack in ("", attack)]
                cells.sort(key=lambda cell: cell.liars)
                rows += [_row(attack, cell, list(self._records[cell].values())) for cell in cells]
                if any(self._records[cell] for cell in cells):
                    points[attack, agents] = _point(attack, agents, {c.liars: self._records[c] for c in cells})
        return BreakdownTable(rows, points, self._size)


def _row(attack: str, cell: BreakdownCell, records: Sequence[BreakdownRecord]) -> BreakdownRow:
    names = ("broken", "worse", "framed")
    broken, worse, framed = (share(sum(getattr(each, name) for each in records), len(records)) for name in names)
    majority = [record.honest_majority for record in records]
    bound = float(np.mean(majority)) if majority else math.nan
    return BreakdownRow(attack, cell.agents, cell.liars, len(records), broken, worse, framed, bound)


def _point(attack: str, agents: int, by_liars: Mapping[int, Mapping[Place, BreakdownRecord]]) -> BreakdownPoint:
    """The breakdown point of one attack; units are scenes with seeds, which all numbers of liars share."""
    places = list(dict.fromkeys(place for records in by_liars.values() for place in records))
    liars = [count for count, records in by_liars.items() if records]

    def broken(chosen: Sequence[Place]) -> float:
        return _crossing(agents, by_liars, liars, chosen, lambda record: float(record.broken))

    def bound(chosen: Sequence[Place]) -> float:
        return _crossing(agents, by_liars, liars, chosen, lambda record: 1.0 - record.honest_majority)

    def difference(chosen: Sequence[Place]) -> float:
        of_bound = bound(chosen)
        return math.nan if math.isinf(of_bound) else broken(chosen) - of_bound

    # The same draws for all three.
    of_broken, of_bound, of_difference = (
        bootstrap(places, each, stream(0, "bootstrap", attack, agents)) for each in (broken, bound, difference)
    )
    return BreakdownPoint(attack, agents, of_broken, of_bound, of_difference, max(liars) / agents)


def _crossing(
    agents: int,
    by_liars: Mapping[int, Mapping[Place, BreakdownRecord]],
    liars: Sequence[int],
    chosen: Sequence[Place],
    value: Any,
) -> float:
    """The share of liars at which the mean of a value over trials reaches one half."""
    points = []
    for count in liars:
        values = [value(by_liars[count][place]) for place in chosen if place in by_liars[count]]
        if values:
            points.append((count / agents, float(np.mean(values)), float(len(values))))
    if not points:
        return math.nan
    shares, means, trials = zip(*points, strict=True)
    return crossing(shares, means, trials)


def _errors(per_frame: Table, agent: str, estimator: str, frames: range) -> float:
    """Missed and false objects of an estimate in some frames."""
    rows = (per_frame["agent"] == agent) & (per_frame["estimator"] == estimator)
    rows &= (per_frame["frame"] >= frames.start) & (per_frame["frame"] < frames.stop)
    return float(per_frame["fn"][rows].sum() + per_frame["fp"][rows].sum())
