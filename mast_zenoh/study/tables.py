"""Writes the tables, figures and page of a study from its finished trials."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow

from mast_zenoh.arrays.states import Floats
from mast_zenoh.errors import ConfigurationError, TrialsFailed
from mast_zenoh.metrics.study_results import FailedTrial, IdleAttack, Row, Statistic, StudyFacts, StudySeries
from mast_zenoh.run_folder.tables import to_arrow
from mast_zenoh.study import numbers, statistics
from mast_zenoh.study.defences import kinds
from mast_zenoh.study.definition import Study
from mast_zenoh.study.numbers import ACHIEVED, COMPROMISED, COOPERATION, DEFENCE, DRIVEN, NAN, Number, ego
from mast_zenoh.study.store import Store, table_writer
from mast_zenoh.study.trial import Trial, TrialOutcome

if TYPE_CHECKING:
    from mast_zenoh.show.figures.drawing import RenderedFigure

Value = int | float | str


@dataclass(frozen=True)
class StudyResult:
    """A finished study with trials.

    rows: its estimates; facts: its configurations, seeds and versions; files: all files written; report: HTML page
    figures: those on the page, by name
    own: tables and figures of a study of defences, or of a search, which the terminal shows instead
    """

    out: Path
    rows: list[Row]
    facts: StudyFacts
    files: list[Path]
    report: Path
    figures: Mapping[str, RenderedFigure]
    own: kinds.StudyFiles | None = None

    def as_rich(self) -> Any:
        """The main tables for the terminal."""
        from mast_zenoh.show.tables import study as study_table

        if self.own is not None and self.own.tables is not None:
            return self.own.tables.as_rich()
        return study_table.as_rich(self.rows, self.facts)

    def raise_failures(self) -> None:
        """Raises TrialsFailed if any trial failed, with the command that runs each alone.

        Raises ConfigurationError if results of the study's kind are left out.
        """
        if self.facts.failed:
            raise trials_failed(self.facts.failed)
        if self.facts.left_out:
            reasons = "\n".join(f"  {each}" for each in self.facts.left_out)
            todo = f"repair it, and repeat the command with --out {self.out} --resume"
            raise ConfigurationError(f"left out of the results, of which all trials are kept: {todo}:\n{reasons}")


def trials_failed(failed: Sequence[FailedTrial]) -> TrialsFailed:
    """The error for trials that failed, with the command that runs each alone."""
    lines = (f"  {f.configuration}, {f.scene}, seed {f.seed}: {f.error}\n    {f.command}" for f in failed)
    return TrialsFailed(f"failed trials: {len(failed)}; each can be run alone:\n" + "\n".join(lines))


def write(
    study: Study,
    store: Store,
    trials: Sequence[Trial],
    failures: Mapping[str, str],
    searched: kinds.StudyFiles | None = None,
) -> StudyResult:
    """Write all files of a study but study.json, from the trials that its folder has.

    trials:   those planned, all of one scene and seed together
    failures: by digest, the error of a trial that failed
    searched: what a search has written before
    """
    from mast_zenoh.show.figures.study import figures_over_trials
    from mast_zenoh.show.html import write_trials_page  # drawing libraries are slow to load
    from mast_zenoh.show.tables import study as study_table

    seeds = tuple(sorted({trial.seed for trial in trials}))
    scenes = tuple(scene.label for scene in study.scenes)
    kind = study.new_kind(seeds) if study.kind else None
    done, samples = _write_parquet(study, store, trials, seeds, kind)
    rows = samples.rows()
    own = kind.write(store.folder) if kind else searched
    facts = StudyFacts(
        name=study.name,
        baseline=study.baseline,
        configurations={item.label: (item.scenario, item.settings) for item in study.configurations},
        scenes=scenes,
        seeds=seeds,
        frames=trials[0].frames,
        runtime=trials[0].runtime,
        done=done,
        failed=tuple(failed_trial(trial, failures[trial.digest]) for trial in trials if trial.digest in failures),
        environment=dict(pair for trial in trials for pair in trial.environment),
        other_scenes=_configurations_with_other_scenes(trials, study.baseline),
        idle=_idle_attacks(trials),
        left_out=tuple(own.left_out) if own else (),
        ego=samples.ego,
        own=samples.own,
    )
    texts = {
        "table.csv": study_table.as_csv(rows, facts),
        "table.md": study_table.as_markdown(rows, facts),
        "table.tex": study_table.as_latex(rows, facts),
    }
    figures: Mapping[str, RenderedFigure] = {} if kind else figures_over_trials(rows, facts)
    names = ["results.parquet", "frames.parquet", *kinds.write_files(store.folder, texts, figures)]
    if own is not None:
        figures = {**own.figures, **figures}
        names += own.names
    shown = own.tables if own is not None and own.on_page else None
    parts = (shown.tables, shown.headline, shown.reading) if shown else ()
    report = write_trials_page(store.folder, rows, facts, figures, *parts)
    return StudyResult(store.folder, rows, facts, [store.folder / name for name in names], report, figures, own)


def _write_parquet(
    study: Study, store: Store, trials: Sequence[Trial], seeds: Sequence[int], kind: kinds.Kind | None
) -> tuple[Counter[str], Samples]:
    """Write results.parquet and frames.parquet; add the trials to `kind`.

    Returns the numbers of finished trials by configuration, and their numbers.
    Only the trials of one scene and seed are in memory at a time.
    """
    no_number = to_arrow(numbers.columns(trials[0], []))
    no_frame = pyarrow.schema([*list(no_number.schema)[:3], *store.frame_schema(trials)]).empty_table()
    per_trial, per_frame = (ParameterColumns(study, table.column_names) for table in (no_number, no_frame))
    done: Counter[str] = Counter()
    samples = Samples(study, seeds)
    with (
        table_writer(store.folder / "results.parquet", per_trial.add(no_number, "").schema) as trial_file,
        table_writer(store.folder / "frames.parquet", per_frame.add(no_frame, "").schema) as frame_file,
    ):
        for group in _by_scene_and_seed(store, trials):
            baseline = next((each for each in group if each.trial.configuration == study.baseline), None)
            for outcome in group:
                label = outcome.trial.configuration
                with store.naming(outcome.trial):
                    trial_numbers, of_frames = [*numbers.values(outcome, baseline)], to_arrow(numbers.frames(outcome))
                attacked = outcome.trial.idle is None  # an attack that never began neither succeeded nor failed
                samples.add(
                    outcome, trial_numbers if attacked else [n for n in trial_numbers if n.estimator != ACHIEVED]
                )
                if kind is not None:
                    trial_numbers += numbers.of_kind(kind.name, kind.add(outcome))
                trial_file.append(per_trial.add(to_arrow(numbers.columns(outcome.trial, trial_numbers)), label))
                frame_file.append(per_frame.add(of_frames, label))
                done[label] += 1
    return done, samples


class Samples:
    """The reported numbers, by configuration.

    Of the ego, driven cars, compromised agents, achievements, the defence, pictures and the channel.

    ego: name of the agent whose estimates are scored;  own: users' metrics, `own_metrics` of metrics.json
    """

    def __init__(self, study: Study, seeds: Sequence[int]) -> None:
        """seeds: the planned seeds of every configuration and scene."""
        self._study = study
        self._scene = {scene.label: index for index, scene in enumerate(study.scenes)}
        self._seed = {seed: index for index, seed in enumerate(seeds)}
        self._cells: dict[str, dict[StudySeries, Floats]] = {each.label: {} for each in study.configurations}
        self._rates: set[StudySeries] = set()
        self.own: dict[str, Any] = {}
        self.ego = "ego"
        self._trials: Counter[str] = Counter()

    def add(self, outcome: TrialOutcome, trial_numbers: Iterable[Number]) -> None:
        """Add the numbers of a trial, `numbers.values`."""
        trial = outcome.trial
        if not self._trials:
            self.ego = ego(outcome.metrics)
        agent = self.ego
        self._trials[trial.configuration] += 1
        self.own |= outcome.metrics.get("own_metrics", {})
        cell = self._scene[trial.scene], self._seed[trial.seed]
        cells = self._cells[trial.configuration]
        for number in trial_numbers:
            if not numbers.has_mean(number.estimator, number.metric):
                continue
            of_all = number.metric in COOPERATION.get(number.estimator, ())
            if number.owner in (agent, COMPROMISED) or number.estimator in (ACHIEVED, DEFENCE, DRIVEN) or of_all:
                series = StudySeries("" if number.owner == agent else number.owner, number.estimator, number.metric)
                if series not in cells:
                    cells[series] = np.full((3, len(self._scene), len(self._seed)), NAN)
                cells[series][:, *cell] = number.value, number.std, number.frames
                if number.binary:
                    self._rates.add(series)

    def rows(self) -> list[Row]:
        """A row per configuration."""
        return [
            Row(
                {"configuration": configuration.label, **dict(configuration.point)},
                self._trials[configuration.label],
                {
                    series: _estimate(series, *cell, rate=series in self._rates, own=self.own)
                    for series, cell in self._cells[configuration.label].items()
                },
            )
            for configuration in self._study.configurations
        ]


def _estimate(
    series: StudySeries, values: Floats, stds: Floats, frames: Floats, *, rate: bool, own: Mapping[str, Any]
) -> Statistic:
    """The estimate of a series from arrays (scenes, seeds).

    NaN where a trial has no value.

    Statistics over frames use all trials. Statistics over trials use the seeds that have a value in every scene with
    any value. Bounds are clipped to the possible range of the metric.
    """
    pooled = ~np.isnan(values) & ~np.isnan(stds) & (frames > 0)
    over_frames = [statistics.Moments(*each) for each in zip(frames[pooled], values[pooled], stds[pooled], strict=True)]
    mean, std = statistics.pooled_moments(over_frames)
    bounds = statistics.value_range(series, own)
    estimate = statistics.trial_estimate(values, bounds, rate=rate, paired=series.metric.endswith("_iob"))
    return estimate._replace(mean=mean if over_frames else estimate.value, std=std)


def _by_scene_and_seed(store: Store, trials: Sequence[Trial]) -> Iterator[list[TrialOutcome]]:
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


def failed_trial(trial: Trial, error: str) -> FailedTrial:
    """A failed trial for the tables, its error on one line."""
    return FailedTrial(trial.configuration, trial.scene, trial.seed, " ".join(error.split()), trial.command())


def parameters(study: Study) -> dict[str, dict[str, Value]]:
    """The values of each parameter of a grid, and of each factor, by configuration label; without those that are None.

    A parameter whose values are not all numbers has text. Configurations of runs that do not sweep the parameter are
    absent.
    """
    result: dict[str, dict[str, Any]] = {}
    for configuration in study.configurations:
        for name, value in (dict(configuration.point) | configuration.factors).items():
            if value is not None:
                result.setdefault(name, {})[configuration.label] = value
    return {
        name: values
        if all(isinstance(value, (int, float)) and not isinstance(value, bool) for value in values.values())
        else {label: str(value) for label, value in values.items()}
        for name, values in result.items()
    }


class ParameterColumns:
    """Inserts a column per parameter after a table's first column.

    Values are null where a parameter does not apply. A parameter with the same name as one of the table's columns
    (user-defined metrics add columns) becomes `grid.<name>`.
    """

    def __init__(self, study: Study, reserved: Collection[str]) -> None:
        """reserved: names of the table's own columns."""
        self._values = {
            f"grid.{name}" if name in reserved else name: column for name, column in parameters(study).items()
        }
        self._types = {name: pyarrow.array(list(column.values())).type for name, column in self._values.items()}

    def add(self, table: pyarrow.Table, configuration: str) -> pyarrow.Table:
        """`table` with the parameter columns added; all its rows belong to one configuration."""
        for position, name in enumerate(self._values, 1):
            value = pyarrow.scalar(self._values[name].get(configuration), self._types[name])
            column = pyarrow.repeat(value, len(table))
            text = pyarrow.types.is_string(column.type)
            table = table.add_column(position, name, column.dictionary_encode() if text else column)
        return table
