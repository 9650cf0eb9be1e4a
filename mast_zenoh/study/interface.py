"""Runs every configuration of a study once, or many trials of each: `mast_zenoh.study(…)`."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from rich.console import Console

from mast_zenoh import run_folder, scenario
from mast_zenoh.config.loading import OWN_RUN
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.errors import ConfigurationError, HandlerFailed, MastError
from mast_zenoh.launch import run as launcher
from mast_zenoh.launch import twin
from mast_zenoh.show.compare import as_text
from mast_zenoh.study import definition, execution
from mast_zenoh.study import trials as repeated_runs
from mast_zenoh.study.definition import DRIVEN, Configuration, Study
from mast_zenoh.study.finished import FinishedStudy
from mast_zenoh.study.store import new_folder, status_written
from mast_zenoh.study.tables import StudyResult
from mast_zenoh.study.trial import run_command


def carry_out(
    study: str | Path,
    *,
    trials: int | None = None,
    candidates: int | None = None,
    jobs: int | None = None,
    cluster: str | None = None,
    resume: bool = False,
    frames: int | None = None,
    seed: int | None = None,
    runtime: str = "inproc",
    out: str | Path | None = None,
    allow_failures: bool = False,
    record: bool = False,
    **parameters: Any,
) -> FinishedStudy:
    """Run a study, and return its tables.

    study:      name of a shipped study (`mast.list("studies")`), or a file
    parameters: arguments of the study's function
    trials:     seeds for each configuration and scene; None: the study's own number, or else one run per configuration
    candidates: how many choices of the parameters a search tries; None: the study's own number
    jobs:       trials at a time; None: the number of cores if dask is installed, else 1
    cluster:    address of a Dask scheduler, tcp://HOST:8786;  resume: continue the unfinished study in `out`
    record:     write every message; with trials, keep the run of each below `runs` of the study's folder
    frames, seed, runtime, out, allow_failures: as for `mast_zenoh.run`

    A script with more than one job needs `if __name__ == "__main__":`, as each worker imports it.

    Raises ConfigurationError before anything starts. Raises TrialsFailed or HandlerFailed if trials or runs failed;
    the results of the others are in the folder that the error names.
    """
    options = [name for name in inspect.signature(carry_out).parameters if name not in ("study", "parameters")]
    loaded = definition.load_values(str(study), parameters, options)
    if loaded.security:
        raise ConfigurationError(f"{loaded.path}: a security study runs only from the command line: mast study {study}")
    if runtime not in definition.RUNTIMES:
        raise ConfigurationError(f"runtime: found {runtime!r}, expected inproc or mesh")
    chosen: dict[str, Any] = {"frames": frames, "seed": seed, "runtime": runtime, "trials": trials}
    chosen |= {"candidates": candidates, "jobs": jobs, "cluster": cluster, "resume": resume}
    folder = None if out is None else Path(out)
    finished = run(loaded, folder, **chosen, record=record, allow_failures=allow_failures)
    if isinstance(finished, StudyResult):
        _raise(finished, finished.out)
        return FinishedStudy(finished.out, as_text(finished.as_rich()))
    from mast_zenoh.show.html import write_study_report  # drawing libraries are slow to load

    write_study_report(finished.out, finished.folders, driven=finished.drive())
    _raise(finished, finished.out)
    return FinishedStudy(finished.out)


def run(
    study: Study,
    out: Path | None,
    *,
    trials: int | None = None,
    jobs: int | None = None,
    cluster: str | None = None,
    resume: bool = False,
    candidates: int | None = None,
    seed: int | None = None,
    frames: int | None = None,
    runtime: str | None = None,
    **options: Any,
) -> ComparisonResult | StudyResult:
    """Run every configuration once, or trials of all if their number is given, or an option of trials; or search.

    candidates, trials, seed, frames, runtime: instead of the study's own
    options: of `run_once`, `trials.run` and `searching.run`
    Raises ConfigurationError for candidates of a study without a search.
    """
    if candidates is not None:
        study = with_candidates(study, candidates)
    count = trials or study.trials
    if count is None and not (jobs or cluster or resume):
        return run_once(study.chosen(seed=seed, frames=frames, runtime=runtime), out, **options)
    if study.trials is None:
        study = replace(study, runtime=None)  # which is that of single runs
    if study.search is None:
        play: Callable[..., StudyResult] = repeated_runs.run
    else:
        from mast_zenoh.study.search import searching  # other studies do without

        play = searching.run
    study, jobs = study.chosen(seed=seed, frames=frames, runtime=runtime), jobs or execution.default_jobs()
    return play(study, out, count=count or 1, jobs=jobs, cluster=cluster, resume=resume, **options)


def with_candidates(study: Study, count: int) -> Study:
    """The study with another number of candidates; raises ConfigurationError if it has no search."""
    if study.search is None:
        raise ConfigurationError(f"{study.path}: has no search, so no candidates: expected a study with a key `search`")
    if type(count) is not int or count < 1:
        raise ConfigurationError(f"candidates: found {count!r}, expected a whole number from 1")
    return replace(study, search=replace(study.search, candidates=count))


def _raise(finished: Any, folder: Path) -> None:
    """Raise the error of failed runs or trials, with the folder of the others."""
    try:
        finished.raise_failures()
    except MastError as error:
        error.add_note(f"The results of the others are in {folder}.")
        raise


@dataclass
class ComparisonResult:
    """A finished study: its folder, and the run of each configuration by label.

    driven: the run with drivers that is still to be run, see `drive`; None: none
    error: why that has no result; None: it has one, or has not been run
    """

    out: Path
    runs: dict[str, launcher.EndedRun]
    driven: Resolved | None = None
    error: MastError | None = None

    @property
    def folders(self) -> dict[str, Path]:
        """The run folder of each configuration."""
        return {label: finished.folder for label, finished in self.runs.items()}

    def drive(self) -> tuple[Path, Path] | None:
        """Run the run with drivers and its unattacked twin, in this process; their folders, None without a result.

        Its error is kept, so that the report of the other runs can be written first.
        """
        if self.driven is None:
            return None
        folder = self.out / DRIVEN
        try:
            ended = launcher.run(self.driven, folder, runtime="inproc")
            if ended.error:
                raise ended.error
            return folder, twin.of(folder, allowed=OWN_RUN)
        except MastError as error:
            self.error = error
            return None

    def raise_failures(self) -> None:
        """Raises HandlerFailed if handlers failed in any run and that was not allowed, or the error of `drive`."""
        failed = [f"in run {label}, {finished.error}" for label, finished in self.runs.items() if finished.error]
        if failed:
            raise HandlerFailed("\n".join(failed))
        if self.error:
            raise self.error


def run_once(
    study: Study,
    out: Path | None = None,
    *,
    allow_failures: bool = False,
    record: bool = False,
    console: Console | None = None,
) -> ComparisonResult:
    """Run every configuration once, in the first scene, in its own run folder.

    All configurations are resolved and validated before the first run starts.
    record: write every message to messages.mcap
    If a run fails, its error is raised after its run folder has been written. Failed handlers do not stop the other
    runs: `ComparisonResult.raise_failures` raises their error.
    """
    resolved = {each.label: _resolve(study, each, study.frames, record) for each in study.configurations}
    driven = _resolve_driven(study)
    folder = new_folder(out, study.name)
    status_file, runs = folder / "study.json", dict[str, launcher.EndedRun]()
    runtime = study.runtime or "mesh"

    def write_status(status: str) -> None:
        run_folder.write_json(status_file, {"name": study.name, "status": status, "runs": list(runs)})

    with status_written(status_file, write_status):
        for configuration in study.configurations:
            label = configuration.label
            settings = (*study.scenes[0].settings, *configuration.settings)
            command = run_command(configuration.scenario, settings, study.seed, study.frames)
            finished = launcher.run(
                resolved[label],
                folder / label,
                command=[*command, "--runtime", runtime, *([] if record else ["--no-record"])],
                runtime=runtime,
                allow_failures=allow_failures,
                console=console,
            )
            if finished.error and not isinstance(finished.error, HandlerFailed):
                raise finished.error
            runs[label] = finished
    return ComparisonResult(folder, runs, driven)


def _resolve_driven(study: Study) -> Resolved | None:
    """The resolved run with drivers; None: the study has none."""
    if study.driven is None:
        return None
    limits = [limit for limit in (study.frames, study.driven.frames) if limit is not None]
    return _resolve(study, study.driven.configuration, min(limits, default=None), record=True)


def _resolve(study: Study, configuration: Configuration, frames: int | None, record: bool) -> Resolved:
    """The fully resolved run of one configuration."""
    file, loaded = scenario.load(configuration.scenario, (*study.scenes[0].settings, *configuration.settings))
    content = loaded | {"name": configuration.label}
    return scenario.resolve(file, content, seed=study.seed, frames=frames, record=record)
