"""A trial of a study, a configuration, a scene and a seed, and its outcome."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from mast_zenoh.metrics import Table


class TrialKey(NamedTuple):
    """Scene and seed of a trial: trials of other configurations with the same key are paired with it."""

    scene: str
    seed: int


def run_command(scenario: str, settings: Sequence[str], seed: int, frames: int | None) -> list[str]:
    """The words of the command that runs a scenario of a study alone."""
    words = ["mast", "run", scenario, *(word for setting in settings for word in ("--set", setting))]
    return [*words, "--seed", str(seed), *(["--frames", str(frames)] if frames else [])]


@dataclass(frozen=True)
class Trial:
    """One run of a study.

    Trials with equal digests (`identity.digest`) have equal outcomes.

    configuration, scene: labels in the study
    scenario, settings:   as for `mast run SCENARIO --set …`
    scene_key:            equal for trials that play the same recording
    environment:          code and versions that a worker must have
    allow_failures:       whether the trial counts even if handlers of its nodes failed
    idle:                 s of scene time: start of the first attack and end of the trial, if the trial ends first;
                          None: an attack starts, or there is none
    evaluation:           kind of study of defences for which it is evaluated (`defences.kinds`); "": none
    folder:               where its recorded run is kept; "": nowhere
    """

    digest: str
    configuration: str
    scene: str
    seed: int
    scenario: str
    settings: tuple[str, ...]
    frames: int | None
    runtime: str
    scene_key: str
    environment: tuple[tuple[str, str], ...]
    allow_failures: bool = False
    idle: tuple[float, float] | None = None
    evaluation: str = ""
    folder: str = ""

    @property
    def key(self) -> TrialKey:
        """Its scene and seed."""
        return TrialKey(self.scene, self.seed)

    def command(self) -> str:
        """The command that runs this trial alone, with a run folder and a report."""
        allowed = ["--allow-failures"] if self.allow_failures else []
        return shlex.join(
            [*run_command(self.scenario, self.settings, self.seed, self.frames), *allowed, "--runtime", self.runtime]
        )


@dataclass(frozen=True)
class Outcome:
    """The outcome of a trial.

    error: why it failed, or ""; warning: handler failures that were allowed
    metrics:     content of metrics.json
    per_frame:   the columns of metrics.parquet
    compromised: agents with adversaries on their wires
    cpu_s:       s, CPU time of the process that ran it; not part of the results
    """

    trial: Trial
    metrics: Mapping[str, Any]
    per_frame: Table
    compromised: tuple[str, ...] = ()
    error: str = ""
    cpu_s: float = 0.0
    warning: str = ""

    @classmethod
    def failed(cls, trial: Trial, reason: str) -> Outcome:
        """The outcome of a trial without results."""
        return cls(trial, {}, {}, error=reason)
