"""Runs, stores and resumes studies of many trials."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from mast_zenoh import kernels
from mast_zenoh.errors import ConfigurationError
from mast_zenoh.launch import ending
from mast_zenoh.study import execution, plan, tables
from mast_zenoh.study.definition import Study
from mast_zenoh.study.store import Store
from mast_zenoh.study.tables import StudyResult
from mast_zenoh.study.trial import Trial


def run(
    study: Study,
    out: Path | None = None,
    *,
    count: int,
    jobs: int = 1,
    cluster: str | None = None,
    resume: bool = False,
    seed: int | None = None,
    frames: int | None = None,
    runtime: str | None = None,
    allow_failures: bool = False,
    record: bool = False,
    console: Console | None = None,
) -> StudyResult:
    """Run every configuration in every scene with `count` seeds, and write the tables.

    allow_failures: whether a trial counts even if handlers of its nodes failed
    jobs, cluster:  see `execution.run_all`; seed, frames, runtime: override the study's own where not None
    record:         keep the recorded run of each trial, in `runs` of the study's folder; not on a cluster
    resume:         continue in the folder `out`, without repeating finished trials

    Each trial is stored when it is finished. Raises Interrupted on Ctrl-C; the study can then be resumed.
    """
    execution.require(jobs, cluster)
    if record and cluster is not None:
        raise ConfigurationError("--record: runs are kept on the machine that runs them: expected no --cluster")
    console = console or Console(quiet=True)
    if slower := kernels.notice():
        console.print(slower, style="yellow", markup=False, highlight=False, soft_wrap=True)
    seed = study.seed if seed is None else seed
    runtime = runtime or (study.runtime if study.trials else None) or "inproc"
    trials = plan.trials(study, count=count, seed=seed, frames=frames or study.frames, runtime=runtime)
    trials = [replace(trial, allow_failures=allow_failures) for trial in trials]
    store = Store.create(out, study, resume=resume)
    if record:
        trials = [replace(trial, folder=str(store.run_folder(trial))) for trial in trials]
    failures: dict[str, str] = {}
    pending = [trial for trial in trials if not resume or store.load(trial) is None or not store.is_kept(trial)]
    if len(pending) < len(trials):
        console.print(f"{len(trials) - len(pending)} of {len(trials)} trials are already done", highlight=False)
    hint = f"finished trials are kept: to continue, repeat the command with --out {store.folder} --resume"
    with ending.status_written(lambda status: store.write_status(study, trials, failures, status)):
        try:
            _run_trials(store, pending, failures, jobs, cluster, console)
            finished = tables.write(study, store, trials, failures)
        except (KeyboardInterrupt, OSError) as caught:
            raise ending.with_hint(caught, hint) from None
    if failures:
        store.write_status(study, trials, failures, "failed")
    return finished


def _run_trials(
    store: Store, pending: Sequence[Trial], failures: dict[str, str], jobs: int, cluster: str | None, console: Console
) -> None:
    """Run trials and store their outcomes, with a progress bar."""
    if not pending:
        return
    columns = [TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()]
    with (
        Progress(*columns, TextColumn("left"), TimeRemainingColumn(), console=console) as progress,
        closing(execution.run_all(pending, jobs=min(jobs, len(pending)), cluster=cluster)) as outcomes,
    ):
        bar = progress.add_task("trials", total=len(pending))
        for outcome in outcomes:
            trial = outcome.trial
            if outcome.error:
                failures[trial.digest] = outcome.error
            else:
                store.save(outcome)
            if problem := outcome.error or outcome.warning:
                kind = "failed" if outcome.error else "warning"
                line = f"{kind}: {trial.configuration}, {trial.scene}, seed {trial.seed}: {problem}"
                progress.console.print(line, style="yellow", markup=False, highlight=False)
            progress.advance(bar)
