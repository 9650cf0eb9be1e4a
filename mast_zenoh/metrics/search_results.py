"""The results of a search for attack parameters, as it computes them and reports show them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from mast_zenoh.metrics.study_results import NAN, Estimate, plural


@dataclass(frozen=True, slots=True)
class CandidateRow:
    """One choice of the parameters.

    number, batch: from 0;  values: by name of the parameter
    value: mean of the objective over the search's trials, NaN: none;  best: of all candidates up to this one
    """

    number: int
    batch: int
    values: Mapping[str, object]
    value: float
    best: float


@dataclass(frozen=True, slots=True)
class SearchRow:
    """One configuration on the held-out seeds.

    search:         mean of the objective on the search's seeds; NaN: it was not played with them
    held_out:       the objective on the held-out seeds
    over_baseline, over_default: minus that without the attack, and of the default, paired by scene and seed
    """

    label: str
    search: float = NAN
    held_out: Estimate = field(default_factory=Estimate)
    over_baseline: Estimate = field(default_factory=Estimate)
    over_default: Estimate = field(default_factory=Estimate)


@dataclass(frozen=True, slots=True)
class SearchResults:
    """A finished search.

    objective, label: as in the study file, and in words with its unit
    sampler:  name and version of what proposed candidates
    space:    by name of a parameter, its range;  defaults: by name, its value in the default, where that is known
    rows:     by label of the configuration;  baseline, default, searched: labels of these
    best:     number of the candidate with the best value
    """

    name: str
    objective: str
    label: str
    maximise: bool
    sampler: str
    space: Mapping[str, str]
    defaults: Mapping[str, object]
    candidates: tuple[CandidateRow, ...]
    best: int
    rows: Mapping[str, SearchRow]
    baseline: str
    default: str
    searched: str
    search_seeds: tuple[int, ...]
    held_out_seeds: tuple[int, ...]
    scenes: tuple[str, ...]
    frames: int | None

    @property
    def found(self) -> CandidateRow:
        """The candidate with the best value."""
        return self.candidates[self.best]

    @property
    def optimism(self) -> float:
        """By how much the search's value of its result is better than that on held-out seeds; NaN: unknown."""
        row = self.rows[self.searched]
        return self._sign * (row.search - row.held_out.trial_mean)

    @property
    def optimism_over_baseline(self) -> float:
        """The same of the differences from no attack, for which it does not matter how hard seeds are; NaN: unknown."""
        row = self.rows[self.searched]
        return self._sign * (row.search - self.rows[self.baseline].search - row.over_baseline.trial_mean)

    @property
    def over_baseline(self) -> bool:
        """Whether the objective has a value without the attack, so that differences from it are known."""
        baseline = self.rows[self.baseline]
        return not math.isnan(baseline.search) and not math.isnan(baseline.held_out.trial_mean)

    @property
    def _sign(self) -> float:
        return 1.0 if self.maximise else -1.0

    @property
    def size(self) -> str:
        """The effort in words: `40 candidates × 3 seeds × 2 scenes; held out: 20 seeds × 2 scenes`."""
        scenes = plural(len(self.scenes), "scene")
        tried = f"{plural(len(self.candidates), 'candidate')} \u00d7 {plural(len(self.search_seeds), 'seed')}"
        return f"{tried} \u00d7 {scenes}; held out: {plural(len(self.held_out_seeds), 'seed')} \u00d7 {scenes}"

    @property
    def without_value(self) -> int:
        """Number of candidates without a value, because a trial of theirs had none."""
        return sum(math.isnan(row.value) for row in self.candidates)
