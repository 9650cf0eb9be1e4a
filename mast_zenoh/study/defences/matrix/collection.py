"""What each defence is worth against each adversary, from the trials of all cells."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from mast_zenoh.arrays.states import Floats
from mast_zenoh.metrics.study_results import DefenceMatrix, DefenceRow, DefenceSummary, Measured, TrustPanel, size_of
from mast_zenoh.report.tables.defences import defence_tables
from mast_zenoh.study.defences import intervals
from mast_zenoh.study.defences.matrix import pooled, traces
from mast_zenoh.study.defences.matrix.cells import UNDEFENDED, Cell
from mast_zenoh.study.defences.matrix.records import SCORES, TrialRecord
from mast_zenoh.study.defences.study_files import StudyFiles, write_files
from mast_zenoh.study.trial import Outcome, TrialKey

#: Panels of trust over time.
MAX_PANELS = 12


class MatrixCollection:
    """The records of all trials, by cell, scene and seed."""

    def __init__(self, cells: Mapping[str, Cell], scenes: Sequence[str], seeds: Sequence[int]) -> None:
        """cells: by label of configuration;  scenes, seeds: planned for every cell."""
        self._cells, self._size = dict(cells), size_of(len(seeds), len(scenes))
        #: the trials planned for every cell, with their place in the order of the study
        self._order = {TrialKey(scene, seed): index for index, (scene, seed) in enumerate(product(scenes, seeds))}
        self._records: dict[Cell, dict[TrialKey, TrialRecord]] = {cell: {} for cell in cells.values()}
        #: of the first trial of each cell that has a trace
        self._traces: dict[Cell, tuple[TrialKey, Mapping[str, Any]]] = {}
        self._suspending: set[str] = set()

    def add(self, outcome: Outcome) -> None:
        """Add a finished trial."""
        key, cell = outcome.trial.key, self._cells[outcome.trial.configuration]
        self._records[cell][key] = TrialRecord.of(outcome.metrics)
        content = outcome.metrics["defence"].get("trust")
        if content is None:
            return
        if cell not in self._traces or self._order[key] < self._order[self._traces[cell][0]]:
            self._traces[cell] = key, content
        if traces.suspends(content):
            self._suspending.add(cell.defence)

    def write(self, folder: Path) -> StudyFiles:
        """Write the tables and figures into the study's folder."""
        from mast_zenoh.report.figures.defences import figures_of_defences  # drawing libraries are slow to load

        matrix = self.matrix()
        tables = defence_tables(matrix)
        return write_files(folder, tables.texts("defences"), figures_of_defences(matrix), tables.as_rich)

    def matrix(self) -> DefenceMatrix:
        """The rows of all cells, each with the budget that does the most damage."""
        groups: dict[tuple[str, str, int, str], list[Cell]] = {}
        for cell in self._records:
            groups.setdefault((cell.defence, cell.attack, cell.n_adversaries, cell.placement), []).append(cell)
        worst = [(max(cells, key=self._mean_damage), len(cells)) for cells in groups.values()]
        worst_cells = [cell for cell, _ in worst]
        every = list(dict.fromkeys(cell.defence for cell in worst_cells))
        defences = [name for name in every if name != UNDEFENDED]
        trials = {name: self._by_trial(cell for cell in self._records if cell.defence == name) for name in every}
        delays = {name: pooled.delay_curve(trials[name]) for name in defences}
        panels, unshown = self._panels(worst_cells)
        return DefenceMatrix(
            rows=[self._row(cell, budgets) for cell, budgets in worst],
            rocs=[curve for name in defences if (curve := pooled.characteristic(name, trials[name])) is not None],
            delays={name: delay for name, delay in delays.items() if delay is not None},
            summaries=[
                self._summary(name, [each for each in worst_cells if each.defence == name]) for name in defences
            ],
            size=self._size,
            state_shares={name: pooled.state_shares(each) for name, each in trials.items()},
            panels=panels,
            unshown=unshown,
        )

    def _values(self, cell: Cell, name: str) -> Floats:
        """(trials,) a score of each planned trial in the order of the study, NaN where it failed."""
        values = np.full(len(self._order), np.nan)
        for key, record in self._records.get(cell, {}).items():
            values[self._order[key]] = record.scores[name]
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
        groups = self._by_trial([cell])
        measures["lies_detected"] = pooled.lies_detected(groups)
        measures["median_delay_s"] = pooled.median_delay(groups)
        measures["honest_suspended_per_hour"] = pooled.alarms_per_hour(groups)
        measures["faulty_suspended_per_hour"] = pooled.alarms_per_hour(groups, faulty=True)
        measures |= pooled.shares_of_runs(groups, lies=cell.lies)
        return DefenceRow(
            defence=cell.defence,
            attack=cell.attack,
            n_adversaries=cell.n_adversaries,
            placement=cell.placement,
            budget=cell.budget,
            budgets=budgets,
            measures=measures,
            state_seconds=_sum_seconds(record.state_seconds for record in self._records[cell].values()),
            delay=pooled.delay_curve(groups),
        )

    def _summary(self, defence: str, cells: Sequence[Cell]) -> DefenceSummary:
        """cells: of the rows of this defence."""
        alone, attacked = Cell(defence), [cell for cell in cells if cell.lies]
        lying, faulty = self._by_trial(attacked), self._by_trial(cell for cell in cells if cell.is_fault)
        quiet = self._by_trial([alone] if alone in self._records else [])
        return DefenceSummary(
            defence=defence,
            lies_detected=pooled.lies_detected(lying),
            identifiable_removed=self._removed(attacked),
            median_delay_s=pooled.median_delay(lying),
            alarms_per_hour=pooled.alarms_per_hour(quiet),
            frames=sum(record.frames for group in quiet for record in group if record.hours),
            fn_added=intervals.mean(self._added(alone, "fn")),
            fp_added=intervals.mean(self._added(alone, "fp")),
            faults_suspended=pooled.shares_of_runs(faulty, lies=False)["wrongly_suspended"],
            framed_by_minority=pooled.shares_of_runs(lying, lies=True)["framed_by_minority"],
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

    def _by_trial(self, cells: Iterable[Cell]) -> list[list[TrialRecord]]:
        """The records of cells, grouped by scene and seed."""
        groups: dict[TrialKey, list[TrialRecord]] = {}
        for cell in cells:
            for key, record in self._records[cell].items():
                groups.setdefault(key, []).append(record)
        return [groups[key] for key in sorted(groups, key=self._order.__getitem__)]

    def _panels(self, cells: Sequence[Cell]) -> tuple[list[TrustPanel], int]:
        """The first trial of each defence that suspends under each adversary, and the number of pairs without a panel.

        cells: of the rows
        """
        first: dict[tuple[str, str], Cell] = {}
        for cell in cells:
            if cell.attack and cell.defence in self._suspending and cell in self._traces:
                first.setdefault((cell.attack, cell.defence), cell)
        attacks = list(dict.fromkeys(cell.attack for cell in cells))
        pairs = sorted(first, key=lambda pair: attacks.index(pair[0]))  # the defences of one adversary side by side
        panels = [traces.panel(self._traces[first[pair]][1], _title(first[pair])) for pair in pairs[:MAX_PANELS]]
        return panels, len(pairs) - len(panels)


def _undefended(cell: Cell) -> Cell:
    return Cell(UNDEFENDED, cell.attack, cell.n_adversaries, cell.placement, cell.budget)


def _title(cell: Cell) -> str:
    return f"{cell.defence} against {cell.attack} ({cell.n_adversaries}, {cell.placement})"


def _sum_seconds(parts: Iterable[Mapping[str, Mapping[str, float]]]) -> dict[str, dict[str, float]]:
    """The sums of s by conduct and state."""
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
