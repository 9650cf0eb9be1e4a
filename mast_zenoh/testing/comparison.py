"""Compares results of a class, and detects changed inputs."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np


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
