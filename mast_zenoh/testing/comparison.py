"""Compares results of a class, and detects changed inputs."""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from mast_zenoh.mesh.control import results


def expect(holds: object, text: str) -> None:
    """Raise AssertionError with this text unless a condition holds."""
    if not holds:
        raise AssertionError(text)


def arrays_of(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """(path, array) of all arrays in nested dataclasses and tuples."""
    if isinstance(value, np.ndarray):
        yield path, value
    elif is_dataclass(value) and not isinstance(value, type):
        for field in fields(value):
            yield from arrays_of(getattr(value, field.name), f"{path}.{field.name}")
    elif isinstance(value, (tuple, list)):
        for index, item in enumerate(value):
            yield from arrays_of(item, f"{path}[{index}]")


def first_difference(actual: Any, expected: Any, path: str = "") -> str:
    """Where nested results of nodes differ first, and how: `evaluator.metrics.frames: 3, expected 4`; "" if nowhere."""
    if isinstance(actual, Mapping) and isinstance(expected, Mapping):
        for key in sorted(actual.keys() | expected.keys(), key=str):
            place = f"{path}.{key}" if path else str(key)
            if key not in actual or key not in expected:
                return f"{place}: {'missing' if key in expected else 'found, expected nothing'}"
            if difference := first_difference(actual[key], expected[key], place):
                return difference
        if list(actual) != list(expected):
            return f"{path}: the order of its keys: {_text(list(actual))}, expected {_text(list(expected))}"
        return ""
    if isinstance(actual, (list, tuple)) and isinstance(expected, (list, tuple)) and len(actual) == len(expected):
        pairs = enumerate(zip(actual, expected, strict=True))
        return next(filter(None, (first_difference(*pair, f"{path}[{index}]") for index, pair in pairs)), "")
    if results.pack(actual) == results.pack(expected):
        return ""
    return f"{path}: {_text(actual)}, expected {_text(expected)}"


def _text(value: Any) -> str:
    return " ".join(str(value).split())[:100]


@contextmanager
def unchanged(subject: str, **inputs: Any) -> Iterator[None]:
    """Raise AssertionError if an input array has changed at the end of the block."""
    before = copy.deepcopy(inputs)
    yield
    for name, value in inputs.items():
        for (path, old), (_, new) in zip(arrays_of(before[name], name), arrays_of(value, name), strict=True):
            same = old.shape == new.shape and np.array_equal(old, new, equal_nan=old.dtype.kind == "f")
            expect(same, f"{subject}: changed its input {path}, expected unchanged inputs")


def expect_same(first: Any, second: Any, text: str) -> None:
    """Raise AssertionError with this text unless all arrays are equal, bit by bit."""
    for (path, a), (_, b) in zip(arrays_of(first, "result"), arrays_of(second, "result"), strict=True):
        expect(a.shape == b.shape, f"{text}: {path} has the shape {b.shape}, before {a.shape}")
        expect(np.array_equal(a, b, equal_nan=a.dtype.kind == "f"), f"{text}: {path} differs")


def expect_finite(value: Any, subject: str) -> None:
    """Raise AssertionError unless all numbers are finite."""
    for path, array in arrays_of(value, "result"):
        expect(
            array.dtype.kind != "f" or np.isfinite(array).all(), f"{subject}: {path} has numbers that are not finite"
        )
