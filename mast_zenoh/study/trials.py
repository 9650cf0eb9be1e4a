"""Plans, runs, stores and resumes the trials of a study."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from mast_zenoh import kernels, scenario, scenes
from mast_zenoh.config import registry
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.errors import ConfigurationError, MastError, plural
from mast_zenoh.integrity.calibration import refuse_calibration_data
from mast_zenoh.scenario.timeline import attack_starts
from mast_zenoh.study import execution, tables
from mast_zenoh.study import trial as identity
from mast_zenoh.study.definition import Study
from mast_zenoh.study.store import Store, status_written
from mast_zenoh.study.tables import StudyResult
from mast_zenoh.study.trial import Trial, TrialOutcome


def run(
    study: Study,
    out: Path | None = None,
    *,
    count: int,
    jobs: int = 1,
    cluster: str | None = None,
    resume: bool = False,
    allow_failures: bool = False,
    record: bool = False,
    console: Console | None = None,
) -> StudyResult:
    """Run every configuration in every scene with `count` seeds, and write the tables.

    allow_failures: whether a trial counts even if handlers of its nodes failed
    jobs, cluster:  see `execution.workers`
    record:         keep the recorded run of each trial, in `runs` of the study's folder; not on a cluster
    resume:         continue in the folder `out`, without repeating finished trials

    Each trial is stored when it is finished. Raises Interrupted on Ctrl-C; the study can then be resumed.
    """
    console = console or Console(quiet=True)
    check_environment(console, jobs, cluster, record=record)
    with console.status(
        f"checking {plural(len(study.configurations), 'configuration')} in {plural(len(study.scenes), 'scene')}"
    ):
        trials = plan(study, count=count, allow_failures=allow_failures)
    if study.has_own_kind:
        study.new_kind(range(study.seed, study.seed + count)).rehearse()
    store = Store.create(out, study, resume=resume)
    store.refuse_other(study, trials)
    if record:
        trials = [replace(trial, folder=str(store.run_folder(trial))) for trial in trials]
    failures: dict[str, str] = {}
    left_out: list[str] = []
    pending = [trial for trial in trials if not resume or store.load(trial) is None or not store.is_kept(trial)]
    report_misplaced(store, console)
    if len(pending) < len(trials):
        console.print(f"{len(trials) - len(pending)} of {len(trials)} trials are already done", highlight=False)

    def write_status(status: str) -> None:
        store.write_status(study, trials, failures, status, left_out)

    with status_written(store.status_file, write_status, how_to_continue(store)):
        if pending:
            with (
                progress_bars(console) as progress,
                execution.workers(min(jobs, len(pending)), cluster) as run_trials,
                closing(run_trials(pending)) as outcomes,
            ):
                bar = progress.add_task("trials", total=len(pending))
                keep(rehearsed(outcomes, study, count, console), store, failures, progress, bar)
        finished = tables.write(study, store, trials, failures)
        left_out += finished.facts.left_out
        return finished


def check_environment(console: Console, jobs: int, cluster: str | None, *, record: bool) -> None:
    """Raise ConfigurationError for what is not possible here; say that kernels are not compiled."""
    execution.require(jobs, cluster)
    if record and cluster is not None:
        raise ConfigurationError("--record: runs are kept on the machine that runs them: expected no --cluster")
    if slower := kernels.notice():
        console.print(slower, style="yellow", markup=False, highlight=False, soft_wrap=True)


def report_misplaced(store: Store, console: Console) -> None:
    """Say which files hold another trial than their name says."""
    if store.misplaced:
        text = f"{', '.join(sorted(store.misplaced))}: of another trial than the name says: it is run again"
        console.print(f"warning: {text}", style="yellow", markup=False, highlight=False, soft_wrap=True)
    store.misplaced.clear()


def how_to_continue(store: Store) -> str:
    """What to do after an interruption."""
    return f"finished trials are kept: to continue, repeat the command with --out {store.folder} --resume"


def progress_bars(console: Console) -> Progress:
    """Progress bars of trials."""
    columns = [TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()]
    return Progress(*columns, TextColumn("left"), TimeRemainingColumn(), console=console)


def rehearsed(outcomes: Iterable[TrialOutcome], study: Study, count: int, console: Console) -> Iterator[TrialOutcome]:
    """Pass outcomes on; try the results of a user's kind with the first one, and say what would be left out.

    Raises what `Kind.rehearse` raises.
    """
    untried = study.has_own_kind
    for outcome in outcomes:
        yield outcome
        if untried and not outcome.error:
            untried = False
            for problem in study.new_kind(range(study.seed, study.seed + count)).rehearse(outcome):
                line = f"warning: of the first trial alone, {problem}: if this remains so, it is left out"
                console.print(line, style="yellow", markup=False, highlight=False, soft_wrap=True)


def keep(
    outcomes: Iterable[TrialOutcome], store: Store, failures: dict[str, str], progress: Progress, bar: TaskID
) -> None:
    """Store the outcomes of trials as they complete; failures: gets the error of each that failed, by digest."""
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


def plan(study: Study, *, count: int, allow_failures: bool = False) -> list[Trial]:
    """One trial per configuration, scene and seed, grouped by scene and seed.

    count: number of seeds, from the study's own on
    allow_failures: whether a trial counts even if handlers of its nodes failed

    Every configuration is resolved in every scene with the first seed. Raises what `scenario.load` and
    `scenario.resolve` raise, and ConfigurationError for a study of a shipped kind on calibration data, or of any
    kind with an attack that begins after the end.
    """
    seed, frames, runtime = study.seed, study.frames, study.runtime or "inproc"
    by_seed: list[list[Trial]] = [[] for _ in range(count)]
    result = []
    for study_scene in study.scenes:
        for seed_trials in by_seed:
            seed_trials.clear()
        for configuration in study.configurations:
            common = (*study_scene.settings, *configuration.settings)
            settings = (*common, *study.trial_settings(seed, frames))
            try:
                path, loaded = scenario.load(configuration.scenario, settings)
                resolved = scenario.resolve(path, loaded, seed=seed, frames=frames)
            except MastError as error:
                raise type(error)(f"{study.path}: {configuration.label}: {error}") from None
            scene = registry.build(resolved.scene, scenes.Scene, f"{path}: scene")
            if study.kind and not study.has_own_kind:
                refuse_calibration_data(range(seed, seed + count), resolved.scene, str(study.path))
            environment = identity.environment(resolved.plugins.values())
            user_files = identity.user_files(path, study.path, (*resolved.modules, *study.kind_files))
            files = identity.files_key((*user_files, *scene.inputs()))
            idle = _idle_period(resolved)
            if study.kind and idle is not None:
                raise late_attack(study, configuration.label, idle)
            for index, seed_trials in enumerate(by_seed):
                if study.per_trial and index:
                    settings = (*common, *study.trial_settings(seed + index, frames))
                    _, loaded = scenario.load(configuration.scenario, settings)
                seed_trials.append(
                    Trial(
                        digest=identity.digest_of(
                            loaded, files, seed + index, frames, runtime, environment, evaluation=study.evaluation
                        ),
                        configuration=configuration.label,
                        scene=study_scene.label,
                        seed=seed + index,
                        scenario=configuration.scenario,
                        settings=settings,
                        frames=frames,
                        runtime=runtime,
                        scene_key=identity.scene_key(scene),
                        environment=tuple(sorted(environment.items())),
                        allow_failures=allow_failures,
                        idle=idle,
                        evaluation=study.evaluation,
                    )
                )
        result += [trial for seed_trials in by_seed for trial in seed_trials]
    return result


def late_attack(study: Study, label: str, idle: tuple[float, float]) -> ConfigurationError:
    """The error for a configuration whose attack never begins. idle: see `Trial`"""
    begins_s, ends_s = idle
    return ConfigurationError(
        f"{study.path}: the attack of {label!r} begins at {begins_s:g} s, and the trials end after {ends_s:g} s: "
        "expected more frames, or an earlier attack"
    )


def _idle_period(resolved: Resolved) -> tuple[float, float] | None:
    """(start of first attack, end of run), s, if the run ends before any attack.

    None if an attack starts in time, if there is none, or if an adversary's start is not known.
    """
    starts = attack_starts(resolved.nodes)
    timed = {name for names in starts.values() for name in names}
    if not timed or any(spec.role == "adversary" and name not in timed for name, spec in resolved.nodes.items()):
        return None
    first, end = min(start for _, start in starts), resolved.frames * resolved.period_ns * 1e-9
    return (first, end) if first >= end else None
