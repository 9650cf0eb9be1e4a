"""The results of the study of driving: what attacks do to a driven car, and what defences spare it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from mast_zenoh.metrics.study_results import Estimate, Measured


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


class Affected(NamedTuple):
    """In how many pairs something happened.

    happened, pairs: numbers;  chance: of a pair, with its exact interval; of seeds or scenes
    """

    happened: int = 0
    pairs: int = 0
    chance: Measured = Measured()


@dataclass(frozen=True, slots=True, kw_only=True)
class Flaws:
    """In how many trials of a configuration something did not take part as its scenario says.

    no_command:  no command of the driver was accepted;  uncommanded: the car had no new command in some frame
    no_estimate: the driver had no estimate in some frame
    idle:        by adversary, it changed no message
    """

    no_command: int = 0
    uncommanded: int = 0
    no_estimate: int = 0
    idle: Mapping[str, int] = field(default_factory=dict)

    def __bool__(self) -> bool:
        return bool(self.no_command or self.uncommanded or self.no_estimate or self.idle)


@dataclass(frozen=True, slots=True, kw_only=True)
class DrivingRow:
    """Trials of one attack and one defence; every measure is one of DRIVING_MEASURES.

    attack:  its name; "": none;  wire: where it is;  defence: its name; "": none
    trials:  number of trials;  missing: of planned ones that were not run, or failed
    measures: mean of a trial
    added:   difference from the twin: the same seed, scene and defence without the attack
    spared:  difference from the same seed, scene and attack without a defence
    harmed:  pairs with the twin in which any measure is worse
    changed: pairs with no defence in which any measure differs
    own:     the user's metrics of what the car's agent acts on, and their differences from the twin
    flaws:   of its trials;  flawed: whether it, or what it is compared with, has any
    """

    attack: str
    wire: str
    defence: str
    trials: int
    missing: int
    measures: Mapping[str, Estimate]
    added: Mapping[str, Estimate]
    spared: Mapping[str, Estimate]
    harmed: Affected
    changed: Affected
    flaws: Flaws
    flawed: bool
    own: Mapping[str, tuple[Estimate, Estimate]] = field(default_factory=dict)

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
