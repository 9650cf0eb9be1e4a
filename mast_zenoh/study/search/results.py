"""What a search found: Optuna's study of its candidates, and each configuration on seeds that it has not seen."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import optuna

from mast_zenoh.errors import plural
from mast_zenoh.metrics.study_results import Row, Statistic
from mast_zenoh.study import numbers, statistics
from mast_zenoh.study.definition import Study
from mast_zenoh.study.numbers import NAN, ego
from mast_zenoh.study.search.plan import SEARCHED, SearchPlan
from mast_zenoh.study.store import Store
from mast_zenoh.study.trial import Trial, TrialOutcome

#: Numbers of a row: the objective on the held-out seeds; minus that without the attack, and of the default, paired by
#: scene and seed.
ESTIMATES = ("held_out", "over_baseline", "over_default")


@dataclass(frozen=True, slots=True)
class SearchResults:
    """A finished search.

    study:      with the configuration that was found; its seed is the first of the search
    candidates: Optuna's study: a trial for each candidate, whose parameters may be any values that study files have
    rows:       by label of the configuration, in the order of the study: its ESTIMATES, and `search`: mean of the
                objective on the search's seeds; unknown: it was not played with them
    defaults:   by name of a searched parameter, its value in the default, where that is known
    count:      number of held-out seeds
    """

    study: Study
    candidates: optuna.Study
    rows: Mapping[str, Row]
    defaults: Mapping[str, Any]
    count: int

    @property
    def plan(self) -> SearchPlan:
        """What was searched."""
        assert self.study.search is not None
        return self.study.search

    @property
    def sampler(self) -> str:
        """Name and version of what proposed candidates."""
        return f"{self.plan.sampler} (Optuna {optuna.__version__})"

    @property
    def search_seeds(self) -> range:
        """The seeds of the search."""
        return range(self.study.seed, self.study.seed + self.plan.seeds)

    @property
    def held_out_seeds(self) -> range:
        """The seeds that the search has not seen."""
        return range(self.search_seeds.stop, self.search_seeds.stop + self.count)

    @property
    def values(self) -> list[float]:
        """The objective's mean of each candidate; NaN: one of its trials has no value."""
        return [NAN if each.value is None else each.value for each in self.candidates.trials]

    @property
    def best_so_far(self) -> list[float]:
        """For each candidate, the best value up to it; NaN: none has one."""
        best: list[float] = (np.fmax if self.plan.maximise else np.fmin).accumulate(self.values).tolist()
        return best

    @property
    def over_baseline(self) -> bool:
        """Whether the objective has a value without the attack, so that differences from it are known."""
        baseline = self.rows[self.study.baseline]
        return baseline["search"].known and baseline["held_out"].known

    @property
    def optimism(self) -> tuple[float, float]:
        """By how much the search's value of its result is better than that on held-out seeds; NaN: unknown.

        Also that of the differences from no attack, for which it does not matter how hard seeds are.
        """
        row, sign = self.rows[SEARCHED], 1.0 if self.plan.maximise else -1.0
        search = row["search"].value
        added = search - self.rows[self.study.baseline]["search"].value
        return sign * (search - row["held_out"].value), sign * (added - row["over_baseline"].value)

    @property
    def size(self) -> str:
        """The effort in words: `40 candidates × 3 seeds × 2 scenes; held out: 20 seeds × 2 scenes`."""
        scenes = plural(len(self.study.scenes), "scene")
        tried = f"{plural(self.plan.candidates, 'candidate')} \u00d7 {plural(self.plan.seeds, 'seed')}"
        return f"{tried} \u00d7 {scenes}; held out: {plural(self.count, 'seed')} \u00d7 {scenes}"


def value(plan: SearchPlan, outcome: TrialOutcome, baseline: TrialOutcome | None) -> float:
    """The objective of a trial; baseline: of the same scene and seed, None: unknown."""
    of_baseline = baseline is not None and baseline.trial.digest == outcome.trial.digest
    paired = numbers.values(outcome, None if of_baseline else baseline)
    return plan.objective.value(paired, ego(outcome.metrics), of_baseline=of_baseline)


def rows(study: Study, planned: Sequence[Trial], store: Store, searched: Mapping[str, float]) -> dict[str, Row]:
    """Each configuration of a study on held-out seeds, from the trials that its folder has.

    planned:  the held-out trials, as `trials.plan` orders them
    searched: by label, the objective's mean on the search's seeds
    """
    assert study.search is not None
    plan, agent, rate = study.search, "ego", False
    baselines = {trial.key: store.load(trial) for trial in planned if trial.configuration == study.baseline}
    flat = np.full(len(planned), NAN)
    for index, trial in enumerate(planned):
        if outcome := store.load(trial):
            agent = ego(outcome.metrics)
            rate |= plan.objective.is_rate(numbers.numbers(outcome.metrics), agent)
            flat[index] = value(plan, outcome, baselines[trial.key])
    labels = [each.label for each in study.configurations]
    by_label = dict(zip(labels, np.moveaxis(flat.reshape(len(study.scenes), -1, len(labels)), -1, 0), strict=True))
    result = {}
    for label, values in by_label.items():
        pairs = {"over_baseline": study.baseline} if label != study.baseline else {}
        pairs |= {"over_default": plan.run} if label == SEARCHED else {}
        of_label = {
            name: statistics.trial_estimate(values - by_label[other], (-math.inf, math.inf), paired=True)
            for name, other in pairs.items()
        }
        held_out = statistics.trial_estimate(values, plan.objective.bounds(agent), rate=rate)
        numbers_of_label = {"search": Statistic(searched.get(label, NAN))} | dict.fromkeys(ESTIMATES, Statistic())
        of = {"configuration": label, "seeds": held_out.seeds}
        of["seeds_left_out"] = held_out.seeds_left_out(values.shape[1])
        result[label] = Row(of, held_out.trials, numbers_of_label | of_label | {"held_out": held_out})
    return result
