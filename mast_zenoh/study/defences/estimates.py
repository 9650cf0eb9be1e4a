"""What each defence is worth against each adversary, from the trials of all cells. Pure."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mast_zenoh.arrays.states import Floats
from mast_zenoh.metrics.trust import auc, partial_auc, roc
from mast_zenoh.report.defence_rows import DefenceMatrix, DefenceRoc, DefenceRow, DelayCurve
from mast_zenoh.report.study_facts import plural
from mast_zenoh.study.defences.cells import UNDEFENDED, Cell
from mast_zenoh.study.defences.survival import kaplan_meier
from mast_zenoh.study.summary import trial_estimate

#: False alarms per hour below which the partial area under the characteristic is taken.
ALARMS_PER_HOUR = 1.0
_SCORES = ("fn", "fp", "ospa_m")
_SHARES = ("lies_detected", "honest_majority")


@dataclass(frozen=True, slots=True)
class TrialRecord:
    """What the matrix needs of one trial's metrics.

    scores:    fn, fp per frame and ospa_m of the ego's picture, false objects inserted and identifiable or not
    lies:      numbers of observable and detected lies
    delays:    (s, whether it was suspended) of each agent with an observable lie, from that lie on
    suspicion: (greatest score, whether it lied) of each agent
    confusion: s by conduct and state;  hours: of the run, 0 without trust;  alarms: suspensions of honest agents
    fault_alarms: suspensions of faulty agents that did not lie
    """

    scores: Mapping[str, float]
    lies: tuple[int, int]
    delays: Sequence[tuple[float, bool]]
    suspicion: Sequence[tuple[float, bool]]
    confusion: Mapping[str, Mapping[str, float]]
    hours: float
    alarms: int
    fault_alarms: int

    @classmethod
    def of(cls, metrics: Mapping[str, Any]) -> TrialRecord:
        """The record of a trial from its metrics.json with the part `defence`."""
        agents, part, trust = metrics["agents"], metrics["defence"], metrics.get("integrity", {})
        picture = agents["ego" if "ego" in agents else next(iter(agents))]["picture"]
        means = {name: picture[name]["mean"] for name in _SCORES}
        scores = {name: math.nan if mean is None else float(mean) for name, mean in means.items()}
        scores |= {f"fp_{name}": value for name, value in part["false"].items()}
        scores["honest_majority"] = part["honest_majority"]
        watched = [each for each in part["agents"].values() if each["observed_s"] is not None]
        judged = list(trust.get("agents", {}).values())
        return cls(
            scores,
            (part["lies"]["observable"], part["lies"]["detected"]),
            [(each["observed_s"], each["suspended_after_s"] is not None) for each in watched],
            [(_number(each["suspicion"]["max"]), each["lied"]) for each in judged],
            trust.get("seconds", {}),
            trust.get("hours", 0.0),
            trust.get("false_alarms", 0),
            sum(each["fault_alarms"] for each in judged),
        )


class Collection:
    """The records of all trials, by cell, scene and seed."""

    def __init__(self, cells: Mapping[str, Cell], scenes: Sequence[str], seeds: Sequence[int]) -> None:
        """cells: by label of configuration;  scenes, seeds: planned for every cell."""
        self._cells, self._scenes, self._seeds = dict(cells), list(scenes), list(seeds)
        self._records: dict[Cell, dict[tuple[int, int], TrialRecord]] = {cell: {} for cell in cells.values()}

    def add(self, label: str, scene: str, seed: int, metrics: Mapping[str, Any]) -> None:
        """Add a trial of the configuration `label`."""
        place = self._scenes.index(scene), self._seeds.index(seed)
        self._records[self._cells[label]][place] = TrialRecord.of(metrics)

    def matrix(self) -> DefenceMatrix:
        """The rows of all cells, each with the budget that does the most damage."""
        groups: dict[tuple[str, str, int, str], list[Cell]] = {}
        for cell in self._records:
            groups.setdefault((cell.defence, cell.attack, cell.n_adversaries, cell.placement), []).append(cell)
        rows = [self._row(max(cells, key=self._mean_damage), len(cells)) for cells in groups.values()]
        defences = dict.fromkeys(cell.defence for cell in self._records)
        delays = {defence: self._delay(self._of(defence)) for defence in defences if defence != UNDEFENDED}
        return DefenceMatrix(
            rows,
            [curve for defence in defences if (curve := self._roc(defence)) is not None],
            {defence: delay for defence, delay in delays.items() if delay is not None},
            f"{plural(len(self._seeds), 'seed')} \u00d7 {plural(len(self._scenes), 'scene')}",
        )

    def _values(self, cell: Cell, name: str) -> Floats:
        """(scenes, seeds) a score of each trial, NaN where it failed."""
        values = np.full((len(self._scenes), len(self._seeds)), np.nan)
        for place, record in self._records.get(cell, {}).items():
            values[place] = record.scores[name]
        return values

    def _mean_damage(self, cell: Cell) -> float:
        added = self._added(cell, "fn") + self._added(cell, "fp")
        known = added[~np.isnan(added)]
        return float(known.mean()) if known.size else -math.inf

    def _added(self, cell: Cell, name: str) -> Floats:
        """A score minus that without attack and without defence, of the same scene and seed."""
        return self._values(cell, name) - self._values(Cell(UNDEFENDED), name)

    def _row(self, cell: Cell, budgets: int) -> DefenceRow:
        undefended = Cell(UNDEFENDED, cell.attack, cell.n_adversaries, cell.placement, cell.budget)
        values = {f"{_stem(name)}_added{_unit(name)}": self._added(cell, name) for name in _SCORES}
        values["damage"] = values["fn_added"] + values["fp_added"]
        for name in _SCORES:
            difference = self._values(cell, name) - self._values(undefended, name)
            values[f"{_stem(name)}_vs_undefended{_unit(name)}"] = difference
        for name in ("fp_identifiable", "fp_unidentifiable", "honest_majority"):
            values[name] = self._values(cell, name)
        if cell.is_fault:  # nobody lies, so there is no bound
            values["honest_majority"] = np.full_like(values["damage"], np.nan)
        records = self._records[cell]
        for name in ("lies_detected", "honest_suspended_per_hour", "faulty_suspended_per_hour"):
            values[name] = np.full_like(values["damage"], np.nan)
        for place, record in records.items():
            observable, detected = record.lies
            if observable:
                values["lies_detected"][place] = detected / observable
            if record.hours:
                values["honest_suspended_per_hour"][place] = record.alarms / record.hours
                values["faulty_suspended_per_hour"][place] = record.fault_alarms / record.hours
        return DefenceRow(
            cell.defence,
            cell.attack,
            cell.n_adversaries,
            cell.placement,
            cell.budget,
            budgets,
            {name: trial_estimate(each, _bounds(name)) for name, each in values.items()},
            _added_up(record.confusion for record in records.values()),
            self._delay(records.values()),
        )

    def _of(self, defence: str) -> list[TrialRecord]:
        return [each for cell, records in self._records.items() if cell.defence == defence for each in records.values()]

    @staticmethod
    def _delay(records: Iterable[TrialRecord]) -> DelayCurve | None:
        delays = [each for record in records for each in record.delays]
        if not delays:
            return None
        curve = kaplan_meier(*zip(*delays, strict=True))
        return DelayCurve(curve.time_s, curve.undetected, curve.median_s, curve.detections, curve.watched)

    def _roc(self, defence: str) -> DefenceRoc | None:
        """The characteristic over all trials of a defence; None if nobody lied, or all scores are equal or unknown."""
        records = self._of(defence)
        pairs = [each for record in records for each in record.suspicion]
        hours = sum(record.hours for record in records)
        if not any(lied for _, lied in pairs) or len({score for score, _ in pairs if not math.isnan(score)}) < 2:
            return None
        scores, lied = [score for score, _ in pairs], [lied for _, lied in pairs]
        partial = partial_auc(scores, lied, hours, ALARMS_PER_HOUR)
        return DefenceRoc(defence, roc(scores, lied), auc(scores, lied), partial, hours)


def _added_up(parts: Iterable[Mapping[str, Mapping[str, float]]]) -> dict[str, dict[str, float]]:
    """The sums of nested numbers."""
    total: dict[str, dict[str, float]] = {}
    for part in parts:
        for conduct, states in part.items():
            sums = total.setdefault(conduct, dict.fromkeys(states, 0.0))
            for state, seconds in states.items():
                sums[state] += seconds
    return total


def _bounds(name: str) -> tuple[float, float]:
    if name in _SHARES:
        return 0.0, 1.0
    signed = name == "damage" or "_added" in name or "_vs_" in name
    return (-math.inf if signed else 0.0), math.inf


def _stem(name: str) -> str:
    return name.removesuffix("_m")


def _unit(name: str) -> str:
    return "_m" if name.endswith("_m") else ""


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)
