"""Writes the tables, figures and page of a study from its finished trials."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any

import pyarrow

from mast_zenoh.errors import TrialsFailed
from mast_zenoh.launch.tables import to_arrow
from mast_zenoh.metrics.study_results import FailedTrial, IdleAttack, StudyFacts, StudyRow
from mast_zenoh.run_files import write_bytes
from mast_zenoh.study import results
from mast_zenoh.study.defences.kinds import Collection, kind_named
from mast_zenoh.study.defences.study_files import StudyFiles
from mast_zenoh.study.definition import Study
from mast_zenoh.study.numbers import ACHIEVED
from mast_zenoh.study.parameters import ParameterColumns
from mast_zenoh.study.store import Store
from mast_zenoh.study.summary import Samples
from mast_zenoh.study.table_file import TableFile
from mast_zenoh.study.trial import Outcome, Trial


@dataclass(frozen=True)
class StudyResult:
    """A finished study with trials.

    rows: its estimates; facts: its configurations, seeds and versions; files: all files written; report: HTML page
    defences: tables and figures of a study of defences
    """

    out: Path
    rows: list[StudyRow]
    facts: StudyFacts
    files: list[Path]
    report: Path
    defences: StudyFiles | None = None

    def as_rich(self) -> Any:
        """The main tables for the terminal."""
        from mast_zenoh.report.tables import study as study_table

        if self.defences is not None:
            return self.defences.as_rich()
        return study_table.as_rich(self.rows, self.facts)

    def raise_failures(self) -> None:
        """Raises TrialsFailed if any trial failed, with the command that runs each alone."""
        failed = self.facts.failed
        if failed:
            lines = (f"  {f.configuration}, {f.scene}, seed {f.seed}: {f.error}\n    {f.command}" for f in failed)
            raise TrialsFailed(f"failed trials: {len(failed)}; each can be run alone:\n" + "\n".join(lines))


def write(study: Study, store: Store, trials: Sequence[Trial], failures: Mapping[str, str]) -> StudyResult:
    """Write all files of a study but study.json, from the trials that its folder has.

    trials:   those planned, all of one scene and seed together
    failures: by digest, the error of a trial that failed
    """
    from mast_zenoh.report import study_page  # drawing libraries are slow to load
    from mast_zenoh.report.figures.study import figures_over_trials
    from mast_zenoh.report.tables import study as study_table

    seeds = tuple(sorted({trial.seed for trial in trials}))
    collection = None
    if study.cells:
        collection = kind_named(study.evaluation).collect(study.cells, [scene.label for scene in study.scenes], seeds)
    done, rows = _write_parquet(study, store, trials, seeds, collection)
    facts = StudyFacts(
        name=study.name,
        baseline=study.baseline,
        configurations={item.label: (item.scenario, item.settings) for item in study.configurations},
        scenes=tuple(scene.label for scene in study.scenes),
        seeds=seeds,
        frames=trials[0].frames,
        runtime=trials[0].runtime,
        done=done,
        failed=tuple(_failed_trial(trial, failures[trial.digest]) for trial in trials if trial.digest in failures),
        environment=dict(trials[0].environment),
        other_scenes=_configurations_with_other_scenes(trials, study.baseline),
        idle=_idle_attacks(trials),
    )
    texts = {
        "table.csv": study_table.as_csv(rows, facts),
        "table.md": study_table.as_markdown(rows, facts),
        "table.tex": study_table.as_latex(rows, facts),
    }
    for name, text in texts.items():
        write_bytes(store.folder / name, text.encode())
    figures = {} if study.cells else figures_over_trials(rows, facts)
    for item in figures.values():
        item.save(store.folder)
    names = [
        "results.parquet",
        "frames.parquet",
        *texts,
        *(name for figure in figures.values() for name in figure.names),
    ]
    of_defences = None if collection is None else collection.write(store.folder)
    if of_defences is not None:
        figures = dict(of_defences.figures)
        names += of_defences.names
    report = study_page.write_page(store.folder, rows, facts, figures)
    return StudyResult(store.folder, rows, facts, [store.folder / name for name in names], report, of_defences)


def _write_parquet(
    study: Study, store: Store, trials: Sequence[Trial], seeds: Sequence[int], collection: Collection | None
) -> tuple[Counter[str], list[StudyRow]]:
    """Write results.parquet and frames.parquet; add the trials to `collection`.

    Returns the numbers of finished trials by configuration, and the table rows.
    Only the trials of one scene and seed are in memory at a time.
    """
    trial_schema = to_arrow(results.columns(trials[0], [])).schema
    frame_schema = pyarrow.schema([*list(trial_schema)[:3], *store.frame_schema(trials)])
    per_trial, per_frame = (ParameterColumns(study, schema.names) for schema in (trial_schema, frame_schema))
    done: Counter[str] = Counter()
    samples = Samples(study, seeds)
    with (
        TableFile(store.folder / "results.parquet", per_trial.schema(trial_schema)) as trial_file,
        TableFile(store.folder / "frames.parquet", per_frame.schema(frame_schema)) as frame_file,
    ):
        for group in _by_scene_and_seed(store, trials):
            baseline = next((each for each in group if each.trial.configuration == study.baseline), None)
            for outcome in group:
                label = outcome.trial.configuration
                trial_numbers = results.values(outcome, baseline)
                attacked = outcome.trial.idle is None  # an attack that never began neither succeeded nor failed
                samples.add(
                    outcome, trial_numbers if attacked else [n for n in trial_numbers if n.estimator != ACHIEVED]
                )
                trial_file.append(per_trial.add(to_arrow(results.columns(outcome.trial, trial_numbers)), label))
                frame_file.append(per_frame.add(to_arrow(results.frames(outcome)), label))
                done[label] += 1
                if collection is not None:
                    collection.add(outcome)
    return done, samples.rows()


def _by_scene_and_seed(store: Store, trials: Sequence[Trial]) -> Iterator[list[Outcome]]:
    """The outcomes of the trials that are done, all of one scene and seed at a time."""
    for _, group in groupby(trials, key=lambda trial: (trial.scene, trial.seed)):
        yield [outcome for outcome in map(store.load, group) if outcome is not None]


def _configurations_with_other_scenes(trials: Sequence[Trial], baseline: str) -> tuple[str, ...]:
    """Configurations whose recording differs from the baseline's in the same scene."""
    reference = {trial.scene: trial.scene_key for trial in trials if trial.configuration == baseline}
    return tuple(dict.fromkeys(trial.configuration for trial in trials if trial.scene_key != reference[trial.scene]))


def _idle_attacks(trials: Sequence[Trial]) -> tuple[IdleAttack, ...]:
    """Configurations whose attack never began in some scene."""
    scenes = dict.fromkeys(trial.scene for trial in trials)
    periods_by_label: dict[str, dict[str, tuple[float, float]]] = {}
    for trial in trials:
        if trial.idle is not None:
            periods_by_label.setdefault(trial.configuration, {})[trial.scene] = trial.idle
    return tuple(
        IdleAttack(
            label,
            min(begin for begin, _ in periods.values()),
            max(end for _, end in periods.values()),
            tuple(periods) if len(periods) < len(scenes) else (),
        )
        for label, periods in periods_by_label.items()
    )


def _failed_trial(trial: Trial, error: str) -> FailedTrial:
    """A failed trial for the tables, its error on one line."""
    return FailedTrial(trial.configuration, trial.scene, trial.seed, " ".join(error.split()), trial.command())
