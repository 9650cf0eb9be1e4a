"""What attacks do to a car that is driven, and what defences spare it.

Every trial under attack is paired with its twin, the same scene, seed and defence without the attack. Every trial with
a defence is paired with the same scene, seed and attack without one. A twin shares all random draws, so a difference is
due to the attack, or to the defence, and to what follows from it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mast_zenoh.metrics.driving_results import DRIVING_MEASURES, DrivingRow, DrivingTable
from mast_zenoh.metrics.study_results import Measured
from mast_zenoh.study.defences import kinds
from mast_zenoh.study.defences.intervals import mean
from mast_zenoh.study.trial import Outcome, TrialKey

if TYPE_CHECKING:
    from mast_zenoh.report.figures.drawing import RenderedFigure
    from mast_zenoh.report.tables.text_table import ResultTables

#: What happened to a car in one trial, by DRIVING_MEASURES.
Happened = Mapping[str, float]


@dataclass(frozen=True, slots=True)
class DrivingCell(kinds.DefenceCell):
    """One attack and one defence.

    attack: its name; "": none;  wire: where it is;  defence: its name; "": none
    car:    whose consequences count
    """

    kind = "driving_matrix"

    attack: str
    wire: str
    defence: str
    car: str = "ego"

    @property
    def label(self) -> str:
        """The label of its configuration."""
        return f"{f'{self.attack} on {self.wire}' if self.attack else 'no attack'}, {self.defence or 'no defence'}"


class Collection(kinds.Collection):
    """Consequences by attack and defence."""

    name = "driving"
    drawn = ("driving",)
    from_metrics = True

    @staticmethod
    def evaluate(folder: Path, metrics: Mapping[str, Any], compromised: Sequence[str]) -> dict[str, Any]:
        """Nothing: `driven` of metrics.json has it all."""
        return {}

    def record(self, cell: DrivingCell, outcome: Outcome) -> Happened:
        driven = outcome.metrics["driven"][cell.car]
        values = {name: driven[name] for name in DRIVING_MEASURES}
        return {name: float(len(value) if isinstance(value, list) else value) for name, value in values.items()}

    def table(self) -> DrivingTable:
        """A row for each attack and defence."""
        return DrivingTable([self._row(cell) for cell in self.records], self.size)

    def _row(self, cell: DrivingCell) -> DrivingRow:
        records = self._of(cell.attack, cell.wire, cell.defence)
        twins, undefended = self._of("", "", cell.defence), self._of(cell.attack, cell.wire, "")
        return DrivingRow(
            attack=cell.attack,
            wire=cell.wire,
            defence=cell.defence,
            trials=len(records),
            missing=len(self.order) - len(records),
            measures={name: mean([each[name] for each in records.values()]) for name in DRIVING_MEASURES},
            added=_differences(records, twins) if cell.attack else {},
            spared=_differences(records, undefended) if cell.defence else {},
        )

    def _of(self, attack: str, wire: str, defence: str) -> Mapping[TrialKey, Happened]:
        """The trials of a cell that are done, in the order of the study."""
        for cell, records in self.records.items():
            if (cell.attack, cell.wire, cell.defence) == (attack, wire, defence):
                return {key: records[key] for key in self.order if key in records}
        return {}

    def tables(self, table: DrivingTable) -> ResultTables:
        from mast_zenoh.report.tables.driving_study import driving_tables

        return driving_tables(table)

    def figures(self, table: DrivingTable) -> Mapping[str, RenderedFigure]:
        from mast_zenoh.report.figures.driving_study import figure_of_driving

        figure = figure_of_driving(table)
        return {figure.name: figure}


def _differences(records: Mapping[TrialKey, Happened], reference: Mapping[TrialKey, Happened]) -> dict[str, Measured]:
    """Each measure minus that of the trial with the same scene and seed, mean over the pairs that are done."""
    pairs = [(records[key], reference[key]) for key in records if key in reference]
    return {name: mean([each[name] - other[name] for each, other in pairs]) for name in DRIVING_MEASURES}
