"""The parameters of a search, with the values that each may take. Pure."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from mast_zenoh.errors import ConfigurationError

#: How a range is written.
EXPECTED = "expected 'LOW..HIGH', 'LOW..HIGH log', or a list of at least two choices"
_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_RANGE = re.compile(rf"\s*({_NUMBER})\s*\.\.\s*({_NUMBER})\s*(log)?\s*")
_WHOLE = re.compile(r"[+-]?\d+")


@dataclass(frozen=True, slots=True)
class Range:
    """Numbers from low to high, both included; log: as many in each factor of ten. Whole numbers if both ends are."""

    low: float | int
    high: float | int
    log: bool = False

    @property
    def whole(self) -> bool:
        """Whether its values are whole numbers."""
        return isinstance(self.low, int)

    @property
    def corners(self) -> tuple[Any, ...]:
        """Values to check before a search starts."""
        return self.low, self.high

    def __str__(self) -> str:
        return f"{self.low}..{self.high}{' log' if self.log else ''}"


@dataclass(frozen=True, slots=True)
class Choices:
    """Values without an order."""

    values: tuple[Any, ...]

    @property
    def corners(self) -> tuple[Any, ...]:
        """Values to check before a search starts: all."""
        return self.values

    def __str__(self) -> str:
        return " | ".join(map(str, self.values))


#: By name of a parameter, what it may be. A dotted name is a path in the scenario, or in a parameter that is a dict.
Space = Mapping[str, Range | Choices]


def parse_space(content: Any, place: str) -> dict[str, Range | Choices]:
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


def _values(content: Any, place: str) -> Range | Choices:
    if isinstance(content, Sequence) and not isinstance(content, str):
        texts = [str(value) for value in content]
        if len(texts) < 2 or len(set(texts)) < len(texts):
            raise ConfigurationError(f"{place}: found {content!r}, expected at least two choices, each once")
        return Choices(tuple(content))
    match = _RANGE.fullmatch(content) if isinstance(content, str) else None
    if match is None:
        raise ConfigurationError(f"{place}: found {content!r}, {EXPECTED}")
    ends, log = match.groups()[:2], match[3] is not None
    whole = all(_WHOLE.fullmatch(end) for end in ends)
    low, high = (int(end) if whole else float(end) for end in ends)
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise ConfigurationError(f"{place}: found {content!r}, expected a finite low end below the high end")
    if log and low <= 0:
        raise ConfigurationError(f"{place}: found {content!r}, expected a low end above 0 for a logarithmic range")
    return Range(low, high, log)


def with_values(parameters: Mapping[str, Any], values: Mapping[str, Any], place: str) -> dict[str, Any]:
    """The launch-time parameters of a run with other values of some.

    A dotted name whose first part is one of the run's parameters sets an entry of that dict: with an attack=dict(…),
    attack.rate_mps. Raises ConfigurationError if that parameter is no dict.
    """
    result = dict(parameters)
    for name, value in sorted(values.items(), key=lambda item: item[0].count(".")):  # whole dicts before their entries
        head, *steps = name.split(".")
        if not steps or head not in result:
            result[name] = value
            continue
        result[head] = _with_entry(result[head], steps, value, f"{place}.{name}: {head}")
    return result


def _with_entry(content: Any, steps: Sequence[str], value: Any, place: str) -> dict[str, Any]:
    """A copy of nested dicts with another entry."""
    if not isinstance(content, Mapping):
        raise ConfigurationError(
            f"{place} is {content!r}, expected a dict, such as dict(type=…), that can have entries"
        )
    first, *others = steps
    inner = _with_entry(content.get(first, {}), others, value, f"{place}.{first}") if others else value
    return {**content, first: inner}


def value_at(content: Mapping[str, Any], name: str) -> Any:
    """The value that a dotted name has in nested dicts; None: it has none."""
    value: Any = content
    for step in name.split("."):
        if not isinstance(value, Mapping) or step not in value:
            return None
        value = value[step]
    return value
