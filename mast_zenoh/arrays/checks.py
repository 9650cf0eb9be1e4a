"""Checks of numbers that a scenario sets: one form of error for all classes."""

from __future__ import annotations

from collections.abc import Callable
from math import inf
from typing import Any

#: What can be expected of a number, in the words of the error. Nothing of it is true of NaN.
EXPECTED: dict[str, Callable[[Any], bool]] = {
    "more than 0": lambda value: value > 0.0,
    "more than 0, finite": lambda value: 0.0 < value < inf,
    "more than 0 and at most 60 s": lambda value: 0.0 < value <= 60.0,
    "0 to 60 s": lambda value: 0.0 <= value <= 60.0,
    "more than 0 and at most 1000": lambda value: 0.0 < value <= 1e3,
    "more than 0 and less than 1": lambda value: 0.0 < value < 1.0,
    "more than 0 and at most 1": lambda value: 0.0 < value <= 1.0,
    "0 or more": lambda value: value >= 0.0,
    "0 or more, finite": lambda value: 0.0 <= value < inf,
    "1 or more": lambda value: value >= 1.0,
    "2 or more": lambda value: value >= 2.0,
    "a whole number": lambda value: isinstance(value, int) and not isinstance(value, bool),
    "True or False": lambda value: isinstance(value, bool),
}


def check(expected: str, **values: float) -> None:
    """Raise ValueError for the first of some numbers that is not as expected: one of EXPECTED, or "LOW to HIGH"."""
    is_expected = EXPECTED.get(expected) or _within(*map(float, expected.split(" to ")))
    for name, value in values.items():
        if not is_expected(value):
            raise ValueError(f"{name}: found {value}, expected {expected}")


def _within(low: float, high: float) -> Callable[[Any], bool]:
    return lambda value: low <= value <= high
