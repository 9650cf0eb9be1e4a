"""Carries out a search, then measures its result on seeds that it has not seen.

The search plays every candidate with its own seeds, the first of the study. What it finds becomes a configuration of
the study, whose trials have the seeds after those. So the numbers of the study are as valid as those of any other.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import Progress, TaskID

from mast_zenoh import scenario
from mast_zenoh.arrays.states import Floats
from mast_zenoh.attacks import Attack, Coordination
from mast_zenoh.config import loading
from mast_zenoh.config.registry import known_types
from mast_zenoh.errors import ConfigurationError
from mast_zenoh.launch import ending
from mast_zenoh.metrics.search_results import CandidateRow, SearchResults, SearchRow
from mast_zenoh.study import execution, numbers, statistics, tables, trials
from mast_zenoh.study.definition import Configuration, Study, settings_of
from mast_zenoh.study.numbers import NAN, ego
from mast_zenoh.study.search import files, proposals
from mast_zenoh.study.search.plan import CANDIDATE, SEARCHED, SearchPlan
from mast_zenoh.study.search.proposals import Candidate, Effort
from mast_zenoh.study.search.space import value_at
from mast_zenoh.study.store import Store, status_written
from mast_zenoh.study.tables import StudyResult
from mast_zenoh.study.trial import Outcome, Trial, TrialKey


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
    """Search, run the result and the study's configurations with `count` held-out seeds, and write the tables.

    The arguments are those of `trials.run`; record: keep the runs of held-out trials

    The candidates, and so all numbers, are the same for any number of jobs, and after interruptions. Raises
    TrialsFailed if a trial of the search failed: the values that later candidates depend on would be incomplete.
    Raises ConfigurationError for an invalid study, before the first trial; for an unknown objective, after the first
    ones; and if Optuna is not installed.
    """
    if study.search is None:
        raise ConfigurationError(f"{study.path}: search: missing, expected a study with this key")
    version = proposals.require()
    console = console or Console(quiet=True)
    trials.check_environment(console, jobs, cluster, record=record)
    seed = study.seed if seed is None else seed
    how = Conditions(seed, frames or study.frames, runtime or study.runtime or "inproc", allow_failures)
    check_ranges(study, how)
    store = Store.create(out, study, resume=resume)
    state = _State(study)

    def write_status(status: str) -> None:
        store.write_status(state.study, state.planned, state.failures, status)

    with status_written(store.status_file, write_status):
        try:
            with trials.progress_bars(console) as progress, ExitStack() as stack:
                runs = Runs(state, store, how, Workers(jobs, cluster, stack), progress)
                search = Search(study.search, runs)
                found = search.run()
                held_out = replace(study, configurations=(*study.configurations, configuration(study, found, SEARCHED)))
                state.study = held_out
                todo = how.plan(held_out, count, seed + study.search.seeds)
                if record:
                    todo = [replace(trial, folder=str(store.run_folder(trial))) for trial in todo]
                runs.run(todo, progress.add_task("held-out trials", total=len(todo)))
            results = measure(held_out, search, store, todo, f"{study.search.sampler} (Optuna {version})")
            finished = tables.write(held_out, store, todo, state.failures, files.write(store.folder, results))
        except (KeyboardInterrupt, OSError) as caught:
            raise ending.with_hint(caught, trials.how_to_continue(store)) from None
    return finished


@dataclass(frozen=True, slots=True)
class Conditions:
    """What is equal for all trials; seed: the first of the search."""

    seed: int
    frames: int | None
    runtime: str
    allow_failures: bool

    def plan(self, study: Study, count: int, seed: int) -> list[Trial]:
        """The trials of a study, with `count` seeds from `seed` on."""
        return trials.plan(
            study,
            count=count,
            seed=seed,
            frames=self.frames,
            runtime=self.runtime,
            allow_failures=self.allow_failures,
        )


@dataclass(slots=True)
class _State:
    """What study.json says at any time: the study, its planned trials up to then, and the errors of failed ones."""

    study: Study
    planned: list[Trial] = field(default_factory=list)
    failures: dict[str, str] = field(default_factory=dict)


class Workers:
    """Runs trials; workers start with the first trial, and stop at the end of the block of `stack`."""

    def __init__(self, jobs: int, cluster: str | None, stack: ExitStack) -> None:
        self._jobs, self._cluster, self._stack = jobs, cluster, stack
        self._run_trials: execution.RunTrials | None = None

    def run_trials(self, pending: Sequence[Trial]) -> Any:
        """The outcomes of trials; see `execution.RunTrials`."""
        if self._run_trials is None:
            self._run_trials = self._stack.enter_context(execution.workers(self._jobs, self._cluster))
        return self._run_trials(pending)


class Runs:
    """The trials of a search: run, or taken from the study's folder if they are there."""

    def __init__(self, state: _State, store: Store, how: Conditions, workers: Workers, progress: Progress) -> None:
        self.study, self.how, self.progress = state.study, how, progress
        self._state, self._store, self._workers = state, store, workers

    def outcomes(self, configurations: Sequence[Configuration], count: int, bar: TaskID) -> list[list[Outcome]]:
        """For each configuration, the outcomes of all scenes with the first `count` seeds of the search.

        Raises TrialsFailed if any trial failed.
        """
        planned = [self._plan(configuration, count) for configuration in configurations]
        todo = [trial for each in planned for trial in each]
        self.run(todo, bar)
        if failed := [trial for trial in todo if trial.digest in self._state.failures]:
            error = tables.trials_failed([tables.failed_trial(t, self._state.failures[t.digest]) for t in failed])
            raise type(error)(f"{error}\nThe search stops there; {trials.how_to_continue(self._store)}")
        return [[self._loaded(trial) for trial in each] for each in planned]

    def run(self, todo: Sequence[Trial], bar: TaskID) -> None:
        """Run the trials that are not done, each once, and store their outcomes."""
        known = {(trial.digest, trial.configuration) for trial in self._state.planned}
        self._state.planned += [trial for trial in todo if (trial.digest, trial.configuration) not in known]
        missing = {
            trial.digest: trial for trial in todo if self._store.load(trial) is None or not self._store.is_kept(trial)
        }
        trials.report_misplaced(self._store, self.progress.console)
        self.progress.advance(bar, len(todo) - len(missing))
        if missing:
            with closing(self._workers.run_trials(list(missing.values()))) as outcomes:
                trials.keep(outcomes, self._store, self._state.failures, self.progress, bar)

    def _plan(self, configuration: Configuration, count: int) -> list[Trial]:
        of_one = replace(self.study, configurations=(configuration,))
        return self.how.plan(of_one, count, self.how.seed)

    def _loaded(self, trial: Trial) -> Outcome:
        outcome = self._store.load(trial)
        if outcome is None:
            raise OSError(f"{self._store.folder}: the outcome of a finished trial cannot be read: {trial.command()}")
        return outcome


class Search:
    """One search; after `run`, its candidates, and its values of the baseline and of the default."""

    def __init__(self, plan: SearchPlan, runs: Runs) -> None:
        self.plan, self.runs = plan, runs
        self.candidates: list[Candidate] = []
        #: by label of configuration, the objective's mean on the search's seeds
        self.values: dict[str, float] = {}
        self._baseline: dict[TrialKey, Outcome] = {}

    def run(self) -> Candidate:
        """The best candidate."""
        plan, study = self.plan, self.runs.study
        trials_of_each = len(study.scenes) * plan.seeds
        bar = self.runs.progress.add_task("search", total=(plan.candidates + 2) * trials_of_each)
        self._play_references(bar)
        effort = Effort(plan.candidates, plan.batch, self.runs.how.seed, plan.sampler, plan.maximise)
        self.candidates = proposals.search(plan.space, effort, lambda batch: self._evaluate(batch, bar))
        best = proposals.best_of(self.candidates, maximise=plan.maximise)
        if best is None:
            raise ConfigurationError(
                f"search.objective: {plan.objective.text!r} has no value for any of {len(self.candidates)} candidates, "
                "expected a number that every trial has"
            )
        self.values[SEARCHED] = best.value
        return best

    def _play_references(self, bar: TaskID) -> None:
        """Play the baseline and the default; the first trials tell whether the objective exists."""
        study = self.runs.study
        pair = [_configuration_of(study, label) for label in (study.baseline, self.plan.run)]
        unattacked, attacked = (outcomes[0] for outcomes in self.runs.outcomes(pair, 1, bar))
        if attacked.trial.idle is not None:
            raise trials.late_attack(study, self.plan.run, attacked.trial.idle)
        agent = ego(attacked.metrics)
        self.plan.objective.check(numbers.values(attacked, unattacked), agent, f"{study.path}: search.objective")
        self.runs.progress.advance(bar, -2 * len(study.scenes))  # they are among those of all seeds
        of_baseline, of_default = self.runs.outcomes(pair, self.plan.seeds, bar)
        self._baseline = {outcome.trial.key: outcome for outcome in of_baseline}
        self.values = {study.baseline: self._mean(of_baseline), self.plan.run: self._mean(of_default)}

    def _evaluate(self, batch: Sequence[Candidate], bar: TaskID) -> list[float]:
        done = f"candidates {batch[0].number + 1} to {batch[-1].number + 1} of {self.plan.candidates}"
        self.runs.progress.update(bar, description=done)
        configurations = [configuration(self.runs.study, each, f"{CANDIDATE}{each.number + 1}") for each in batch]
        return [self._mean(outcomes) for outcomes in self.runs.outcomes(configurations, self.plan.seeds, bar)]

    def _mean(self, outcomes: Sequence[Outcome]) -> float:
        """The mean of the objective over trials; NaN if any has no value."""
        return float(np.mean([value_of(self.plan, each, self._baseline.get(each.trial.key)) for each in outcomes]))


def value_of(plan: SearchPlan, outcome: Outcome, baseline: Outcome | None) -> float:
    """The objective of a trial; baseline: of the same scene and seed, None: unknown."""
    agent = ego(outcome.metrics)
    of_baseline = baseline is not None and baseline.trial.digest == outcome.trial.digest
    paired = numbers.values(outcome, None if of_baseline else baseline)
    return plan.objective.value(paired, agent, of_baseline=of_baseline)


def configuration(study: Study, candidate: Candidate, label: str) -> Configuration:
    """The searched run with the parameters of a candidate."""
    assert study.search is not None
    parameters = study.search.parameters(candidate.values)
    run = _configuration_of(study, study.search.run)
    return Configuration(label, label, run.scenario, settings_of(parameters), ())


def _configuration_of(study: Study, label: str) -> Configuration:
    return next(each for each in study.configurations if each.label == label)


def check_ranges(study: Study, how: Conditions) -> None:
    """Check the objective's names, and resolve the searched run with each end of each range, and each choice.

    One parameter at a time, in the first scene: what several do together is only known when a candidate has them.
    """
    assert study.search is not None
    evaluator = _check(study, how, {}).get("evaluator") or {}
    if not {"type", "metrics"} & set(evaluator):  # users' evaluators and metrics have numbers of their own
        study.search.objective.check_names(f"{study.path}: search.objective")
    for name, values in study.search.space.items():
        for value in values.corners:
            try:
                _check(study, how, {name: value})
            except ConfigurationError as error:
                place = f"{study.path}: search.parameters.{name}: {value!r} of '{values}' is not possible"
                raise type(error)(f"{place}: {error}") from None


def defaults(study: Study, how: Conditions) -> dict[str, Any]:
    """The values of searched parameters in the default, of the study, the scenario or the attack's class, if known."""
    assert study.search is not None
    plan, run = study.search, _configuration_of(study, study.search.run)
    _, function = loading.function("scenarios", run.scenario, "scenario")
    of_function = {name: each.default for name, each in inspect.signature(function).parameters.items()}
    of_scenario = _check(study, how, {})
    values = {
        name: next(
            (v for each in (plan.default, of_function, of_scenario) if (v := value_at(each, name)) is not None),
            _of_class(plan.default, name),
        )
        for name in plan.space
    }
    return {name: value for name, value in values.items() if value is not None}


def _of_class(parameters: Mapping[str, Any], name: str) -> Any:
    """The default that the class of an attack has for one of its parameters, by dotted name; None: unknown."""
    place, _, parameter = name.rpartition(".")
    spec = value_at(parameters, place)
    kind = str(spec.get("type")).rpartition(":")[2] if isinstance(spec, Mapping) else ""
    classes = [known_types(base).get(kind) for base in (Attack, Coordination)]
    signatures = [inspect.signature(cls).parameters for cls in classes if cls is not None]
    defaults = [each[parameter].default for each in signatures if parameter in each]
    return defaults[0] if defaults and defaults[0] is not inspect.Parameter.empty else None


def _check(study: Study, how: Conditions, values: Mapping[str, Any]) -> dict[str, Any]:
    """The searched run's scenario with other values of some parameters; raises what resolving it raises."""
    checked = configuration(study, Candidate(0, 0, values), SEARCHED)
    settings = (*study.scenes[0].settings, *checked.settings, *study.trial_settings(how.seed, how.frames))
    path, loaded = scenario.load(checked.scenario, settings)
    scenario.resolve(path, loaded, seed=how.seed, frames=how.frames)
    return loaded


# -- results -----------------------------------------------------------------------------------------------------------


def measure(held_out: Study, search: Search, store: Store, planned: Sequence[Trial], sampler: str) -> SearchResults:
    """The results of a search, on the trials of held-out seeds that its folder has.

    held_out: the study with the configuration that was found;  planned: its trials;  sampler: name and version
    """
    plan, how = search.plan, search.runs.how
    values, rate, agent = _values(held_out, plan, store, planned)
    rows = {}
    for label, of_label in values.items():
        estimate = statistics.trial_estimate(of_label, plan.objective.bounds(agent), rate=rate)
        pairs = {"over_baseline": held_out.baseline} if label != held_out.baseline else {}
        pairs |= {"over_default": plan.run} if label == SEARCHED else {}
        differences = {
            name: statistics.trial_estimate(of_label - values[other], (-math.inf, math.inf), paired=True)
            for name, other in pairs.items()
        }
        rows[label] = SearchRow(label, search.values.get(label, NAN), estimate, **differences)
    best = proposals.best_of(search.candidates, maximise=plan.maximise)
    assert best is not None
    return SearchResults(
        name=held_out.name,
        objective=plan.objective.text,
        label=plan.objective.label,
        maximise=plan.maximise,
        sampler=sampler,
        space={name: str(each) for name, each in plan.space.items()},
        defaults=defaults(held_out, how),
        candidates=_candidate_rows(search.candidates, maximise=plan.maximise),
        best=best.number,
        rows=rows,
        baseline=held_out.baseline,
        default=plan.run,
        searched=SEARCHED,
        search_seeds=tuple(range(how.seed, how.seed + plan.seeds)),
        held_out_seeds=tuple(sorted({trial.seed for trial in planned})),
        scenes=tuple(scene.label for scene in held_out.scenes),
        frames=how.frames,
    )


def _values(
    held_out: Study, plan: SearchPlan, store: Store, planned: Sequence[Trial]
) -> tuple[dict[str, Floats], bool, str]:
    """By label of configuration, (scenes, seeds) values of the objective, NaN where a trial has none.

    Also whether they are 0 or 1, and the name of the agent that is scored.
    """
    scenes = {scene.label: index for index, scene in enumerate(held_out.scenes)}
    seeds = {seed: index for index, seed in enumerate(sorted({trial.seed for trial in planned}))}
    result = {each.label: np.full((len(scenes), len(seeds)), NAN) for each in held_out.configurations}
    rate, agent = False, "ego"
    baselines = {trial.key: store.load(trial) for trial in planned if trial.configuration == held_out.baseline}
    for trial in planned:
        outcome = store.load(trial)
        if outcome is None:
            continue
        agent = ego(outcome.metrics)
        rate |= plan.objective.is_rate(numbers.numbers(outcome.metrics), agent)
        result[trial.configuration][scenes[trial.scene], seeds[trial.seed]] = value_of(
            plan, outcome, baselines[trial.key]
        )
    return result, rate, agent


def _candidate_rows(candidates: Sequence[Candidate], *, maximise: bool) -> tuple[CandidateRow, ...]:
    rows = []
    for index, each in enumerate(candidates):
        best = proposals.best_of(candidates[: index + 1], maximise=maximise)
        rows.append(CandidateRow(each.number, each.batch, each.values, each.value, NAN if best is None else best.value))
    return tuple(rows)
