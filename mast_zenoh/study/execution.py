"""Runs trials: one, or many, sequentially in this process or in parallel with dask.distributed."""

from __future__ import annotations

import importlib.util
import json
import logging
import os
import shlex
import shutil
import signal
import tempfile
import time
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mast_zenoh import scenario
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.errors import (
    ConfigurationError,
    HandlerFailed,
    Interrupted,
    RunError,
    StartError,
    is_from_outside,
    place_of,
)
from mast_zenoh.mesh.control import failures, results
from mast_zenoh.mesh.control.results import EVALUATOR
from mast_zenoh.mesh.inproc import InProcess
from mast_zenoh.metrics import Table
from mast_zenoh.run_folder import finite
from mast_zenoh.study.trial import Trial, TrialOutcome, environment

if TYPE_CHECKING:
    from mast_zenoh.runs.run import Run
    from mast_zenoh.study.defences.kinds import Kind

_CONNECT_S = 20

#: Environment of workers: glibc's malloc keeps freed memory for the next frame. Dask's default returns it to the
#: system at once, and every page then has to be fetched again.
_MALLOC_SETTINGS = {"MALLOC_TRIM_THRESHOLD_": 2**31 - 1, "MALLOC_MMAP_THRESHOLD_": 2**30, "MALLOC_TOP_PAD_": 2**26}
#: Parts of a scenario that may hold what lies or is faulty.
_DISTURBANCES = ("adversaries", "nodes", "links", "faults")

#: metrics.json, the columns of metrics.parquet, the failures of handlers by node, and s of CPU time of the run alone.
RunResult = tuple[Mapping[str, Any], Table, Mapping[str, Sequence[failures.Entry]], float]


def prepare(trial: Trial) -> None:
    """Prepare the trial's scene in this machine's cache, for all trials that play it."""
    _resolve(trial)


def run(trial: Trial) -> TrialOutcome:
    """Run a trial; errors are returned in the outcome. Raises Interrupted if a signal stopped it."""
    try:
        versions = environment(name for name, _ in trial.environment)
        for name, version in trial.environment:
            if versions.get(name) != version:
                raise ConfigurationError(
                    f"{name}: this worker has {versions.get(name)}, the study was started with {version}"
                )
        resolved = _resolve(trial)
        agents = {agent for spec in resolved.nodes.values() if spec.role == "adversary" for agent in spec.agents}
        compromised = tuple(sorted(agents))
        kind = _kind(trial)
        part = None if kind is None or _is_disturbed(resolved) else kind.without_lies
        if trial.runtime == "inproc" and (kind is None or part is not None) and not trial.folder:
            metrics, table, handler_failures, cpu_s = _run_in_process(resolved, trial.allow_failures)
            metrics = metrics if part is None else {**metrics, "defence": part}
        else:
            metrics, table, handler_failures, cpu_s = _run_in_folder(resolved, trial, compromised)
        warning = failures.summary(handler_failures) if handler_failures else ""
        return TrialOutcome(trial, metrics, table, compromised, cpu_s=round(cpu_s, 3), warning=warning)
    except Interrupted:
        raise
    except (Exception, SystemExit) as error:  # of code of the user's
        return TrialOutcome.failed(trial, f"{type(error).__name__}: {error}")


def _resolve(trial: Trial) -> Resolved:
    path, loaded = scenario.load(trial.scenario, trial.settings)
    kind = _kind(trial)
    record = bool(trial.folder)
    if kind is not None and kind.recorded:
        record |= kind.without_lies is None or any(loaded.get(part) for part in _DISTURBANCES)
    return scenario.resolve(path, loaded, seed=trial.seed, frames=trial.frames, record=record)


def _kind(trial: Trial) -> type[Kind] | None:
    """The kind of study that evaluates a trial in its run folder; None: nothing but the metrics is needed."""
    if not trial.evaluation:
        return None
    from mast_zenoh.study.defences.kinds import kind_of  # other studies do without

    return kind_of(trial.evaluation)


def _is_disturbed(resolved: Resolved) -> bool:
    """Whether anything in a run may lie or be faulty."""
    return bool(resolved.timeline) or any(wire["interposers"] for wire in resolved.wiring["wires"])


def _run_in_process(resolved: Resolved, allow_failures: bool) -> RunResult:
    start_s = time.process_time()
    process = InProcess(resolved)
    outcomes = process.run()
    cpu_s = time.process_time() - start_s
    handler_failures = process.failures()
    if handler_failures and not allow_failures:
        raise HandlerFailed(failures.summary(handler_failures))
    evaluation = outcomes.get(EVALUATOR, {})
    if "metrics" not in evaluation:
        raise RunError("the evaluator returned no metrics")
    late = results.late(results.collations(outcomes, resolved.nodes))
    return {**evaluation["metrics"], "late": late}, evaluation["tables"]["metrics"], handler_failures, cpu_s


def _run_in_folder(resolved: Resolved, trial: Trial, compromised: Sequence[str]) -> RunResult:
    """Run a trial on the mesh, or one whose run folder is evaluated or kept, in that folder or a temporary one."""
    from mast_zenoh.launch import run as launcher
    from mast_zenoh.run_folder.tables import from_arrow
    from mast_zenoh.runs.run import Run

    folder = Path(tempfile.mkdtemp(prefix="mast-trial-"))
    try:
        kept = Path(trial.folder or folder / "run")
        if kept.is_symlink():
            kept.unlink()
        elif kept.exists():
            shutil.rmtree(kept)  # of a trial that was interrupted or failed
        start_s = time.process_time()
        finished = launcher.run(
            resolved,
            kept,
            runtime=trial.runtime,
            allow_failures=trial.allow_failures,
            command=shlex.split(trial.command()),
        )
        cpu_s = time.process_time() - start_s
        if isinstance(finished.error, HandlerFailed):
            raise HandlerFailed(failures.summary(finished.failures))  # without the logs, which are not kept
        if finished.error:
            raise finished.error
        played = Run(finished.folder)
        metrics = played.summary
        if (kind := _kind(trial)) is not None:
            metrics["defence"] = _evaluated(kind, played, compromised)
        return metrics, from_arrow(played.metrics), finished.failures, cpu_s
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _evaluated(kind: type[Kind], run: Run, compromised: Sequence[str]) -> Any:
    """What a kind says of a run, as it will be read again; raises RunError, with the place, if it fails."""
    try:
        result = finite(kind.evaluate(run, compromised))
        json.dumps(result, allow_nan=False)
    except (Exception, SystemExit) as error:
        if is_from_outside(error):
            raise
        place = place_of(error, {kind.__module__})
        raise RunError(f"{place}{': ' if place else ''}evaluate: {type(error).__name__}: {error}") from None
    return result


def default_jobs() -> int:
    """The number of cores that this process may use; 1 if dask is not installed."""
    return len(os.sched_getaffinity(0)) if importlib.util.find_spec("distributed") else 1


def require(jobs: int, cluster: str | None) -> None:
    """Raises ConfigurationError where dask is needed and not installed."""
    if cluster is None and jobs == 1:
        return
    try:
        import distributed  # noqa: F401
    except ImportError:
        raise ConfigurationError(
            "more than one job needs dask: install mast-zenoh[study], or run with --jobs 1"
        ) from None


#: Yields the outcome of each trial as it completes, in any order; closing it cancels unfinished trials.
RunTrials = Callable[[Sequence[Trial]], Generator[TrialOutcome, None, None]]


@contextmanager
def workers(jobs: int, cluster: str | None) -> Iterator[RunTrials]:
    """What runs trials, as often as it is called in this block.

    jobs:    local worker processes of one thread each; with 1 the trials run in this process, without dask
    cluster: address of a running Dask scheduler instead, such as tcp://HOST:8786

    Local workers are stopped at the end of the block. Raises StartError where no scheduler answers.
    """
    if cluster is None and jobs == 1:
        yield _run_here
        return
    with _client(jobs, cluster) as client:
        yield partial(_run_on_cluster, client)


def _run_here(trials: Sequence[Trial]) -> Generator[TrialOutcome, None, None]:
    for trial in trials:
        yield run(trial)


def _run_on_cluster(client: Any, trials: Sequence[Trial]) -> Generator[TrialOutcome, None, None]:
    """Prepare each scene in one task, on which the trials of that scene depend."""
    from distributed import as_completed

    prepared: dict[tuple[str, int], Any] = {}
    pending: dict[Any, Trial] = {}
    try:
        for trial in trials:
            scene = trial.scene_key, trial.seed
            if scene not in prepared:
                prepared[scene] = client.submit(prepare, trial, pure=False)
            pending[client.submit(_run_after, trial, prepared[scene], pure=False)] = trial
        for future in as_completed(list(pending)):
            trial = pending.pop(future)
            try:
                outcome = future.result()
            except Exception as error:  # preparing the scene failed, or the worker died
                outcome = TrialOutcome.failed(trial, f"{type(error).__name__}: {error}")
            future.release()
            yield outcome
    finally:
        client.cancel([*pending, *prepared.values()], force=True)


def _run_after(trial: Trial, prepared: None) -> TrialOutcome:
    """Run a trial; `prepared` makes Dask prepare its scene first."""
    return run(trial)


@contextmanager
def _client(jobs: int, cluster: str | None) -> Iterator[Any]:
    """A client of the running scheduler, or of a local cluster that stops with it."""
    import dask
    from distributed import Client, LocalCluster

    settings: dict[str, Any] = {
        "distributed.comm.timeouts.connect": f"{_CONNECT_S}s",
        "distributed.admin.tick.limit": "60s",
        # These interrupt a trial a hundred times a second or more, for dashboards that are not used here.
        "distributed.worker.profile.enabled": False,
        "distributed.admin.tick.interval": "1s",
        "distributed.admin.system-monitor.interval": "10s",
        # Ctrl-C reaches all processes of a terminal: this one ends the workers.
        "distributed.worker.preload": ["import signal\nsignal.signal(signal.SIGINT, signal.SIG_IGN)\n"],
    }
    settings |= {f"distributed.nanny.pre-spawn-environ.{name}": value for name, value in _MALLOC_SETTINGS.items()}
    with dask.config.set(settings):
        if cluster is not None:
            try:
                client = Client(cluster, timeout=_CONNECT_S)
            except (OSError, ValueError) as error:
                raise StartError(f"--cluster {cluster}: no Dask scheduler answers there: {error}") from None
            with client:
                yield client
            return
        local_cluster = LocalCluster(
            n_workers=jobs,
            threads_per_worker=1,
            processes=True,
            dashboard_address="127.0.0.1:0",  # it cannot be left out, and warns of another study on its usual port
            silence_logs=logging.CRITICAL,
            memory_limit=0,
        )
        with local_cluster, Client(local_cluster) as client:
            try:
                yield client
            except BaseException:
                _kill(local_cluster)
                raise


def _kill(local_cluster: Any) -> None:
    """End the workers of a study that is stopped: their trials are lost in any case, and would end seconds later."""
    for nanny in list(local_cluster.workers.values()):
        nanny.close_gracefully()  # it would start another worker
        if nanny.pid is not None:
            with suppress(ProcessLookupError):
                os.kill(nanny.pid, signal.SIGKILL)
