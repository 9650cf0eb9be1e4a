"""What attacks do to a car that is driven, and what defences spare it.

Every trial under attack is paired with its twin, the same scene, seed and defence without the attack. Every trial with
a defence is paired with the same scene, seed and attack without one. A twin shares all random draws, so a difference is
due to the attack, or to the defence, and to what follows from it.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from mast_zenoh.arrays.states import Bools, Floats
from mast_zenoh.metrics.driving_results import (
    DRIVING_MEASURES,
    Affected,
    DrivingRow,
    DrivingTable,
    Flaws,
)
from mast_zenoh.metrics.estimates import MISSION
from mast_zenoh.metrics.study_results import NEGLIGIBLE, Estimate
from mast_zenoh.report.tables.driving_study import driving_tables
from mast_zenoh.report.tables.text_table import ResultTables
from mast_zenoh.study import statistics
from mast_zenoh.study.defences import kinds
from mast_zenoh.study.defences.cells import DrivingCell
from mast_zenoh.study.defences.intervals import share_of_trials
from mast_zenoh.study.defences.matrix_records import own_metrics
from mast_zenoh.study.trial import Outcome, TrialKey

if TYPE_CHECKING:
    from mast_zenoh.report.figures.drawing import RenderedFigure
    from mast_zenoh.runs.run import Run

#: Effects that change no message.
_UNCHANGED = frozenset({"unsettled"})


@dataclass(frozen=True, slots=True)
class Happened:
    """What happened to a car in one trial.

    values: by DRIVING_MEASURES, and the user's metrics of what the car's agent acts on
    obeyed: commands that the car obeyed;  uncommanded: frames without a new command
    blind:  frames that were driven without an estimate;  idle: adversaries that changed no message
    """

    values: Mapping[str, float]
    obeyed: int
    uncommanded: int
    blind: int
    idle: tuple[str, ...]

    def __getitem__(self, name: str) -> float:
        return self.values.get(name, math.nan)


class Collection(kinds.Collection):
    """Consequences by attack and defence."""

    name = "driving"
    drawn = ("driving",)
    from_metrics = True

    @staticmethod
    def evaluate(run: Run, compromised: Sequence[str]) -> dict[str, Any]:
        """Nothing: `driven` of metrics.json has it all."""
        return {}

    def record(self, cell: DrivingCell, outcome: Outcome) -> Happened:
        driven = outcome.metrics["driven"][cell.car]
        values = {name: driven[name] for name in DRIVING_MEASURES}
        counted = {name: float(len(value) if isinstance(value, list) else value) for name, value in values.items()}
        return Happened(
            counted | own_metrics(outcome.metrics.get("agents", {}).get(cell.car, {}).get(MISSION, {})),
            driven["obeyed_commands"],
            driven["uncommanded_frames"],
            driven["blind_frames"],
            tuple(
                name
                for name, interposer in outcome.metrics["interposers"].items()
                if interposer["role"] == "adversary" and not set(interposer["effects"]) - _UNCHANGED
            ),
        )

    def table(self) -> DrivingTable:
        """A row for each attack and defence."""
        return DrivingTable([self._row(cell) for cell in self.records], self.size)

    def _row(self, cell: DrivingCell) -> DrivingRow:
        twin, undefended = replace(cell, attack="", wire=""), replace(cell, defence="")
        records, compared = self.records[cell], [*[twin] * bool(cell.attack), *[undefended] * bool(cell.defence)]
        added = self._differences(cell, twin) if cell.attack else {}
        spared = self._differences(cell, undefended) if cell.defence else {}
        own = [name for record in records.values() for name in record.values if name not in DRIVING_MEASURES]
        harm = [-DRIVING_MEASURES[name].better * values > NEGLIGIBLE for name, values in added.items()]
        changes = [np.abs(values) > NEGLIGIBLE for values in spared.values()]
        return DrivingRow(
            attack=cell.attack,
            wire=cell.wire,
            defence=cell.defence,
            trials=len(records),
            missing=len(self.order) - len(records),
            measures={name: _estimate(self._units(cell, name), 0.0) for name in DRIVING_MEASURES},
            added={name: _estimate(values, paired=True) for name, values in added.items()},
            spared={name: _estimate(values, paired=True) for name, values in spared.items()},
            harmed=_affected(harm, added),
            changed=_affected(changes, spared),
            own={
                name: (
                    _estimate(self._units(cell, name)),
                    _estimate(self._units(cell, name) - self._units(twin, name), paired=True)
                    if cell.attack
                    else Estimate(),
                )
                for name in dict.fromkeys(own)
            },
            flaws=_flaws(records),
            flawed=any(_flaws(self.records.get(each, {})) for each in (cell, *compared)),
        )

    def _differences(self, cell: DrivingCell, other: DrivingCell) -> dict[str, Floats]:
        return {name: self._units(cell, name) - self._units(other, name) for name in DRIVING_MEASURES}

    def _units(self, cell: DrivingCell, name: str) -> Floats:
        """(scenes, seeds) a number of each planned trial, NaN where there is none.

        Of fewer than five seeds but not scenes, scenes are the units of intervals: then it is (seeds, scenes).
        """
        values = self.values(cell, name).reshape(self.scenes, -1)
        return values.T if values.shape[1] < statistics.MIN_CLUSTERS <= self.scenes else values

    def tables(self, table: DrivingTable) -> ResultTables:
        return driving_tables(table)

    def figures(self, table: DrivingTable) -> Mapping[str, RenderedFigure]:
        from mast_zenoh.report.figures.driving_study import figure_of_driving  # drawing libraries are slow to load

        return {self.name: figure_of_driving(table)}


def _estimate(values: Floats, least: float = -math.inf, *, paired: bool = False) -> Estimate:
    return statistics.trial_estimate(values, (least, math.inf), paired=paired)


def _affected(happened: Sequence[Bools], differences: Mapping[str, Floats]) -> Affected:
    """In how many pairs anything happened. happened: (a, units) of each measure; differences: NaN without a pair"""
    if not happened:
        return Affected()
    any_measure = np.any(happened, axis=0)
    known = ~np.isnan(next(iter(differences.values())))
    chance = share_of_trials(int(any_measure.any(axis=0).sum()), int(known.any(axis=0).sum()))
    return Affected(int(any_measure.sum()), int(known.sum()), chance)


def _flaws(records: Mapping[TrialKey, Happened]) -> Flaws:
    trials = records.values()
    return Flaws(
        no_command=sum(not trial.obeyed for trial in trials),
        uncommanded=sum(bool(trial.obeyed and trial.uncommanded) for trial in trials),
        no_estimate=sum(trial.blind > 0 for trial in trials),
        idle=Counter(name for trial in trials for name in trial.idle),
    )
