"""A study of many trials: carried out, kept, and resumed."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from mast_zenoh.launch import ending
from mast_zenoh.study import execution, plan, tables
from mast_zenoh.study.definition import Study
from mast_zenoh.study.store import Store
from mast_zenoh.study.tables import Ended
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
    console: Console | None = None,
) -> Ended:
    """Run every configuration in every scene with `count` seeds, and write the tables.

    allow_failures: whether a trial counts although handlers of its nodes failed; otherwise it has failed
    jobs, cluster: see `execution.carry_out`; seed, frames, runtime: win over the study's own where not None
    resume:        go on with the folder `out`: what is done there is not run again

    Each trial is written when it is done. Raises Interrupted on Ctrl-C: what is done is kept, to be resumed.
    """
    execution.require(jobs, cluster)
    console = console or Console(quiet=True)
    seed = study.seed if seed is None else seed
    runtime = runtime or (study.runtime if study.trials else None) or "inproc"
    trials = plan.trials(study, count=count, seed=seed, frames=frames or study.frames, runtime=runtime)
    trials = [replace(trial, allow_failures=allow_failures) for trial in trials]
    store = Store.create(out, study, resume=resume)
    failures: dict[str, str] = {}
    todo = [trial for trial in trials if not resume or store.load(trial) is None]
    if len(todo) < len(trials):
        console.print(f"{len(trials) - len(todo)} of {len(trials)} trials are done already", highlight=False)
    hint = f"what is done is kept: go on with the same command and --out {store.folder} --resume"
    with ending.written(lambda status: store.note(study, trials, failures, status)):
        try:
            _carry_out(store, todo, failures, jobs, cluster, console)
            ended = tables.write(study, store, trials, failures)
        except (KeyboardInterrupt, OSError) as caught:
            raise ending.explained(caught, hint) from None
    if failures:
        store.note(study, trials, failures, "failed")
    return ended


def _carry_out(
    store: Store, todo: Sequence[Trial], failures: dict[str, str], jobs: int, cluster: str | None, console: Console
) -> None:
    """Run trials and keep what comes of them, under a progress bar."""
    if not todo:
        return
    columns = [TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()]
    with (
        Progress(*columns, TextColumn("left"), TimeRemainingColumn(), console=console) as progress,
        closing(execution.carry_out(todo, jobs=min(jobs, len(todo)), cluster=cluster)) as outcomes,
    ):
        bar = progress.add_task("trials", total=len(todo))
        for outcome in outcomes:
            trial = outcome.trial
            if outcome.error:
                failures[trial.digest] = outcome.error
            else:
                store.save(outcome)
            if problem := outcome.error or outcome.warning:
                what = "failed" if outcome.error else "warning"
                line = f"{what}: {trial.configuration}, {trial.scene}, seed {trial.seed}: {problem}"
                progress.console.print(line, style="yellow", markup=False, highlight=False)
            progress.advance(bar)
