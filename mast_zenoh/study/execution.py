"""Carries out trials: one after the other in this process, or fanned out with dask.distributed."""

from __future__ import annotations

import importlib.util
import logging
import os
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from mast_zenoh.errors import ConfigurationError, StartError
from mast_zenoh.study import trial as one
from mast_zenoh.study.trial import Outcome, Trial

_CONNECT_S = 20

#: Of glibc's malloc: a worker keeps what it frees, because the next frame needs it again. Dask has it given back at
#: once, and every page that is fetched anew costs.
_KEEP_MEMORY = {"MALLOC_TRIM_THRESHOLD_": 2**31 - 1, "MALLOC_MMAP_THRESHOLD_": 2**30, "MALLOC_TOP_PAD_": 2**26}


def default_jobs() -> int:
    """As many as this process may use cores; 1 without dask, which more would need."""
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


def carry_out(trials: Sequence[Trial], *, jobs: int, cluster: str | None) -> Generator[Outcome, None, None]:
    """The outcomes of all trials, each as soon as it is there, in any order.

    jobs:    local worker processes of one thread each; with 1 the trials run in this process, without dask
    cluster: address of a running Dask scheduler instead, such as tcp://HOST:8786

    Closing the iterator, as an exception in its consumer does, gives up what is not done and ends the local workers.
    Raises ConfigurationError where dask is needed and not installed, StartError where no scheduler answers.
    """
    if cluster is None and jobs == 1:
        for trial in trials:
            yield one.run(trial)
        return
    require(jobs, cluster)
    with _client(jobs, cluster) as client:
        yield from _fan_out(client, trials)


def _fan_out(client: Any, trials: Sequence[Trial]) -> Iterator[Outcome]:
    """Each scene is prepared by one task, on which the trials that play it depend."""
    from distributed import as_completed

    prepared: dict[tuple[str, int], Any] = {}
    pending: dict[Any, Trial] = {}
    try:
        for trial in trials:
            scene = trial.scene_key, trial.seed
            if scene not in prepared:
                prepared[scene] = client.submit(one.prepare, trial, pure=False)
            pending[client.submit(_run_after, trial, prepared[scene], pure=False)] = trial
        for future in as_completed(list(pending)):
            trial = pending.pop(future)
            try:
                outcome = future.result()
            except Exception as error:  # of the scene, or the worker died
                outcome = Outcome.failed(trial, f"{type(error).__name__}: {error}")
            future.release()
            yield outcome
    finally:
        client.cancel([*pending, *prepared.values()], force=True)


def _run_after(trial: Trial, prepared: None) -> Outcome:
    """The trial, once its scene is prepared."""
    return one.run(trial)


@contextmanager
def _client(jobs: int, cluster: str | None) -> Iterator[Any]:
    """A client of the running scheduler, or of a cluster of this machine that ends with it."""
    import dask
    from distributed import Client, LocalCluster

    settings: dict[str, Any] = {
        "distributed.comm.timeouts.connect": f"{_CONNECT_S}s",
        "distributed.admin.tick.limit": "60s",
        # What would interrupt a trial a hundred times a second and more, for pages that nobody opens.
        "distributed.worker.profile.enabled": False,
        "distributed.admin.tick.interval": "1s",
        "distributed.admin.system-monitor.interval": "10s",
    }
    settings |= {f"distributed.nanny.pre-spawn-environ.{name}": value for name, value in _KEEP_MEMORY.items()}
    with dask.config.set(settings):
        if cluster is not None:
            try:
                client = Client(cluster, timeout=_CONNECT_S)
            except (OSError, ValueError) as error:
                raise StartError(f"--cluster {cluster}: no Dask scheduler answers there: {error}") from None
            with client:
                yield client
            return
        local = LocalCluster(
            n_workers=jobs,
            threads_per_worker=1,
            processes=True,
            dashboard_address=None,
            silence_logs=logging.CRITICAL,
            memory_limit=0,
        )
        with local, Client(local) as client:
            yield client
