"""Runs trials, sequentially in this process or in parallel with dask.distributed."""

from __future__ import annotations

import importlib.util
import logging
import os
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from mast_zenoh.errors import ConfigurationError, StartError
from mast_zenoh.study import trial_run
from mast_zenoh.study.trial import Outcome, Trial

_CONNECT_S = 20

#: Environment of workers: glibc's malloc keeps freed memory for the next frame. Dask's default returns it to the
#: system at once, and every page then has to be fetched again.
_MALLOC_SETTINGS = {"MALLOC_TRIM_THRESHOLD_": 2**31 - 1, "MALLOC_MMAP_THRESHOLD_": 2**30, "MALLOC_TOP_PAD_": 2**26}


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


def run_all(trials: Sequence[Trial], *, jobs: int, cluster: str | None) -> Generator[Outcome, None, None]:
    """Yield the outcome of each trial as it completes, in any order.

    jobs:    local worker processes of one thread each; with 1 the trials run in this process, without dask
    cluster: address of a running Dask scheduler instead, such as tcp://HOST:8786

    Closing the iterator, as an exception in its consumer does, cancels unfinished trials and stops local workers.
    Raises ConfigurationError where dask is needed and not installed, StartError where no scheduler answers.
    """
    if cluster is None and jobs == 1:
        for trial in trials:
            yield trial_run.run(trial)
        return
    require(jobs, cluster)
    with _client(jobs, cluster) as client:
        yield from _run_on_cluster(client, trials)


def _run_on_cluster(client: Any, trials: Sequence[Trial]) -> Iterator[Outcome]:
    """Prepare each scene in one task, on which the trials of that scene depend."""
    from distributed import as_completed

    prepared: dict[tuple[str, int], Any] = {}
    pending: dict[Any, Trial] = {}
    try:
        for trial in trials:
            scene = trial.scene_key, trial.seed
            if scene not in prepared:
                prepared[scene] = client.submit(trial_run.prepare, trial, pure=False)
            pending[client.submit(_run_after, trial, prepared[scene], pure=False)] = trial
        for future in as_completed(list(pending)):
            trial = pending.pop(future)
            try:
                outcome = future.result()
            except Exception as error:  # preparing the scene failed, or the worker died
                outcome = Outcome.failed(trial, f"{type(error).__name__}: {error}")
            future.release()
            yield outcome
    finally:
        client.cancel([*pending, *prepared.values()], force=True)


def _run_after(trial: Trial, prepared: None) -> Outcome:
    """Run a trial; `prepared` makes Dask prepare its scene first."""
    return trial_run.run(trial)


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
            yield client
