"""The objective of a search: one number of each trial, or the sum of several."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from mast_zenoh.errors import ConfigurationError, nearest
from mast_zenoh.metrics.estimates import ESTIMATES
from mast_zenoh.metrics.measures import MEASURES
from mast_zenoh.metrics.study_results import StudySeries
from mast_zenoh.study import numbers, statistics
from mast_zenoh.study.numbers import ACHIEVED, DEFENCE, DRIVEN, NAN, Number

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
            raise ConfigurationError(f"{place}: {_unknown(unknown[0], known)}")

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
        places = [_place(term) for term in self.terms]
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


def _unknown(series: StudySeries, known: Iterable[StudySeries]) -> str:
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


def _place(term: StudySeries) -> str:
    """Whose number it is, in words."""
    estimator = ESTIMATES[term.estimator].column if term.estimator in ESTIMATES else term.estimator
    return estimator if term.owner in ("", "all") else f"{term.owner}: {estimator}"
