"""Runs one trial. Workers import little else."""

from __future__ import annotations

import shlex
import shutil
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mast_zenoh import scenario
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.control import failures, results
from mast_zenoh.control.results import EVALUATOR
from mast_zenoh.errors import ConfigurationError, HandlerFailed, RunError
from mast_zenoh.metrics import Table
from mast_zenoh.run_files import read_json
from mast_zenoh.runtime.inproc import InProcess
from mast_zenoh.study import identity
from mast_zenoh.study.trial import Outcome, Trial

if TYPE_CHECKING:
    from mast_zenoh.study.defences.kinds import Kind

#: Parts of a scenario that may hold what lies or is faulty.
_DISTURBANCES = ("adversaries", "nodes", "links", "faults")

#: metrics.json, the columns of metrics.parquet, and the failures of handlers by node.
RunResult = tuple[Mapping[str, Any], Table, Mapping[str, Sequence[failures.Entry]]]


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
        agents = {agent for spec in resolved.nodes.values() if spec.role == "adversary" for agent in spec.agents}
        compromised = tuple(sorted(agents))
        kind = _kind(trial)
        unevaluated = kind is None or (bool(kind.undisturbed) and not _is_disturbed(resolved))
        if trial.runtime == "inproc" and unevaluated and not trial.folder:
            metrics, table, handler_failures = _run_in_process(resolved, trial.allow_failures)
            metrics = metrics if kind is None else {**metrics, "defence": kind.without_lies()}
        else:
            metrics, table, handler_failures = _run_in_folder(resolved, trial, compromised)
        cpu_s = round(time.process_time() - cpu_start_s, 3)
        warning = failures.summary(handler_failures) if handler_failures else ""
        return Outcome(trial, metrics, table, compromised, cpu_s=cpu_s, warning=warning)
    except Exception as error:
        return Outcome.failed(trial, f"{type(error).__name__}: {error}")


def _resolve(trial: Trial) -> Resolved:
    path, loaded = scenario.load(trial.scenario, trial.settings)
    kind = _kind(trial)
    disturbed = kind is None or not kind.undisturbed or any(loaded.get(part) for part in _DISTURBANCES)
    record = bool(trial.folder) or (kind is not None and kind.recorded and disturbed)
    return scenario.resolve(path, loaded, seed=trial.seed, frames=trial.frames, record=record)


def _kind(trial: Trial) -> Kind | None:
    """The kind of study of defences that evaluates a trial; None: another study."""
    if not trial.evaluation:
        return None
    from mast_zenoh.study.defences.kinds import kind_named  # other studies do without

    return kind_named(trial.evaluation)


def _is_disturbed(resolved: Resolved) -> bool:
    """Whether anything in a run may lie or be faulty."""
    return bool(resolved.timeline) or any(wire["interposers"] for wire in resolved.wiring["wires"])


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


def _run_in_folder(resolved: Resolved, trial: Trial, compromised: Sequence[str]) -> RunResult:
    """Run a trial on the mesh, or one whose run folder is evaluated or kept, in that folder or a temporary one."""
    from mast_zenoh.launch import run as launcher
    from mast_zenoh.launch.tables import read_table

    folder = Path(tempfile.mkdtemp(prefix="mast-trial-"))
    try:
        kept = Path(trial.folder or folder / "run")
        if kept.is_symlink():
            kept.unlink()
        elif kept.exists():
            shutil.rmtree(kept)  # of a trial that was interrupted or failed
        finished = launcher.run(
            resolved,
            kept,
            runtime=trial.runtime,
            allow_failures=trial.allow_failures,
            command=shlex.split(trial.command()),
        )
        if isinstance(finished.error, HandlerFailed):
            raise HandlerFailed(failures.summary(finished.failures))  # without the logs, which are not kept
        if finished.error:
            raise finished.error
        metrics = read_json(finished.folder / "metrics.json")
        if (kind := _kind(trial)) is not None:
            metrics["defence"] = kind.evaluate(finished.folder, metrics, compromised)
        return metrics, read_table(finished.folder / "metrics.parquet"), finished.failures
    finally:
        shutil.rmtree(folder, ignore_errors=True)
