"""With how many liars a defence breaks, next to the share at which honest viewers lose their majority."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from mast_zenoh.config.resolved import RECORDING
from mast_zenoh.metrics import Table
from mast_zenoh.metrics.study_results import BreakdownPoint, BreakdownRow, BreakdownTable, Measured
from mast_zenoh.scenes.recording import Recording
from mast_zenoh.study.defences import kinds
from mast_zenoh.study.defences.cells import BreakdownCell
from mast_zenoh.study.defences.choices import honest_majority
from mast_zenoh.study.defences.intervals import pooled, share_of_trials
from mast_zenoh.study.numbers import ego, scored_frames
from mast_zenoh.study.trial import Outcome, TrialKey

if TYPE_CHECKING:
    from mast_zenoh.report.figures.drawing import RenderedFigure
    from mast_zenoh.report.tables.text_table import ResultTables
    from mast_zenoh.runs.run import Run

#: Half of the trials, and half of the objects.
HALF = 0.5
_ROUNDING, _ROUNDING_S = 1e-12, 1e-6


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

    def honest_first(self, without_liars: BreakdownRecord | None) -> bool:
        """Whether an honest agent is suspended before any compromised one.

        without_liars: the same scene and seed. An agent that is suspended there by the same time is a false
        alarm that no liar caused, and does not count; None: unknown, so all count
        """
        false_alarms = {} if without_liars is None else without_liars.honest_s
        return any(
            time_s < self.liar_s and false_alarms.get(name, math.inf) > time_s + _ROUNDING_S
            for name, time_s in self.honest_s.items()
        )

    @property
    def honest_suspended(self) -> float:
        """Share of the honest agents that are suspended at any time, whatever the reason."""
        return len(self.honest_s) / self.honest

    @classmethod
    def of(cls, cell: BreakdownCell, outcome: Outcome) -> BreakdownRecord:
        """The record of a trial with the part `defence` of its metrics."""
        metrics, per_frame = outcome.metrics, outcome.per_frame
        part = metrics["defence"]
        agents = metrics.get("integrity", {}).get("agents", {})
        suspended = {
            name: min(each["from_s"] for each in agent["suspensions"])
            for name, agent in agents.items()
            if agent["suspensions"]
        }
        compromised = set(part["compromised"])
        first, last = scored_frames(metrics)
        start = int(np.searchsorted(part["frames_s"], cell.attack_start_s - 1e-6))
        frames = range(max(first, start), last + 1)
        agent = ego(metrics)
        return cls(
            worse=_errors(per_frame, agent, "picture", frames) > _errors(per_frame, agent, "local", frames),
            honest_s={name: time_s for name, time_s in suspended.items() if name not in compromised},
            liar_s=min((suspended[name] for name in compromised & suspended.keys()), default=math.inf),
            honest=cell.agents - len(compromised),
            honest_majority=float(part["honest_majority"]),
        )


class Collection(kinds.Collection):
    """Broken trials and breakdown points."""

    name = "breakdown"

    @staticmethod
    def evaluate(run: Run, compromised: Sequence[str]) -> dict[str, Any]:
        """The part `defence` of a trial's metrics.

        honest_majority: share of the objects that more honest agents see than compromised ones; 1.0 without adversaries
        compromised: names of the agents with an adversary
        frames_s: s of scene time of each frame
        """
        recording = Recording.load(run.path / RECORDING)
        times_s = (recording.times_ns - recording.times_ns[0]) * 1e-9
        return {
            "honest_majority": honest_majority(
                recording.points, [name in compromised for name in recording.agent_names]
            ),
            "compromised": sorted(compromised),
            "frames_s": np.round(times_s, 9).tolist(),
        }

    def record(self, cell: BreakdownCell, outcome: Outcome) -> BreakdownRecord:
        return BreakdownRecord.of(cell, outcome)

    def tables(self, table: BreakdownTable) -> ResultTables:
        from mast_zenoh.report.tables.limits import breakdown_tables

        return breakdown_tables(table)

    def figures(self, table: BreakdownTable) -> Mapping[str, RenderedFigure]:
        from mast_zenoh.report.figures.defences import figure_of_breakdown

        figure = figure_of_breakdown(table)
        return {figure.name: figure}

    def table(self) -> BreakdownTable:
        """A row for each cell, and a breakdown point for each attack and number of agents."""
        rows, points = [], {}
        for attack in dict.fromkeys(cell.attack for cell in self.records if cell.attack):
            for agents in dict.fromkeys(cell.agents for cell in self.records):
                cells = [c for c in self.records if c.agents == agents and c.attack in ("", attack)]
                cells.sort(key=lambda cell: cell.liars)
                without_liars = next((self.records[cell] for cell in cells if not cell.liars), {})
                trials = {
                    cell.liars: {
                        key: _Trial(record, record.honest_first(without_liars.get(key)))
                        for key, record in self.records[cell].items()
                    }
                    for cell in cells
                }
                rows += [_row(attack, agents, liars, list(each.values())) for liars, each in trials.items()]
                if any(trials.values()):
                    points[attack, agents] = _point(attack, agents, trials)
        return BreakdownTable(rows, points, self.size)


@dataclass(frozen=True, slots=True)
class _Trial:
    """A trial next to the one without liars of the same scene and seed."""

    record: BreakdownRecord
    honest_first: bool

    @property
    def broken(self) -> bool:
        """Whether the defence did more harm than good, or punished the wrong agent."""
        return self.record.worse or self.honest_first


def _row(attack: str, agents: int, liars: int, trials: Sequence[_Trial]) -> BreakdownRow:
    def share(happened: Iterable[bool]) -> Measured:
        return share_of_trials(sum(happened), len(trials))

    return BreakdownRow(
        attack=attack,
        agents=agents,
        liars=liars,
        trials=len(trials),
        broken=share(each.broken for each in trials),
        worse=share(each.record.worse for each in trials),
        honest_first=share(each.honest_first for each in trials),
        honest_suspended=_mean([each.record.honest_suspended for each in trials]),
        honest_majority=_mean([each.record.honest_majority for each in trials]),
    )


def _point(attack: str, agents: int, by_liars: Mapping[int, Mapping[TrialKey, _Trial]]) -> BreakdownPoint:
    """The breakdown point of one attack; units are scenes with seeds, which all numbers of liars share."""
    keys = list(dict.fromkeys(key for trials in by_liars.values() for key in trials))
    shares = {liars / agents: trials for liars, trials in by_liars.items() if trials}

    def broken(chosen: Sequence[TrialKey]) -> float:
        return _crossing(shares, chosen, lambda trial: float(trial.broken))

    def bound(chosen: Sequence[TrialKey]) -> float:
        return _crossing(shares, chosen, lambda trial: 1.0 - trial.record.honest_majority)

    def difference(chosen: Sequence[TrialKey]) -> float:
        of_bound = bound(chosen)
        return math.nan if math.isinf(of_bound) else broken(chosen) - of_bound

    def measured(statistic: Callable[[Sequence[TrialKey]], float]) -> Measured:
        return pooled(lambda rows: statistic([keys[row] for row in rows.tolist()]), len(keys))  # the same draws

    of_broken, of_bound, of_difference = map(measured, (broken, bound, difference))
    return BreakdownPoint(
        attack=attack, agents=agents, point=of_broken, bound=of_bound, difference=of_difference, most=max(shares)
    )


def _crossing(
    shares: Mapping[float, Mapping[TrialKey, _Trial]], chosen: Sequence[TrialKey], value: Callable[[_Trial], float]
) -> float:
    """The share of liars at which the mean of a value over the chosen trials reaches one half."""
    points = []
    for of_liars, trials in shares.items():
        values = [value(trials[key]) for key in chosen if key in trials]
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


def crossing(x: ArrayLike, y: ArrayLike) -> float:
    """The smallest x at which y reaches one half, by linear interpolation; infinite if it never does.

    x: (n,) ascending;  y: (n,)

    A breakdown point is the smallest share that breaks a defence, so a later fall of y changes nothing. With few trials
    a chance peak makes it smaller, which is the safe side. If y is one half or more from the first x on, that is the
    answer. Raises ValueError for no points.
    """
    at, share = np.asarray(x, np.float64), np.asarray(y, np.float64)
    if not len(at):
        raise ValueError("x: found no points, expected one or more")
    reached = share >= HALF - _ROUNDING
    if not reached.any():
        return math.inf
    after = int(reached.argmax())
    if after == 0:
        return float(at[0])
    before = after - 1
    fraction = min(1.0, (HALF - share[before]) / (share[after] - share[before]))
    return float(at[before] + fraction * (at[after] - at[before]))
