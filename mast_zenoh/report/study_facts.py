"""Facts about a study for its page and tables."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TypeVar


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


def plural(count: int, noun: str) -> str:
    """`1 seed`, `20 seeds`."""
    return f"{count} {noun}{'' if count == 1 else 's'}"


def size_of(seeds: int, scenes: int) -> str:
    """Numbers of seeds and scenes in words: `2 seeds × 1 scene`."""
    return f"{plural(seeds, 'seed')} \u00d7 {plural(scenes, 'scene')}"
