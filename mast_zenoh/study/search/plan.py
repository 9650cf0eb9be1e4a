"""The section `search` of a study file: the searched parameters with their ranges, and the objective."""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Iterable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from itertools import combinations
from typing import Any

from optuna.distributions import CategoricalDistribution, FloatDistribution, IntDistribution

from mast_zenoh.errors import ConfigurationError, nearest
from mast_zenoh.metrics.estimates import ESTIMATES
from mast_zenoh.metrics.measures import MEASURES
from mast_zenoh.metrics.study_results import StudySeries
from mast_zenoh.study import numbers, statistics
from mast_zenoh.study.numbers import ACHIEVED, DEFENCE, DRIVEN, NAN, Number

# -- parameters: Optuna's distributions --------------------------------------------------------------------------------

#: How a range is written.
EXPECTED_RANGE = "expected 'LOW..HIGH', 'LOW..HIGH log', or a list of at least two choices"
_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_RANGE = re.compile(rf"\s*({_NUMBER})\s*\.\.\s*({_NUMBER})\s*(log)?\s*")
_WHOLE = re.compile(r"[+-]?\d+")

#: What a parameter may be: numbers from low to high, both included, whole ones if both ends are; or choices.
Values = FloatDistribution | IntDistribution | CategoricalDistribution
#: By name of a parameter, what it may be. A dotted name is a path in the scenario, or in a parameter that is a dict.
Space = Mapping[str, Values]


def corners(values: Values) -> Sequence[Any]:
    """Values to check before a search starts: both ends of a range, or all choices."""
    return values.choices if isinstance(values, CategoricalDistribution) else (values.low, values.high)


def as_text(values: Values) -> str:
    """As in a study file: `0.5..4.0 log`; choices as `own | trust`."""
    ends = " | " if isinstance(values, CategoricalDistribution) else ".."
    return ends.join(map(str, corners(values))) + (" log" if getattr(values, "log", False) else "")


def parse_space(content: Any, place: str) -> dict[str, Values]:
    """The space from a dict of ranges, or from text: `budget=0.5..4.0 log; n_adversaries=1..3; knowledge=own|trust`.

    place: its key, for errors. Raises ConfigurationError.
    """
    if isinstance(content, str):
        content = _space_entries(content, place)
    if not isinstance(content, Mapping) or not content:
        raise ConfigurationError(f"{place}: found {content!r}, expected a dict: name of a parameter to its range")
    return {
        _parameter_name(name, place): _range_or_choices(values, f"{place}.{name}") for name, values in content.items()
    }


def _space_entries(text: str, place: str) -> dict[str, Any]:
    """The ranges by name; choices are separated by bars."""
    result: dict[str, Any] = {}
    for entry in filter(None, map(str.strip, text.split(";"))):
        name, equals, values = (part.strip() for part in entry.partition("="))
        if not (name and equals and values):
            raise ConfigurationError(f"{place}: found {entry!r}, expected NAME=LOW..HIGH or NAME=A|B, separated by ';'")
        if name in result:
            raise ConfigurationError(f"{place}.{name}: found twice, expected each parameter once")
        result[name] = [_choice(part.strip()) for part in values.split("|")] if "|" in values else values
    return result


def _choice(text: str) -> Any:
    """A choice: a number if it is written as one."""
    if _WHOLE.fullmatch(text):
        return int(text)
    return float(text) if re.fullmatch(_NUMBER, text) else text


def _parameter_name(name: Any, place: str) -> str:
    if not isinstance(name, str) or not all(name.split(".")) or "=" in name:
        raise ConfigurationError(f"{place}: found the name {name!r}, expected that of a parameter, or a dotted path")
    return name


def _range_or_choices(content: Any, place: str) -> Values:
    if isinstance(content, Sequence) and not isinstance(content, str):
        repeated = any(one == other or str(one) == str(other) for one, other in combinations(content, 2))
        if len(content) < 2 or repeated:
            raise ConfigurationError(f"{place}: found {content!r}, expected at least two choices, each once")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # of choices that are dicts: they are kept in memory alone
            return CategoricalDistribution(content)
    match = _RANGE.fullmatch(content) if isinstance(content, str) else None
    if match is None:
        raise ConfigurationError(f"{place}: found {content!r}, {EXPECTED_RANGE}")
    ends, log = match.groups()[:2], match[3] is not None
    whole = all(_WHOLE.fullmatch(end) for end in ends)
    low, high = map(float, ends)
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise ConfigurationError(f"{place}: found {content!r}, expected a finite low end below the high end")
    if log and low <= 0:
        raise ConfigurationError(f"{place}: found {content!r}, expected a low end above 0 for a logarithmic range")
    return IntDistribution(int(ends[0]), int(ends[1]), log) if whole else FloatDistribution(low, high, log)


def with_values(parameters: Mapping[str, Any], values: Mapping[str, Any], place: str) -> dict[str, Any]:
    """The launch-time parameters of a run with other values of some.

    A dotted name whose first part is one of the run's parameters sets an entry of that dict: with an attack=dict(…),
    attack.rate_mps. Raises ConfigurationError if that parameter is no dict.
    """
    result = deepcopy(dict(parameters))
    for name, value in sorted(values.items(), key=lambda item: item[0].count(".")):  # whole dicts before their entries
        *steps, last = name.split(".") if name.partition(".")[0] in result else [name]
        level = result
        for step in steps:
            level = level.setdefault(step, {})
            if not isinstance(level, dict):
                raise ConfigurationError(
                    f"{place}.{name}: {step} is {level!r}, expected a dict, such as dict(type=…), that can have entries"
                )
        level[last] = value
    return result


def value_at(content: Mapping[str, Any], name: str) -> Any:
    """The value that a dotted name has in nested dicts; None: it has none."""
    value: Any = content
    for step in name.split("."):
        value = value.get(step) if isinstance(value, Mapping) else None
    return value


# -- the objective: one number of each trial, or the sum of several ----------------------------------------------------

PICTURE = "picture"
#: Estimators whose numbers are of all adversaries or agents together.
_OF_ALL = (ACHIEVED, DEFENCE)
#: Counts of a whole run, which charts over time show per frame.
_PER_RUN = ("id_switches",)
#: Suffix of a number minus that of the ego alone.
_OF_PAPER = "_ioe"
#: Suffix of a number minus the baseline's: in the baseline it is 0 by definition.
_OVER_BASELINE = "_iob"


@dataclass(frozen=True, slots=True)
class Objective:
    """The sum of its terms.

    text:  as in the study file
    terms: numbers of results.parquet; owner: the column `who`, "" for the agent that is scored
    """

    text: str
    terms: tuple[StudySeries, ...]

    def series(self, ego: str) -> list[StudySeries]:
        """The series of its terms in a run; ego: the agent that is scored."""
        return [term._replace(owner=term.owner or ego) for term in self.terms]

    def value(self, trial_numbers: Iterable[Number], ego: str, *, of_baseline: bool = False) -> float:
        """The value of a trial; NaN if it lacks a number.

        trial_numbers: of `numbers.values`;  ego: the agent that is scored
        of_baseline:   whether the trial is of the baseline, whose difference from itself is 0
        """
        known = {StudySeries(*each[:3]): each.value for each in trial_numbers}
        if of_baseline:
            known |= {each: 0.0 for each in self.series(ego) if each.metric.endswith(_OVER_BASELINE)}
        return float(sum(known.get(each, NAN) for each in self.series(ego)))

    def check_names(self, place: str) -> None:
        """Raise ConfigurationError for a number that no run with our evaluator has, as far as its name tells."""
        for term in self.terms:
            estimators, base = (*ESTIMATES, *_OF_ALL), term.metric.removesuffix(_OVER_BASELINE)
            if term.estimator not in estimators:
                raise ConfigurationError(
                    f"{place}: no estimator {term.estimator!r}{nearest(term.estimator, estimators)}"
                )
            of_paper = term.owner == numbers.COMPROMISED or base.endswith(_OF_PAPER)
            plain = term.estimator in ESTIMATES and base.isidentifier() and not of_paper
            if plain and base not in MEASURES:
                raise ConfigurationError(f"{place}: no metric {term.metric!r}{nearest(term.metric, MEASURES)}")

    def check(self, trial_numbers: Iterable[Number], ego: str, place: str) -> None:
        """Raise ConfigurationError for a number that a trial under attack does not have."""
        known = {StudySeries(*each[:3]) for each in trial_numbers}
        if unknown := [each for each in self.series(ego) if each not in known]:
            raise ConfigurationError(f"{place}: {_unknown_number(unknown[0], known)}")

    def bounds(self, ego: str) -> tuple[float, float]:
        """The smallest and the largest possible value."""
        limits = [statistics.value_range(each) for each in self.series(ego)]
        return sum(low for low, _ in limits), sum(high for _, high in limits)

    def is_rate(self, trial_numbers: Iterable[Number], ego: str) -> bool:
        """Whether values are 0 or 1, so that their mean is a rate."""
        binary = [StudySeries(*each[:3]) for each in trial_numbers if each.binary]
        return len(self.terms) == 1 and self.series(ego)[0] in binary

    @property
    def label(self) -> str:
        """In words, with the unit, for tables and figures: `missed objects + false objects per frame, picture`."""
        names, units = map(list, zip(*(_name_and_unit(term.metric) for term in self.terms), strict=True))
        places = [_place_of(term) for term in self.terms]
        unit = f" {units[0]}" if units[0] and len({*units}) == 1 else ""
        if len({*places}) == 1:
            return f"{' + '.join(names)}{unit}{f', {places[0]}' if places[0] else ''}"
        return " + ".join(f"{name} ({place})" for name, place in zip(names, places, strict=True)) + unit


def parse_objective(text: Any, place: str) -> Objective:
    """The objective from text: `METRIC`, `ESTIMATOR/METRIC`, `WHO/ESTIMATOR/METRIC`, or a sum of these.

    place: its key, for errors. Raises ConfigurationError.
    """
    parts = [part.strip() for part in text.split("+")] if isinstance(text, str) else []
    if not parts or not all(parts):
        raise ConfigurationError(f"{place}: found {text!r}, expected a metric such as 'fn + fp' or 'mission/fn'")
    terms = tuple(_term(part, place) for part in parts)
    if len(set(terms)) < len(terms):
        raise ConfigurationError(f"{place}: found {text!r}, expected each number once")
    return Objective(" + ".join(parts), terms)


def _term(text: str, place: str) -> StudySeries:
    words = text.split("/")
    if len(words) > 3 or not all(words):
        raise ConfigurationError(f"{place}: found {text!r}, expected METRIC, ESTIMATOR/METRIC or WHO/ESTIMATOR/METRIC")
    metric, estimator = words[-1], words[-2] if len(words) > 1 else PICTURE
    if not numbers.has_mean(estimator, metric):
        expected = f"{DRIVEN}/near_misses" if estimator == DRIVEN else f"{numbers.DRIVING}.critical"
        raise ConfigurationError(f"{place}: {metric!r} has no mean: expected {expected!r}")
    owner = words[0] if len(words) == 3 else "all" if estimator in _OF_ALL else ""
    return StudySeries(owner, estimator, metric)


def _unknown_number(series: StudySeries, known: Iterable[StudySeries]) -> str:
    """What is unknown about a series, with the nearest that is known."""
    place = [(each.estimator, each.metric) for each in known if each.owner == series.owner]
    metrics = [metric for estimator, metric in place if estimator == series.estimator]
    if metrics:
        return f"no metric {series.metric!r} of {series.owner!r}, {series.estimator!r}{nearest(series.metric, metrics)}"
    if place:
        hint = nearest(series.estimator, {estimator for estimator, _ in place})
        return f"no estimator {series.estimator!r} of {series.owner!r}{hint}"
    return f"no numbers of {series.owner!r} in the runs{nearest(series.owner, {each.owner for each in known})}"


def _name_and_unit(metric: str) -> tuple[str, str]:
    """A metric in words, and its unit."""
    base = metric.removesuffix(_OVER_BASELINE)
    added = " added" if base != metric else ""
    measure = MEASURES.get(base)
    if measure is None or not measure.axis:
        return f"{base.replace('_', ' ')}{added}", ""
    words = " ".join(measure.axis.split())
    name, per_frame, _ = words.partition(" per frame")
    return f"{name}{added}", "per run" if base in _PER_RUN else per_frame.strip()


def _place_of(term: StudySeries) -> str:
    """Whose number it is, in words."""
    estimator = ESTIMATES[term.estimator].column if term.estimator in ESTIMATES else term.estimator
    return estimator if term.owner in ("", "all") else f"{term.owner}: {estimator}"


# -- the section -------------------------------------------------------------------------------------------------------

#: The keys of the section.
KEYS = {
    "run": "label of the run whose parameters are searched; as it is written, it is the default",
    "parameters": "name to 'LOW..HIGH', 'LOW..HIGH log' or a list of choices",
    "objective": "the number to maximise: METRIC, ESTIMATOR/METRIC, WHO/ESTIMATOR/METRIC, or a sum of these",
    "direction": "maximise or minimise",
    "candidates": "how many choices of the parameters are tried",
    "batch": "how many are proposed at once, from the values of those before",
    "seeds": "seeds for each candidate and scene; the trials of the study have other seeds",
    "sampler": "what proposes candidates: TPE or random",
}
_REQUIRED = ("run", "parameters", "objective")
#: The values of some of them, the default first.
CHOICES = {"direction": ("maximise", "minimise"), "sampler": ("TPE", "random")}
#: Label of the configuration that a search finds.
SEARCHED = "searched"
#: Labels of candidates begin with it.
CANDIDATE = "candidate-"


@dataclass(frozen=True, slots=True)
class SearchPlan:
    """What is searched, for what, and with how much effort; see KEYS.

    default: the run's launch-time parameters, as they are in the study file
    """

    run: str
    default: Mapping[str, Any]
    space: Space
    objective: Objective
    maximise: bool = True
    candidates: int = 40
    batch: int = 8
    seeds: int = 3
    sampler: str = "TPE"

    def parameters(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """The launch-time parameters of the run with other values of some; raises ConfigurationError."""
        return with_values(self.default, values, "search.parameters")


def parse_plan(content: Mapping[str, Any], baseline: str) -> SearchPlan:
    """The plan of a study with a search; raises ConfigurationError.

    content: what `study(...)` returned, with valid `runs`;  baseline: label of the run without the attack
    """
    section = content["search"]
    _check(isinstance(section, Mapping), f"search: found {section!r:.120}, expected a dict with {', '.join(_REQUIRED)}")
    for key in section:
        _check(key in KEYS, f"search.{key}: unknown key{nearest(str(key), KEYS)}")
    for key in _REQUIRED:
        _check(key in section, f"search.{key}: missing, expected {KEYS[key]}")
    _check(not content.get("security"), "search: this study has `security` too, expected one of them")
    _check(
        content.get("trials"), "trials: missing, expected the number of seeds on which the search's result is measured"
    )
    runs, label = content["runs"], section["run"]
    _check(label in runs, f"search.run: found {label!r}{nearest(str(label), map(str, runs))}")
    _check(not runs[label].get("grid"), f"search.run: {label!r} has a grid, expected one configuration")
    _check(label != baseline, f"search.run: {label!r} is the baseline, expected a run that attacks")
    for name in map(str, runs):
        taken = name == SEARCHED or name.startswith(CANDIDATE)
        _check(not taken, f"runs: found the label {name!r}, which is that of a search's result, expected another")
    chosen = {key: section.get(key, known[0]) for key, known in CHOICES.items()}
    for key, value in chosen.items():
        _check(value in CHOICES[key], f"search.{key}: found {value!r}{nearest(str(value), CHOICES[key])}")
    numbers = {key: section[key] for key in ("candidates", "batch", "seeds") if section.get(key) is not None}
    for key, value in numbers.items():
        _check(type(value) is int and value >= 1, f"search.{key}: found {value!r}, expected a whole number from 1")
    return SearchPlan(
        run=str(label),
        default=dict(runs[label].get("parameters", {})),
        space=parse_space(section["parameters"], "search.parameters"),
        objective=parse_objective(section["objective"], "search.objective"),
        maximise=chosen["direction"] == "maximise",
        sampler=chosen["sampler"],
        **numbers,
    )


def _check(valid: object, problem: str) -> None:
    """Raise ConfigurationError with the problem of an entry that is not valid."""
    if not valid:
        raise ConfigurationError(problem)
