"""A study of many trials: carried out, kept, resumed, and summed up."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from mast_zenoh.errors import Interrupted, TrialsFailed
from mast_zenoh.launch import folder as run_folder
from mast_zenoh.report.study_rows import StudyRow
from mast_zenoh.study import execution, plan, results
from mast_zenoh.study.definition import Study
from mast_zenoh.study.store import Store, write_parquet
from mast_zenoh.study.trial import Outcome, Trial


@dataclass(frozen=True)
class Ended:
    """A study whose trials are done: its folder, its rows, the files written, and what failed (trial, reason)."""

    out: Path
    rows: list[StudyRow]
    files: list[Path]
    failed: list[tuple[Trial, str]]

    def raise_failures(self) -> None:
        """Raises TrialsFailed if any trial failed, with the command that runs each alone."""
        if self.failed:
            told = "\n".join(
                f"  {trial.configuration}, {trial.scene}, seed {trial.seed}: {reason}\n    {trial.command()}"
                for trial, reason in self.failed
            )
            raise TrialsFailed(f"{len(self.failed)} trials failed; each can be run alone:\n{told}")


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
    store.note(study, trials, failures, "running")
    todo = [trial for trial in trials if not resume or store.load(trial) is None]
    if len(todo) < len(trials):
        console.print(f"{len(trials) - len(todo)} of {len(trials)} trials are done already", highlight=False)
    try:
        _carry_out(store, todo, failures, jobs, cluster, console)
    except KeyboardInterrupt:
        store.note(study, trials, failures, "interrupted")
        raise Interrupted(
            f"stopped by Ctrl-C; what is done is kept: go on with the same command and --out {store.folder} --resume"
        ) from None
    done = [outcome for outcome in map(store.load, trials) if outcome is not None]
    rows, files = write_tables(study, store.folder, done, seed)
    store.note(study, trials, failures, "failed" if failures else "ok")
    failed = [(trial, failures[trial.digest]) for trial in trials if trial.digest in failures]
    return Ended(store.folder, rows, files, failed)


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


def write_tables(study: Study, folder: Path, done: Iterable[Outcome], seed: int) -> tuple[list[StudyRow], list[Path]]:
    """Write all tables and the figure of the trials that are done; returns their rows and the files."""
    from mast_zenoh.report import study_table  # drawing libraries are slow to load
    from mast_zenoh.report.study_figure import increments_figure

    done = list(done)
    found = results.values(done, study.baseline)
    rows = results.summarise(study, found, seed)
    files = [folder / name for name in ("results.parquet", "frames.parquet", "table.csv", "table.md", "table.tex")]
    write_parquet(files[0], run_folder.arrow_table(results.columns(found)))
    write_parquet(files[1], run_folder.arrow_table(results.frames(done)))
    texts = (
        study_table.as_csv(rows),
        study_table.as_markdown(rows, study.baseline),
        study_table.as_latex(rows, study.baseline),
    )
    for path, text in zip(files[2:], texts, strict=True):
        path.write_text(text, encoding="utf-8")
    picture = increments_figure(rows)
    if picture is not None:
        files.append(folder / "increments.png")
        files[-1].write_bytes(picture)
    return rows, files
