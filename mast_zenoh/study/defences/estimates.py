"""What each defence is worth against each adversary, from the trials of all cells. Pure."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from mast_zenoh.arrays.states import Floats
from mast_zenoh.report.defence_rows import DefenceMatrix, DefenceRow, DefenceSummary, Measured, TrustPanel
from mast_zenoh.report.study_facts import plural
from mast_zenoh.study.defences import intervals, pooled, traces
from mast_zenoh.study.defences.cells import UNDEFENDED, Cell
from mast_zenoh.study.defences.records import SCORES, TrialRecord

#: Panels of trust over time.
MAX_PANELS = 12

#: Index of a scene and of a seed.
Place = tuple[int, int]


class Collection:
    """The records of all trials, by cell, scene and seed."""

    def __init__(self, cells: Mapping[str, Cell], scenes: Sequence[str], seeds: Sequence[int]) -> None:
        """cells: by label of configuration;  scenes, seeds: planned for every cell."""
        self._cells, self._scenes, self._seeds = dict(cells), list(scenes), list(seeds)
        self._records: dict[Cell, dict[Place, TrialRecord]] = {cell: {} for cell in cells.values()}
        #: of the first trial of each cell that has a trace
        self._traces: dict[Cell, tuple[Place, Mapping[str, Any]]] = {}
        self._suspending: set[str] = set()

    def add(self, label: str, scene: str, seed: int, metrics: Mapping[str, Any]) -> None:
        """Add a trial of the configuration `label`."""
        place, cell = (self._scenes.index(scene), self._seeds.index(seed)), self._cells[label]
        self._records[cell][place] = TrialRecord.of(metrics)
        content = metrics["defence"].get("trust")
        if content is None:
            return
        if cell not in self._traces or place < self._traces[cell][0]:
            self._traces[cell] = place, content
        if traces.suspends(content):
            self._suspending.add(cell.defence)

    def matrix(self) -> DefenceMatrix:
        """The rows of all cells, each with the budget that does the most damage."""
        groups: dict[tuple[str, str, int, str], list[Cell]] = {}
        for cell in self._records:
            groups.setdefault((cell.defence, cell.attack, cell.n_adversaries, cell.placement), []).append(cell)
        worst = [(max(cells, key=self._mean_damage), len(cells)) for cells in groups.values()]
        shown = [cell for cell, _ in worst]
        every = list(dict.fromkeys(cell.defence for cell in shown))
        defences = [name for name in every if name != UNDEFENDED]
        trials = {name: self._by_place(cell for cell in self._records if cell.defence == name) for name in every}
        delays = {name: pooled.delay_curve(trials[name]) for name in defences}
        panels, unshown = self._panels(shown)
        return DefenceMatrix(
            [self._row(cell, budgets) for cell, budgets in worst],
            [curve for name in defences if (curve := pooled.characteristic(name, trials[name])) is not None],
            {name: delay for name, delay in delays.items() if delay is not None},
            [self._summary(name, [cell for cell in shown if cell.defence == name]) for name in defences],
            f"{plural(len(self._seeds), 'seed')} \u00d7 {plural(len(self._scenes), 'scene')}",
            {name: pooled.confusion(each) for name, each in trials.items()},
            panels,
            unshown,
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
        undefended = _undefended(cell)
        values = {f"{_stem(name)}_added{_unit(name)}": self._added(cell, name) for name in SCORES}
        values["damage"] = values["fn_added"] + values["fp_added"]
        for name in SCORES:
            difference = self._values(cell, name) - self._values(undefended, name)
            values[f"{_stem(name)}_vs_undefended{_unit(name)}"] = difference
        for name in ("fp_identifiable", "fp_unidentifiable"):
            values[name] = self._values(cell, name)
        measures = {name: intervals.mean(each) for name, each in values.items()}
        majority = self._values(cell, "honest_majority")
        # Where nobody lies because agents are faulty, there is no bound.
        measures["honest_majority"] = Measured() if cell.is_fault else intervals.mean(majority, (0.0, 1.0))
        measures["identifiable_removed"] = self._removed([cell])
        groups = self._by_place([cell])
        measures["lies_detected"] = pooled.lies_detected(groups)
        measures["median_delay_s"] = pooled.median_delay(groups)
        measures["honest_suspended_per_hour"] = pooled.alarms_per_hour(groups)
        measures["faulty_suspended_per_hour"] = pooled.alarms_per_hour(groups, faulty=True)
        measures |= pooled.shares_of_runs(groups, lies=cell.lies)
        return DefenceRow(
            cell.defence,
            cell.attack,
            cell.n_adversaries,
            cell.placement,
            cell.budget,
            budgets,
            measures,
            _added_up(record.confusion for record in self._records[cell].values()),
            pooled.delay_curve(groups),
        )

    def _summary(self, defence: str, cells: Sequence[Cell]) -> DefenceSummary:
        """cells: of the rows of this defence."""
        alone, attacked = Cell(defence), [cell for cell in cells if cell.lies]
        lying, faulty = self._by_place(attacked), self._by_place(cell for cell in cells if cell.is_fault)
        quiet = self._by_place([alone] if alone in self._records else [])
        return DefenceSummary(
            defence,
            pooled.lies_detected(lying),
            self._removed(attacked),
            pooled.median_delay(lying),
            pooled.alarms_per_hour(quiet),
            sum(record.frames for group in quiet for record in group if record.hours),
            intervals.mean(self._added(alone, "fn")),
            intervals.mean(self._added(alone, "fp")),
            pooled.shares_of_runs(faulty, lies=False)["wrongly_suspended"],
            pooled.shares_of_runs(lying, lies=True)["framed_by_minority"],
        )

    def _removed(self, cells: Sequence[Cell]) -> Measured:
        """Share of identifiable inserted objects of the undefended runs that are not in the defended ones.

        cells: added up by scene and seed; a cell without a defence has none to remove
        """
        attacked = [cell for cell in cells if cell.lies and cell.defence != UNDEFENDED]
        if not attacked:
            return Measured()
        pairs = np.array(
            [[self._values(each, "fp_identifiable") for each in (cell, _undefended(cell))] for cell in attacked]
        )
        pairs[np.isnan(pairs).any(axis=1)[:, None].repeat(2, axis=1)] = np.nan
        missing = np.isnan(pairs).all(axis=(0, 1))
        remaining, inserted = (np.where(missing, np.nan, np.nansum(pairs[:, index], axis=0)) for index in (0, 1))
        return intervals.one_minus(intervals.share(remaining, inserted))

    def _by_place(self, cells: Iterable[Cell]) -> list[list[TrialRecord]]:
        """The records of cells, grouped by scene and seed."""
        groups: dict[Place, list[TrialRecord]] = {}
        for cell in cells:
            for place, record in self._records[cell].items():
                groups.setdefault(place, []).append(record)
        return [groups[place] for place in sorted(groups)]

    def _panels(self, shown: Sequence[Cell]) -> tuple[list[TrustPanel], int]:
        """The first trial of each defence that suspends under each adversary, and the number of pairs without a panel.

        shown: the cells of the rows
        """
        first: dict[tuple[str, str], Cell] = {}
        for cell in shown:
            if cell.attack and cell.defence in self._suspending and cell in self._traces:
                first.setdefault((cell.attack, cell.defence), cell)
        attacks = list(dict.fromkeys(cell.attack for cell in shown))
        pairs = sorted(first, key=lambda pair: attacks.index(pair[0]))  # the defences of one adversary side by side
        panels = [traces.panel(self._traces[first[pair]][1], _title(first[pair])) for pair in pairs[:MAX_PANELS]]
        return panels, len(pairs) - len(panels)


def _undefended(cell: Cell) -> Cell:
    return Cell(UNDEFENDED, cell.attack, cell.n_adversaries, cell.placement, cell.budget)


def _title(cell: Cell) -> str:
    return f"{cell.defence} against {cell.attack} ({cell.n_adversaries}, {cell.placement})"


def _added_up(parts: Iterable[Mapping[str, Mapping[str, float]]]) -> dict[str, dict[str, float]]:
    """The sums of nested numbers."""
    total: dict[str, dict[str, float]] = {}
    for part in parts:
        for conduct, states in part.items():
            sums = total.setdefault(conduct, dict.fromkeys(states, 0.0))
            for state, seconds in states.items():
                sums[state] += seconds
    return total


def _stem(name: str) -> str:
    return name.removesuffix("_m")


def _unit(name: str) -> str:
    return "_m" if name.endswith("_m") else ""
