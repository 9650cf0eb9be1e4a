"""The parameters of a search, with the values that each may take. Pure."""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Mapping, Sequence
from copy import deepcopy
from itertools import combinations
from typing import Any

from optuna.distributions import CategoricalDistribution, FloatDistribution, IntDistribution

from mast_zenoh.errors import ConfigurationError

#: How a range is written.
EXPECTED = "expected 'LOW..HIGH', 'LOW..HIGH log', or a list of at least two choices"
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
        content = _entries(content, place)
    if not isinstance(content, Mapping) or not content:
        raise ConfigurationError(f"{place}: found {content!r}, expected a dict: name of a parameter to its range")
    return {_name(name, place): _values(values, f"{place}.{name}") for name, values in content.items()}


def _entries(text: str, place: str) -> dict[str, Any]:
    """The ranges by name; choices are separated by bars."""
    result: dict[str, Any] = {}
    for entry in filter(None, map(str.strip, text.split(";"))):
        name, equals, values = (part.strip() for part in entry.partition("="))
        if not (name and equals and values):
            raise ConfigurationError(f"{place}: found {entry!r}, expected NAME=LOW..HIGH or NAME=A|B, separated by ';'")
        if name in result:
            raise ConfigurationError(f"{place}.{name}: found twice, expected each parameter once")
        result[name] = [_literal(part.strip()) for part in values.split("|")] if "|" in values else values
    return result


def _literal(text: str) -> Any:
    """A choice: a number if it is written as one."""
    if _WHOLE.fullmatch(text):
        return int(text)
    return float(text) if re.fullmatch(_NUMBER, text) else text


def _name(name: Any, place: str) -> str:
    if not isinstance(name, str) or not all(name.split(".")) or "=" in name:
        raise ConfigurationError(f"{place}: found the name {name!r}, expected that of a parameter, or a dotted path")
    return name


def _values(content: Any, place: str) -> Values:
    if isinstance(content, Sequence) and not isinstance(content, str):
        repeated = any(one == other or str(one) == str(other) for one, other in combinations(content, 2))
        if len(content) < 2 or repeated:
            raise ConfigurationError(f"{place}: found {content!r}, expected at least two choices, each once")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # of choices that are dicts: they are kept in memory alone
            return CategoricalDistribution(content)
    match = _RANGE.fullmatch(content) if isinstance(content, str) else None
    if match is None:
        raise ConfigurationError(f"{place}: found {content!r}, {EXPECTED}")
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
