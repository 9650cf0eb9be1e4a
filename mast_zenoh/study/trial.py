"""One trial: a configuration, a scene and a seed, and what came of it. Workers import this, and little else."""

from __future__ import annotations

import shlex
import shutil
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mast_zenoh import scenario
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.control import failures, results
from mast_zenoh.control.results import EVALUATOR
from mast_zenoh.errors import ConfigurationError, HandlerFailed, RunError
from mast_zenoh.metrics import Table
from mast_zenoh.runtime.inproc import InProcess
from mast_zenoh.study import identity


@dataclass(frozen=True)
class Trial:
    """What to run. `digest` says what the outcome depends on (`identity.digest`); equal digests, equal outcomes.

    configuration, scene: labels in the study
    scenario, settings:   as for `mast run SCENARIO --set …`
    scene_key:            the same for trials that play the same recording
    environment:          code and versions that the outcome is to be that of
    allow_failures:       whether the trial counts although handlers of its nodes failed
    idle:                 s of scene time at which the first attack would begin and at which the trial ends, where it
                          ends first; None: an attack begins, or there is none
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

    def command(self) -> str:
        """The command that runs this trial alone, with a run folder and a report."""
        words = ["mast", "run", self.scenario, *(word for each in self.settings for word in ("--set", each))]
        words += ["--seed", str(self.seed), *(["--frames", str(self.frames)] if self.frames else [])]
        words += ["--allow-failures"] if self.allow_failures else []
        return shlex.join([*words, "--runtime", self.runtime])


@dataclass(frozen=True)
class Outcome:
    """What came of a trial; error: why it failed, "" if it did not; warning: failures of handlers that were allowed.

    metrics:     what metrics.json holds
    per_frame:   the columns of metrics.parquet
    compromised: the agents on whose wires adversaries sit
    cpu_s:       s, CPU time of the process that ran it; no part of the results
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
        """Of a trial that has no results."""
        return cls(trial, {}, {}, error=reason)


def prepare(trial: Trial) -> None:
    """Prepare the trial's scene, so that others that play it find it in this machine's cache."""
    _resolve(trial)


def run(trial: Trial) -> Outcome:
    """Run a trial. Whatever goes wrong with it is in the outcome."""
    begun = time.process_time()
    try:
        here = identity.environment()
        for name, version in trial.environment:
            if here.get(name) != version:
                raise ConfigurationError(
                    f"{name}: this worker has {here.get(name)}, the study was started with {version}"
                )
        resolved = _resolve(trial)
        compromised = {str(s.config["agent"]) for s in resolved.nodes.values() if s.role == "adversary"}
        play = _in_process if trial.runtime == "inproc" else _on_a_mesh
        metrics, table, failed = play(resolved, trial.allow_failures)
        cpu_s = round(time.process_time() - begun, 3)
        warning = failures.summary(failed) if failed else ""
        return Outcome(trial, metrics, table, tuple(sorted(compromised)), cpu_s=cpu_s, warning=warning)
    except Exception as error:
        return Outcome.failed(trial, f"{type(error).__name__}: {error}")


def _resolve(trial: Trial) -> Resolved:
    path, loaded = scenario.load(trial.scenario, trial.settings)
    return scenario.resolve(path, loaded, seed=trial.seed, frames=trial.frames)


#: metrics.json, the columns of metrics.parquet, and the failures of handlers by node.
Played = tuple[Mapping[str, Any], Table, Mapping[str, Sequence[failures.Entry]]]


def _in_process(resolved: Resolved, allow_failures: bool) -> Played:
    process = InProcess(resolved)
    outcomes = process.run()
    failed = process.failures()
    if failed and not allow_failures:
        raise HandlerFailed(failures.summary(failed))
    evaluated = outcomes.get(EVALUATOR, {})
    if "metrics" not in evaluated:
        raise RunError("the evaluator returned no metrics")
    late = results.late(results.collations(outcomes, resolved.nodes))
    return {**evaluated["metrics"], "late": late}, evaluated["tables"]["metrics"], failed


def _on_a_mesh(resolved: Resolved, allow_failures: bool) -> Played:
    from mast_zenoh.launch import folder as run_folder  # a trial in this process needs neither Zenoh nor Parquet
    from mast_zenoh.launch import run as launcher
    from mast_zenoh.launch.tables import read_table

    folder = Path(tempfile.mkdtemp(prefix="mast-trial-"))
    try:
        ended = launcher.run(resolved, folder / "run", allow_failures=allow_failures)
        if isinstance(ended.error, HandlerFailed):
            raise HandlerFailed(failures.summary(ended.failures))  # without the logs, which are not kept
        if ended.error:
            raise ended.error
        metrics = run_folder.read_json(ended.folder / "metrics.json")
        return metrics, read_table(ended.folder / "metrics.parquet"), ended.failures
    finally:
        shutil.rmtree(folder, ignore_errors=True)
