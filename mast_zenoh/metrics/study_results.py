"""The results of a study, as it computes them and reports show them: estimates, defences, limits, facts.

Which of several effects differ from 0 when all are read together.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple, TypeVar

from mast_zenoh.errors import plural
from mast_zenoh.metrics.causes import CAUSES

NAN = float("nan")
#: Minimum number of seeds for an interval.
MIN_SEEDS = 5
#: An increment that is 0 in a larger share of trials than this has no interval.
MOSTLY = 0.5
#: Differences up to this are rounding errors.
NEGLIGIBLE = 1e-9
#: Level at which a difference is distinguishable from 0.
LEVEL = 0.05


class StudySeries(NamedTuple):
    """A measure of a configuration: identifies a number in results.parquet.

    owner: the column `who`; of rows "" for the agent whose estimates are scored, the ego
    """

    owner: str
    estimator: str
    metric: str


#: How intervals were computed, see `study.statistics`; or that there is none, as most differences are 0.
STUDENT, BOOTSTRAP, POISSON, BINOMIAL = "Student's t", "bootstrap over trials", "exact Poisson", "exact binomial"
#: Of fewer than five seeds, but not scenes: to other scenes with these seeds; of three or more, to other seeds, too.
OVER_SCENES, TWO_WAY = "Student's t over scenes", "analysis of variance over scenes and seeds"
MOSTLY_ZERO = "none: mostly 0"


class Statistic(NamedTuple):
    """A number over trials with its 95 % interval. NaN: unknown; infinite: beyond what was watched.

    value, low, high: of means, over the trials of `seeds` seeds in `scenes` scenes, each paired with its baseline: over
               seeds of these scenes; without bounds for fewer than five seeds, or equal ones
    trials:    number of trials behind it;  left_out: of those without it, because they failed or have no value
    interval:  how the bounds were computed: STUDENT, OVER_SCENES, TWO_WAY, BOOTSTRAP, POISSON, BINOMIAL; MOSTLY_ZERO or
               "" without bounds
    p:         p-value of no difference, over seeds; of differences only: of Student's t, or where most are 0 of an
               exact sign test; NaN where all are equal
    mean, std: over the frames of all trials, as in the paper; std is NaN for metrics of whole runs
    scenes_low, scenes_high: 95 % interval to other scenes as well; for five scenes and more
    zero_share, zero_low, zero_high: share of trials in which a difference is 0, and its exact 95 % interval
    rate:      whether it is a success rate, from trials that are 0 or 1
    """

    value: float = NAN
    low: float = NAN
    high: float = NAN
    trials: int = 0
    left_out: int = 0
    interval: str = ""
    p: float = NAN
    mean: float = NAN
    std: float = NAN
    scenes_low: float = NAN
    scenes_high: float = NAN
    zero_share: float = NAN
    zero_low: float = NAN
    zero_high: float = NAN
    scenes: int = 0
    seeds: int = 0
    rate: bool = False

    @property
    def known(self) -> bool:
        """Whether there is a value, infinite or not."""
        return not math.isnan(self.value)

    def seeds_left_out(self, planned: int) -> int:
        """How many of the planned seeds are left out; 0 if no trial has a value."""
        return planned - self.seeds if self.scenes else 0

    @property
    def mostly_zero(self) -> bool:
        """Whether a difference is 0 in most trials, of at least five seeds, so that its mean has no interval."""
        return self.seeds >= MIN_SEEDS and self.zero_share > MOSTLY

    @property
    def unchanged(self) -> bool:
        """Whether a difference is 0 in every trial, of at least five seeds."""
        return self.seeds >= MIN_SEEDS and self.is_zero

    @property
    def is_zero(self) -> bool:
        """Whether a difference is 0 in every trial."""
        return self.zero_share == 1.0

    @property
    def certain(self) -> bool:
        """Whether a difference is equal in every seed and not 0, so without interval."""
        known = self.seeds >= MIN_SEEDS and abs(self.value) > NEGLIGIBLE
        return known and math.isnan(self.low) and not self.mostly_zero

    @property
    def differs(self) -> bool:
        """Whether a test says so; without one, whether the interval does not contain 0."""
        return self.p <= LEVEL if not math.isnan(self.p) else self.low > 0.0 or self.high < 0.0

    @property
    def seen(self) -> bool:
        """Whether a difference, taken alone, differs from 0: by its test, or because it is the same in all seeds."""
        return self.p <= LEVEL or self.certain


def shares(row: Row, outcome: str, estimator: str = "picture") -> dict[str, float]:
    """Shares (0 to 1) of the causes of an estimate's errors; {} if there are none.

    outcome: "fp" (false objects) or "fn" (missed objects)
    """
    counts = {cause: row.get(StudySeries("", estimator, f"{outcome} {cause}")).mean for cause in CAUSES}
    counts = {cause: mean for cause, mean in counts.items() if mean > 0.0}
    total = sum(counts.values())
    return {cause: mean / total for cause, mean in counts.items()}


@dataclass(frozen=True, slots=True)
class FailedTrial:
    """A trial without results, why, and the command that runs it alone."""

    configuration: str
    scene: str
    seed: int
    error: str
    command: str


@dataclass(frozen=True, slots=True)
class IdleAttack:
    """A configuration whose attack would begin after the end of its trials.

    begins_s, ends_s: s of scene time: start of the attack, end of the trials
    scenes:           the scenes to which this applies; empty: all
    """

    configuration: str
    begins_s: float
    ends_s: float
    scenes: tuple[str, ...] = ()


_Named = TypeVar("_Named", FailedTrial, IdleAttack)


@dataclass(frozen=True, slots=True)
class StudyFacts:
    """One study.

    baseline:       label of the configuration with which the others are compared
    configurations: by label, the scenario and its settings
    scenes, seeds:  planned for every configuration, all scenes with all seeds
    frames:         of each trial, None for all of the scene
    done:           number of trials with results, by configuration
    other_scenes:   labels of configurations whose scene or agents differ from the baseline's
    idle:           configurations whose attack never began
    environment:    Python, the packages and a hash of the code that the results depend on
    left_out:       why results of the study's kind are not there
    ego:            name of the agent whose estimates are scored
    own:            what users' metrics are, `own_metrics` of metrics.json
    """

    name: str
    baseline: str
    configurations: Mapping[str, tuple[str, tuple[str, ...]]]
    scenes: tuple[str, ...]
    seeds: tuple[int, ...]
    frames: int | None
    runtime: str
    done: Mapping[str, int]
    failed: tuple[FailedTrial, ...]
    environment: Mapping[str, str]
    other_scenes: tuple[str, ...] = ()
    idle: tuple[IdleAttack, ...] = ()
    left_out: tuple[str, ...] = ()
    ego: str = "ego"
    own: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    @property
    def units(self) -> dict[str, str]:
        """What follows the names of users' metrics: ` (objects)`."""
        return {name: f" ({about['unit']})" for name, about in self.own.items() if about.get("unit")}

    def titled(self, titles: Mapping[str, str]) -> StudyFacts:
        """A copy with configurations renamed; titles: new names by label."""
        return replace(
            self,
            baseline=titles.get(self.baseline, self.baseline),
            configurations={titles.get(label, label): each for label, each in self.configurations.items()},
            done={titles.get(label, label): count for label, count in self.done.items()},
            failed=tuple(_renamed(each, titles) for each in self.failed),
            other_scenes=tuple(titles.get(label, label) for label in self.other_scenes),
            idle=tuple(_renamed(each, titles) for each in self.idle),
        )

    @property
    def planned(self) -> int:
        """Planned trials of each configuration."""
        return len(self.scenes) * len(self.seeds)

    @property
    def trials(self) -> int:
        """Planned trials of all configurations."""
        return self.planned * len(self.configurations)

    @property
    def failures(self) -> str:
        """`3 of 420 trials failed`, and of which configurations; "" if none."""
        if not self.failed:
            return ""
        counts = {label: self.planned - self.done.get(label, 0) for label in self.configurations}
        parts = [f"{label} {count} of {self.planned}" for label, count in counts.items() if count]
        return f"{len(self.failed)} of {self.trials} trials failed: {', '.join(parts)}"

    @property
    def never_attacked(self) -> frozenset[str]:
        """The configurations whose attack began in no trial."""
        return frozenset(each.configuration for each in self.idle if not each.scenes)

    @property
    def size(self) -> str:
        """`20 seeds × 3 scenes`."""
        return size_of(len(self.seeds), len(self.scenes))


def _renamed(each: _Named, titles: Mapping[str, str]) -> _Named:
    return replace(each, configuration=titles.get(each.configuration, each.configuration))


def size_of(seeds: int, scenes: int) -> str:
    """Numbers of seeds and scenes in words: `2 seeds × 1 scene`."""
    return f"{plural(seeds, 'seed')} \u00d7 {plural(scenes, 'scene')}"


@dataclass(frozen=True, slots=True, eq=False)
class Row:
    """Numbers over the trials of one cell, or of one configuration.

    of: what it is of, by name; of a configuration its label (`configuration`), and parameters of the grid
    trials: their number, or that of pairs
    numbers: by measure, a name or a StudySeries
    """

    of: dict[str, Any]
    trials: int
    numbers: Mapping[Any, Statistic]

    def __getitem__(self, measure: object) -> Statistic:
        return self.numbers[measure]

    def get(self, measure: object) -> Statistic:
        """The number of a measure; all NaN if there is none."""
        return self.numbers.get(measure, Statistic())

    @property
    def idle(self) -> bool:
        """Whether adversaries lied in none of the runs, so that their attack did not take place (`attacked`)."""
        return "attacked" in self.numbers and self.numbers["attacked"].value == 0.0

    @property
    def configuration(self) -> str:
        """The label of a configuration."""
        return str(self.of["configuration"])

    @property
    def point(self) -> dict[str, Any]:
        """The parameters of the grid of a configuration, by name."""
        return {name: value for name, value in self.of.items() if name != "configuration"}

    @property
    def run(self) -> str:
        """The label of a configuration's run in the study file: its own without the values of parameters."""
        return self.configuration.removesuffix("".join(f"-{value}" for value in self.point.values()))

    @property
    def title(self) -> str:
        """The label of a configuration with parameter names: `attacked false_positives=2.0`."""
        return " ".join([self.run, *(f"{name}={value}" for name, value in self.point.items())])


Effect = TypeVar("Effect", bound=Hashable)


def clearest(effects: Mapping[Effect, Statistic]) -> list[Effect]:
    """The effects that differ from 0 if all are read together (Holm), the clearest first: that with the smallest p.

    With equal numbers of seeds, this is the largest |t|. Effects without spread have no p-value and are left out.
    """
    tested = {name: each for name, each in effects.items() if not math.isnan(each.p)}
    adjusted = zip(tested, holm([each.p for each in tested.values()]), strict=True)
    shown = [name for name, p in adjusted if p <= LEVEL]
    return sorted(shown, key=lambda name: (tested[name].p, -abs(tested[name].value)))


def holm(p_values: Sequence[float]) -> list[float]:
    """p-values adjusted for multiple testing by Holm's procedure.

    Holm (1979), A simple sequentially rejective multiple test procedure, Scandinavian Journal of Statistics 6:65.
    Valid whatever the dependence between the tests.
    """
    order = sorted(range(len(p_values)), key=p_values.__getitem__)
    adjusted, worst = [1.0] * len(p_values), 0.0
    for rank, index in enumerate(order):
        worst = max(worst, min(1.0, (len(p_values) - rank) * p_values[index]))
        adjusted[index] = worst
    return adjusted
