"""Where a defence breaks, from the trials of all numbers of agents and liars. Pure."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mast_zenoh.metrics import Table
from mast_zenoh.report.defence_rows import Measured
from mast_zenoh.report.limit_rows import BreakdownPoint, BreakdownRow, BreakdownTable
from mast_zenoh.study.defences.crossing import crossing
from mast_zenoh.study.defences.intervals import pooled, share_of_trials
from mast_zenoh.study.defences.limits import BreakdownCell

_ROUNDING_S = 1e-6

#: Scene and seed of a trial.
Place = tuple[str, int]


@dataclass(frozen=True, slots=True)
class BreakdownRecord:
    """What the tables need of one trial.

    worse:    whether the picture has more missed and false objects than the ego alone, in all frames from the start
              of the attack on
    honest_s: s of the first suspension of each honest agent that was suspended
    liar_s:   s of the first suspension of a compromised agent; infinite: none
    honest:   number of honest agents
    honest_majority: share of the objects that more honest agents see than compromised ones
    """

    worse: bool
    honest_s: Mapping[str, float]
    liar_s: float
    honest: int
    honest_majority: float

    def framed(self, alone: BreakdownRecord | None) -> bool:
        """Whether an honest agent is suspended before any compromised one.

        alone: the same scene and seed without liars. An agent that is suspended there by the same time is a false
        alarm that no liar caused, and does not count; None: unknown, so all count
        """
        false_alarms = {} if alone is None else alone.honest_s
        return any(
            time_s < self.liar_s and false_alarms.get(name, math.inf) > time_s + _ROUNDING_S
            for name, time_s in self.honest_s.items()
        )

    @property
    def suspended(self) -> float:
        """Share of the honest agents that are suspended at any time, whatever the reason."""
        return len(self.honest_s) / self.honest

    @classmethod
    def of(cls, cell: BreakdownCell, metrics: Mapping[str, Any], per_frame: Table) -> BreakdownRecord:
        """The record of a trial from its metrics.json with the part `defence`, and its metrics.parquet."""
        part = metrics["defence"]
        agents = metrics.get("integrity", {}).get("agents", {})
        suspended = {
            name: min(each["from_s"] for each in agent["suspensions"])
            for name, agent in agents.items()
            if agent["suspensions"]
        }
        compromised = set(part["compromised"])
        first, last = metrics.get("scored_frames") or (0, -1)
        start = int(np.searchsorted(part["frames_s"], cell.attack_start_s - 1e-6))
        frames = range(max(first, start), last + 1)
        ego = "ego" if "ego" in metrics["agents"] else next(iter(metrics["agents"]))
        return cls(
            _errors(per_frame, ego, "picture", frames) > _errors(per_frame, ego, "local", frames),
            {name: time_s for name, time_s in suspended.items() if name not in compromised},
            min((suspended[name] for name in compromised & suspended.keys()), default=math.inf),
            cell.agents - len(compromised),
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
                alone = next((self._records[cell] for cell in cells if not cell.liars), {})
                trials = {cell.liars: _trials(self._records[cell], alone) for cell in cells}
                rows += [_row(attack, agents, liars, list(each.values())) for liars, each in trials.items()]
                if any(trials.values()):
                    points[attack, agents] = _point(attack, agents, trials)
        return BreakdownTable(rows, points, self._size)


@dataclass(frozen=True, slots=True)
class _Trial:
    """A trial next to the one without liars of the same scene and seed."""

    worse: bool
    framed: bool
    suspended: float
    honest_majority: float

    @property
    def broken(self) -> bool:
        """Whether the defence did more harm than good, or punished the wrong agent."""
        return self.worse or self.framed


def _trials(records: Mapping[Place, BreakdownRecord], alone: Mapping[Place, BreakdownRecord]) -> dict[Place, _Trial]:
    return {
        place: _Trial(each.worse, each.framed(alone.get(place)), each.suspended, each.honest_majority)
        for place, each in records.items()
    }


def _row(attack: str, agents: int, liars: int, trials: Sequence[_Trial]) -> BreakdownRow:
    broken, worse, framed = (
        share_of_trials(sum(getattr(each, name) for each in trials), len(trials))
        for name in ("broken", "worse", "framed")
    )
    suspended, majority = (_mean([getattr(each, name) for each in trials]) for name in ("suspended", "honest_majority"))
    return BreakdownRow(attack, agents, liars, len(trials), broken, worse, framed, suspended, majority)


def _point(attack: str, agents: int, by_liars: Mapping[int, Mapping[Place, _Trial]]) -> BreakdownPoint:
    """The breakdown point of one attack; units are scenes with seeds, which all numbers of liars share."""
    places = list(dict.fromkeys(place for trials in by_liars.values() for place in trials))
    shares = {liars / agents: trials for liars, trials in by_liars.items() if trials}

    def broken(chosen: Sequence[Place]) -> float:
        return _crossing(shares, chosen, lambda trial: float(trial.broken))

    def bound(chosen: Sequence[Place]) -> float:
        return _crossing(shares, chosen, lambda trial: 1.0 - trial.honest_majority)

    def difference(chosen: Sequence[Place]) -> float:
        of_bound = bound(chosen)
        return math.nan if math.isinf(of_bound) else broken(chosen) - of_bound

    def measured(statistic: Callable[[Sequence[Place]], float]) -> Measured:
        return pooled(lambda rows: statistic([places[row] for row in rows.tolist()]), len(places))  # the same draws

    of_broken, of_bound, of_difference = map(measured, (broken, bound, difference))
    return BreakdownPoint(attack, agents, of_broken, of_bound, of_difference, max(shares))


def _crossing(
    shares: Mapping[float, Mapping[Place, _Trial]], chosen: Sequence[Place], value: Callable[[_Trial], float]
) -> float:
    """The share of liars at which the mean of a value over the chosen trials reaches one half."""
    points = []
    for of_liars, trials in shares.items():
        values = [value(trials[place]) for place in chosen if place in trials]
        if values:
            points.append((of_liars, _mean(values)))
    return crossing([x for x, _ in points], [mean for _, mean in points]) if points else math.nan


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values)) if values else math.nan


def _errors(per_frame: Table, agent: str, estimator: str, frames: range) -> float:
    """Missed and false objects of an estimate in some frames."""
    rows = (per_frame["agent"] == agent) & (per_frame["estimator"] == estimator)
    rows &= (per_frame["frame"] >= frames.start) & (per_frame["frame"] < frames.stop)
    return float(per_frame["fn"][rows].sum() + per_frame["fp"][rows].sum())
