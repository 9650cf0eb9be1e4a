"""The results of the study of driving: what attacks do to a driven car, and what defences spare it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from mast_zenoh.metrics.study_results import Measured


class DrivingMeasure(NamedTuple):
    """A number of one trial; heading: of its column;  better: -1: less is better, 1: more is"""

    heading: str
    better: int


#: The measures by their key in `driven` of metrics.json; of lists, their length counts.
DRIVING_MEASURES = {
    "collisions": DrivingMeasure("collisions", -1),
    "needless_brakes": DrivingMeasure("needless brakes", -1),
    "missed_brakes": DrivingMeasure("missed brakes", -1),
    "hard_brakes": DrivingMeasure("hard brakes", -1),
    "progress_m": DrivingMeasure("way driven (m)", 1),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class DrivingRow:
    """Trials of one attack and one defence; every measure is one of DRIVING_MEASURES.

    attack:  its name; "": none;  wire: where it is;  defence: its name; "": none
    trials:  number of trials;  missing: of planned ones that were not run, or failed
    measures: mean of a trial
    added:   difference from the twin: the same seed, scene and defence without the attack
    spared:  difference from the same seed, scene and attack without a defence
    """

    attack: str
    wire: str
    defence: str
    trials: int
    missing: int
    measures: Mapping[str, Measured]
    added: Mapping[str, Measured]
    spared: Mapping[str, Measured]

    @property
    def title(self) -> str:
        """The attack and where it is."""
        return f"{self.attack} on {self.wire}" if self.attack else "no attack"


@dataclass(frozen=True, slots=True)
class DrivingTable:
    """All rows, attack by attack;  size: seeds and scenes."""

    rows: Sequence[DrivingRow]
    size: str

    @property
    def not_run(self) -> list[DrivingRow]:
        """The rows without any trial."""
        return [row for row in self.rows if not row.trials]
