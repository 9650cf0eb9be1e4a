"""Carries out a search, then measures its result on seeds that it has not seen.

The search plays every candidate with its own seeds, the first of the study. What it finds becomes a configuration of
the study, whose trials have the seeds after those. So the numbers of the study are as valid as those of any other.

Optuna proposes candidates: the same ones for the same seed and values, whatever computes the values. Its study is in
memory: a search that is continued begins again, and takes the values from the trials in the study's folder. None of
Optuna's files has the state of its sampler, so that it would propose others after an interruption.

Tree-structured Parzen estimator: Bergstra, Bardenet, Bengio, Kégl (2011), Algorithms for hyper-parameter optimization,
NeurIPS 24. Optuna: Akiba, Sano, Yanase, Ohta, Koyama (2019), KDD.
"""

from __future__ import annotations

import inspect
import math
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack, closing
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import optuna
from optuna.exceptions import ExperimentalWarning
from optuna.samplers import BaseSampler, RandomSampler, TPESampler
from optuna.trial import TrialState
from rich.console import Console
from rich.progress import TaskID

from mast_zenoh import scenario
from mast_zenoh.attacks import Attack, Coordination
from mast_zenoh.config import loading
from mast_zenoh.config.registry import known_types
from mast_zenoh.errors import ConfigurationError
from mast_zenoh.study import execution, numbers, tables, trials
from mast_zenoh.study.definition import Configuration, Study, settings_of
from mast_zenoh.study.numbers import ego
from mast_zenoh.study.search import results
from mast_zenoh.study.search.plan import CANDIDATE, SEARCHED, SearchPlan, as_text, corners, value_at
from mast_zenoh.study.search.results import SearchResults
from mast_zenoh.study.store import Store, status_written
from mast_zenoh.study.tables import StudyResult
from mast_zenoh.study.trial import Trial, TrialKey, TrialOutcome

#: Gives the objective's values of candidates, in their order; NaN: a candidate has none.
Evaluate = Callable[[Sequence[optuna.Trial]], Sequence[float]]


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
    """Search, run the result and the study's configurations with `count` held-out seeds, and write the tables.

    study:  one with a search;  record: keep the runs of held-out trials. The others are those of `trials.run`

    The candidates, and so all numbers, are the same for any number of jobs, and after interruptions. Raises
    TrialsFailed if a trial of the search failed: the values that later candidates depend on would be incomplete.
    Raises ConfigurationError for an invalid study, before the first trial; for an unknown objective, after the first
    ones.
    """
    console = console or Console(quiet=True)
    trials.check_environment(console, jobs, cluster, record=record)
    check_ranges(study)
    store = Store.create(out, study, resume=resume)
    search = Search(study, store, console, (jobs, cluster), allow_failures=allow_failures)
    with status_written(store.status_file, search.write_status, trials.how_to_continue(store)):
        with search.progress, search.workers:
            candidates = search.find()
            held_out = search.hold_out(count, record=record)
        study = search.study
        rows = results.rows(study, held_out, store, search.values)
        found = SearchResults(study, candidates, rows, defaults(study), count)
        from mast_zenoh.study.search import report  # drawing libraries are slow to load

        own = report.write(store.folder, found)
        finished = tables.write(study, store, held_out, search.failures, own)
        search.left_out = finished.facts.left_out
        return finished


class Search:
    """One search; its trials are run, or taken from the study's folder if they are there.

    study:    gets the configuration that is found;  progress, workers: to be entered while trials are run
    planned, failures: for study.json: the trials up to now, and by digest the errors of those that failed
    left_out: for study.json: why results are not there
    values:   by label of configuration, the objective's mean on the search's seeds
    """

    def __init__(
        self, study: Study, store: Store, console: Console, workers: tuple[int, str | None], *, allow_failures: bool
    ) -> None:
        """workers: number of jobs and address of a cluster, as for `execution.workers`."""
        assert study.search is not None
        self.study, self.plan = study, study.search
        self.progress, self.workers = trials.progress_bars(console), ExitStack()
        self.planned: list[Trial] = []
        self.failures: dict[str, str] = {}
        self.left_out: Sequence[str] = ()
        self.values: dict[str, float] = {}
        self._store, self._jobs, self._allow_failures = store, workers, allow_failures
        self._baseline: dict[TrialKey, TrialOutcome] = {}

    def write_status(self, status: str) -> None:
        """Write study.json."""
        self._store.write_status(self.study, self.planned, self.failures, status, self.left_out)

    def find(self) -> optuna.Study:
        """All candidates with their values; the best one becomes a configuration of the study."""
        each = len(self.study.scenes) * self.plan.seeds
        bar = self.progress.add_task("search", total=(self.plan.candidates + 2) * each)
        self._play_references(bar)
        found = propose(self.plan, self.study.seed, lambda batch: self._evaluate(batch, bar))
        if not found.get_trials(states=[TrialState.COMPLETE]):
            raise ConfigurationError(
                f"search.objective: {self.plan.objective.text!r} has no value for any of {self.plan.candidates} "
                "candidates, expected a number that every trial has"
            )
        self.values[SEARCHED] = found.best_value
        configurations = (*self.study.configurations, configuration(self.study, found.best_params, SEARCHED))
        self.study = replace(self.study, configurations=configurations)
        return found

    def hold_out(self, count: int, *, record: bool) -> list[Trial]:
        """Run the trials of all configurations with `count` seeds that the search has not used."""
        todo = self._planned(self.study.configurations, count, self.study.seed + self.plan.seeds)
        if record:
            todo = [replace(trial, folder=str(self._store.run_folder(trial))) for trial in todo]
        self._run(todo, self.progress.add_task("held-out trials", total=len(todo)))
        return todo

    def _play_references(self, bar: TaskID) -> None:
        """Play the baseline and the default; the first trials tell whether the objective exists."""
        study = self.study
        pair = [configuration_of(study, label) for label in (study.baseline, self.plan.run)]
        unattacked, attacked = (outcomes[0] for outcomes in self._outcomes(pair, 1, bar))
        if attacked.trial.idle is not None:
            raise trials.late_attack(study, self.plan.run, attacked.trial.idle)
        agent = ego(attacked.metrics)
        self.plan.objective.check(numbers.values(attacked, unattacked), agent, f"{study.path}: search.objective")
        self.progress.advance(bar, -2 * len(study.scenes))  # they are among those of all seeds
        of_baseline, of_default = self._outcomes(pair, self.plan.seeds, bar)
        self._baseline = {outcome.trial.key: outcome for outcome in of_baseline}
        self.values = {study.baseline: self._mean(of_baseline), self.plan.run: self._mean(of_default)}

    def _evaluate(self, batch: Sequence[optuna.Trial], bar: TaskID) -> list[float]:
        done = f"candidates {batch[0].number + 1} to {batch[-1].number + 1} of {self.plan.candidates}"
        self.progress.update(bar, description=done)
        tried = [configuration(self.study, each.params, f"{CANDIDATE}{each.number + 1}") for each in batch]
        return [self._mean(outcomes) for outcomes in self._outcomes(tried, self.plan.seeds, bar)]

    def _mean(self, outcomes: Iterable[TrialOutcome]) -> float:
        """The mean of the objective over trials; NaN if any has no value."""
        baseline = self._baseline
        return float(np.mean([results.value(self.plan, each, baseline.get(each.trial.key)) for each in outcomes]))

    def _outcomes(self, configurations: Iterable[Configuration], count: int, bar: TaskID) -> list[list[TrialOutcome]]:
        """For each configuration, the outcomes of all scenes with the first `count` seeds of the search.

        Raises TrialsFailed if any trial failed.
        """
        planned = [self._planned((each,), count, self.study.seed) for each in configurations]
        todo = [trial for each in planned for trial in each]
        self._run(todo, bar)
        if failed := [trial for trial in todo if trial.digest in self.failures]:
            error = tables.trials_failed([tables.failed_trial(t, self.failures[t.digest]) for t in failed])
            raise type(error)(f"{error}\nThe search stops there; {trials.how_to_continue(self._store)}")
        return [[self._loaded(trial) for trial in each] for each in planned]

    def _loaded(self, trial: Trial) -> TrialOutcome:
        outcome = self._store.load(trial)
        if outcome is None:
            raise OSError(f"{self._store.folder}: the outcome of a finished trial cannot be read: {trial.command()}")
        return outcome

    def _planned(self, configurations: tuple[Configuration, ...], count: int, first: int) -> list[Trial]:
        study = replace(self.study, configurations=configurations, seed=first)
        return trials.plan(study, count=count, allow_failures=self._allow_failures)

    def _run(self, todo: Sequence[Trial], bar: TaskID) -> None:
        """Run the trials that are not done, each once, and store their outcomes."""
        known = {(trial.digest, trial.configuration) for trial in self.planned}
        self.planned += [trial for trial in todo if (trial.digest, trial.configuration) not in known]
        store = self._store
        missing = {trial.digest: trial for trial in todo if store.load(trial) is None or not store.is_kept(trial)}
        trials.report_misplaced(store, self.progress.console)
        self.progress.advance(bar, len(todo) - len(missing))
        if missing:
            with closing(self._run_trials(list(missing.values()))) as outcomes:
                trials.keep(outcomes, store, self.failures, self.progress, bar)

    @cached_property
    def _run_trials(self) -> execution.RunTrials:
        """Workers start with the first trial."""
        return self.workers.enter_context(execution.workers(*self._jobs))


def propose(plan: SearchPlan, seed: int, evaluate: Evaluate) -> optuna.Study:
    """All candidates with their values, as Optuna's study; those without a value have failed.

    Within a batch, the sampler knows what it has proposed, and the values of earlier batches. So the result depends on
    the size of a batch, but not on what is computed at the same time. A shorter search is the beginning of a longer
    one. Raises what `evaluate` raises.
    """
    level = optuna.logging.get_verbosity()
    optuna.logging.set_verbosity(optuna.logging.WARNING)  # otherwise it prints that it begins
    try:
        study = optuna.create_study(sampler=_sampler(plan, seed), direction="maximize" if plan.maximise else "minimize")
    finally:
        optuna.logging.set_verbosity(level)
    for first in range(0, plan.candidates, plan.batch):
        batch = [study.ask(dict(plan.space)) for _ in range(min(plan.batch, plan.candidates - first))]
        for trial, value in zip(batch, evaluate(batch), strict=True):
            if math.isfinite(value):
                study.tell(trial, value)
            else:
                study.tell(trial, state=TrialState.FAIL)
    return study


def _sampler(plan: SearchPlan, seed: int) -> BaseSampler:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ExperimentalWarning)  # versions are limited to those in which it works
        # Candidates of a batch that have no value yet count as bad, so that a batch does not repeat one candidate.
        return RandomSampler(seed=seed) if plan.sampler == "random" else TPESampler(seed=seed, constant_liar=True)


# -- configurations ----------------------------------------------------------------------------------------------------


def configuration(study: Study, values: Mapping[str, Any], label: str) -> Configuration:
    """The searched run with other values of some parameters."""
    assert study.search is not None
    parameters = study.search.parameters(values)
    run = configuration_of(study, study.search.run)
    return Configuration(label, label, run.scenario, settings_of(parameters), ())


def configuration_of(study: Study, label: str) -> Configuration:
    """The configuration with a label."""
    return next(each for each in study.configurations if each.label == label)


def check_ranges(study: Study) -> None:
    """Check the objective's names, and resolve the searched run with each end of each range, and each choice.

    One parameter at a time, in the first scene: what several do together is only known when a candidate has them.
    """
    assert study.search is not None
    evaluator = _checked(study, {}).get("evaluator") or {}
    if not {"type", "metrics"} & set(evaluator):  # users' evaluators and metrics have numbers of their own
        study.search.objective.check_names(f"{study.path}: search.objective")
    for name, values in study.search.space.items():
        for value in corners(values):
            try:
                _checked(study, {name: value})
            except ConfigurationError as error:
                place = f"{study.path}: search.parameters.{name}: {value!r} of '{as_text(values)}' is not possible"
                raise type(error)(f"{place}: {error}") from None


def defaults(study: Study) -> dict[str, Any]:
    """The values of searched parameters in the default, of the study, the scenario or the attack's class, if known."""
    assert study.search is not None
    plan, run = study.search, configuration_of(study, study.search.run)
    _, function = loading.function("scenarios", run.scenario, "scenario")
    of_function = {name: each.default for name, each in inspect.signature(function).parameters.items()}
    sources = (plan.default, of_function, _checked(study, {}))
    found = {name: [*(value_at(each, name) for each in sources), _of_class(plan.default, name)] for name in plan.space}
    known = {name: [value for value in values if value is not None] for name, values in found.items()}
    return {name: values[0] for name, values in known.items() if values}


def _of_class(parameters: Mapping[str, Any], name: str) -> Any:
    """The default that the class of an attack has for one of its parameters, by dotted name; None: unknown."""
    place, _, parameter = name.rpartition(".")
    spec = value_at(parameters, place)
    kind = str(spec.get("type")).rpartition(":")[2] if isinstance(spec, Mapping) else ""
    classes = [known_types(base).get(kind) for base in (Attack, Coordination)]
    parameters_of = [inspect.signature(cls).parameters for cls in classes if cls is not None]
    defaults = [each[parameter].default for each in parameters_of if parameter in each]
    return next((each for each in defaults if each is not inspect.Parameter.empty), None)


def _checked(study: Study, values: Mapping[str, Any]) -> dict[str, Any]:
    """The searched run's scenario with other values of some parameters; raises what resolving it raises."""
    checked = configuration(study, values, SEARCHED)
    settings = (*study.scenes[0].settings, *checked.settings, *study.trial_settings(study.seed, study.frames))
    path, loaded = scenario.load(checked.scenario, settings)
    scenario.resolve(path, loaded, seed=study.seed, frames=study.frames)
    return loaded
