"""Runs one trial: a configuration, a scene and a seed. Workers import little else."""

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

#: Evaluations that need all messages of a run.
RECORDED = frozenset({"lies"})


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
    evaluation:           what is evaluated besides the metrics of every run (`defences.evaluations`); "": nothing
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

    def command(self) -> str:
        """The command that runs this trial alone, with a run folder and a report."""
        words = ["mast", "run", self.scenario, *(word for each in self.settings for word in ("--set", each))]
        words += ["--seed", str(self.seed), *(["--frames", str(self.frames)] if self.frames else [])]
        words += ["--allow-failures"] if self.allow_failures else []
        return shlex.join([*words, "--runtime", self.runtime])


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


def prepare(trial: Trial) -> None:
    """Prepare the trial's scene in this machine's cache, for all trials that play it."""
    _resolve(trial)


def run(trial: Trial) -> Outcome:
    """Run a trial; errors are returned in the outcome."""
    cpu_start_s = time.process_time()
    try:
        versions = identity.environment()
        for name, version in trial.environment:
            if versions.get(name) != version:
                raise ConfigurationError(
                    f"{name}: this worker has {versions.get(name)}, the study was started with {version}"
                )
        resolved = _resolve(trial)
        compromised = {agent for spec in resolved.nodes.values() if spec.role == "adversary" for agent in spec.agents}
        quiet = trial.evaluation == "lies" and not _is_disturbed(resolved)
        if trial.runtime == "inproc" and (quiet or not trial.evaluation):
            metrics, table, handler_failures = _run_in_process(resolved, trial.allow_failures)
            metrics = _without_lies(metrics) if quiet else metrics
        else:
            metrics, table, handler_failures = _run_in_folder(resolved, trial)
        cpu_s = round(time.process_time() - cpu_start_s, 3)
        warning = failures.summary(handler_failures) if handler_failures else ""
        return Outcome(trial, metrics, table, tuple(sorted(compromised)), cpu_s=cpu_s, warning=warning)
    except Exception as error:
        return Outcome.failed(trial, f"{type(error).__name__}: {error}")


def _resolve(trial: Trial) -> Resolved:
    path, loaded = scenario.load(trial.scenario, trial.settings)
    disturbed = trial.evaluation != "lies" or any(loaded.get(part) for part in _DISTURBANCES)
    record = disturbed and trial.evaluation in RECORDED
    return scenario.resolve(path, loaded, seed=trial.seed, frames=trial.frames, record=record)


def _without_lies(metrics: Mapping[str, Any]) -> Mapping[str, Any]:
    """The metrics of a run in which nothing can lie, with the part `defence`."""
    from mast_zenoh.study.defences.records import NO_LIES  # SciPy's statistics are slow to load

    return {**metrics, "defence": NO_LIES}


def _is_disturbed(resolved: Resolved) -> bool:
    """Whether anything in a run may lie or be faulty."""
    return bool(resolved.timeline) or any(wire["interposers"] for wire in resolved.wiring["wires"])


#: Parts of a scenario that may hold what lies or is faulty: runs with one of them are recorded.
_DISTURBANCES = ("adversaries", "nodes", "links", "faults")

#: metrics.json, the columns of metrics.parquet, and the failures of handlers by node.
RunResult = tuple[Mapping[str, Any], Table, Mapping[str, Sequence[failures.Entry]]]


def _run_in_process(resolved: Resolved, allow_failures: bool) -> RunResult:
    process = InProcess(resolved)
    outcomes = process.run()
    handler_failures = process.failures()
    if handler_failures and not allow_failures:
        raise HandlerFailed(failures.summary(handler_failures))
    evaluation = outcomes.get(EVALUATOR, {})
    if "metrics" not in evaluation:
        raise RunError("the evaluator returned no metrics")
    late = results.late(results.collations(outcomes, resolved.nodes))
    return {**evaluation["metrics"], "late": late}, evaluation["tables"]["metrics"], handler_failures


def _run_in_folder(resolved: Resolved, trial: Trial) -> RunResult:
    """Run a trial on the mesh, or one whose recording is evaluated, in a temporary run folder."""
    from mast_zenoh.launch import folder as run_folder  # trials in this process need neither Zenoh nor Parquet
    from mast_zenoh.launch import run as launcher
    from mast_zenoh.launch.tables import read_table
    from mast_zenoh.study.defences.evaluations import evaluate

    folder = Path(tempfile.mkdtemp(prefix="mast-trial-"))
    try:
        finished = launcher.run(resolved, folder / "run", runtime=trial.runtime, allow_failures=trial.allow_failures)
        if isinstance(finished.error, HandlerFailed):
            raise HandlerFailed(failures.summary(finished.failures))  # without the logs, which are not kept
        if finished.error:
            raise finished.error
        metrics = run_folder.read_json(finished.folder / "metrics.json")
        if trial.evaluation:
            metrics["defence"] = evaluate(trial.evaluation, finished.folder, metrics)
        return metrics, read_table(finished.folder / "metrics.parquet"), finished.failures
    finally:
        shutil.rmtree(folder, ignore_errors=True)
