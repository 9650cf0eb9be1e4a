"""The results of the study of driving: what attacks do to a driven car, and what defences spare it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from mast_zenoh.metrics.study_results import Estimate, Measured

#: Level of the sign test of differences that are mostly zero.
_LEVEL = 0.05


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


class Difference(NamedTuple):
    """The difference of a measure over pairs of trials.

    estimate: its mean and interval;  more, less: seeds or scenes in which it is above 0, and below
    """

    estimate: Estimate
    more: int
    less: int

    @property
    def is_shown(self) -> bool:
        """Whether it is shown to differ from 0.

        By its interval, or because it is the same in all seeds; if it is mostly 0, by an exact sign test of the others.
        """
        each = self.estimate
        if each.mostly_zero:
            others = self.more + self.less
            tail = sum(math.comb(others, number) for number in range(min(self.more, self.less) + 1))
            return math.ldexp(tail, 1 - others) < _LEVEL
        return each.low > 0.0 or each.high < 0.0 or each.certain


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
    flaws:   of its trials;  flawed: whether it, or what it is compared with, has any
    """

    attack: str
    wire: str
    defence: str
    trials: int
    missing: int
    measures: Mapping[str, Estimate]
    added: Mapping[str, Difference]
    spared: Mapping[str, Difference]
    harmed: Affected
    changed: Affected
    flaws: Flaws
    flawed: bool

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
