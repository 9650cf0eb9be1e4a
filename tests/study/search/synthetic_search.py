"""A study with a search, and trials whose outcome is a known function of their parameters: nothing is played."""

from __future__ import annotations

import random
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import synthetic_outcomes

from mast_zenoh.study.execution import RunTrials
from mast_zenoh.study.trial import Trial, TrialOutcome

STUDY = """
RANGES = {"false_positives": "0.0..10.0", "fraction_false_negatives": "0.0..1.0"}

def study(ranges=None, objective="fp", **more):
    place = dict(n_infrastructure=1)
    return dict(
        name="tuned",
        runs=dict(
            baseline=dict(scenario="baseline", parameters=place),
            attacked=dict(
                scenario="uncoordinated",
                parameters=place | dict(n_adversaries=1, attack_start_s=0.2, false_positives=1.0),
            ),
        ),
        search=dict(run="attacked", parameters=ranges or RANGES, objective=objective, SEARCH),
        scenes=["intersection:0"],
        trials=TRIALS,
        frames=8,
        seed=3,
    )
"""
#: Where the known function is greatest, and its value there.
OPTIMUM = {"false_positives": 6.0, "fraction_false_negatives": 0.5}
MOST = 10.0


def write_study(folder: Path, *, trials: int = 6, **search: object) -> Path:
    """The study file; search: its keys in the section `search`."""
    path = folder / "tuned.py"
    keys = ", ".join(f"{key}={value!r}" for key, value in {"candidates": 16, "batch": 4, "seeds": 2, **search}.items())
    path.write_text(STUDY.replace("SEARCH", keys).replace("TRIALS", str(trials)).replace(", **more", ""))
    return path


def harm(trial: Trial) -> float:
    """The false objects per frame of a trial: a hill over the parameters, and an offset that only its seed knows."""
    settings = dict(setting.split("=", 1) for setting in trial.settings)
    of_seed = random.Random(trial.seed).uniform(-0.5, 0.5)
    if "attack_start_s" not in settings:
        return 1.0 + of_seed
    distance = [
        (float(settings.get(name, 0.2)) - best) / scale
        for (name, best), scale in zip(OPTIMUM.items(), (10.0, 1.0), strict=True)
    ]
    return MOST + of_seed - 8.0 * sum(each**2 for each in distance)


class Synthetic:
    """Stands for `execution.workers`: outcomes come in another order for another number of jobs.

    played: the trials that were run, and not taken from the study's folder
    interrupt_after: number of trials after which Ctrl-C comes;  fails: seed and least number of a candidate that fail
    """

    def __init__(self) -> None:
        self.played: list[Trial] = []
        self.interrupt_after: int | None = None
        self.fails: tuple[int, str] | None = None

    @contextmanager
    def workers(self, jobs: int, cluster: str | None) -> Iterator[RunTrials]:
        def run_trials(trials: Sequence[Trial]) -> Generator[TrialOutcome, None, None]:
            for trial in random.Random(jobs).sample(list(trials), len(trials)) if jobs > 1 else trials:
                if self.interrupt_after is not None and len(self.played) >= self.interrupt_after:
                    raise KeyboardInterrupt
                self.played.append(trial)
                yield self._outcome(trial)

        yield run_trials

    def _outcome(self, trial: Trial) -> TrialOutcome:
        if self.fails == (trial.seed, trial.configuration):
            return TrialOutcome.failed(trial, "ValueError: no plan")
        made = synthetic_outcomes.outcome("x", 0, 0, fp=harm(trial))
        return replace(made, trial=trial)

    def seeds(self, *prefixes: str) -> set[int]:
        """The seeds of the played trials of configurations with such labels."""
        return {trial.seed for trial in self.played if trial.configuration.startswith(prefixes)}
