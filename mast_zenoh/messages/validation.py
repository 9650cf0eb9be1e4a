"""Explains why columns are invalid; each check raises MessageError on failure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.errors import MessageError
from mast_zenoh.messages.layout import (
    DTYPE_NAME,
    MAX_MAGNITUDE,
    MAX_ROWS,
    MAX_SQUARES,
    MAX_TEXT,
    WIRE_DTYPE,
    limit_of,
)
from mast_zenoh.messages.schemas import Column, Message


def array_of(schema: str, column: Column, packed: Any, sizes: dict[str, int]) -> NDArray[Any]:
    """The array of a column packed as [dtype, shape, data]; sizes: see `check_shape`."""
    if not isinstance(packed, list) or len(packed) != 3:
        raise MessageError(f"{schema}.{column.name}: not [dtype, shape, data]")
    dtype, shape, data = packed
    if dtype != DTYPE_NAME[column.dtype]:
        raise MessageError(f"{schema}.{column.name}: dtype {str(dtype)[:20]}, expected {DTYPE_NAME[column.dtype]}")
    if not isinstance(shape, list) or not all(type(size) is int for size in shape):
        raise MessageError(f"{schema}.{column.name}: shape is not a list of whole numbers")
    check_shape(schema, column, tuple(shape), sizes)
    if column.dtype == "str":
        if not isinstance(data, list) or [len(data)] != shape:
            raise MessageError(f"{schema}.{column.name}: not a list of {shape[0]} short strings")
        check_strings(schema, column, data)
        strings = np.empty(len(data), dtype=object)
        strings[:] = data
        return strings
    wire = WIRE_DTYPE[column.dtype]
    if not isinstance(data, bytes) or len(data) != prod(shape) * wire.itemsize:
        raise MessageError(f"{schema}.{column.name}: data do not fill the shape {shape}")
    return np.frombuffer(data, dtype=wire).reshape(shape)


def check_shape(schema: str, column: Column, shape: tuple[int, ...], sizes: dict[str, int]) -> None:
    """Check a shape against the schema; adds the sizes of its letters to `sizes`."""
    if len(shape) == len(column.shape):
        for size, expected_size in zip(shape, column.shape, strict=True):
            if not 0 <= size <= MAX_ROWS:
                break
            if size != (sizes.setdefault(expected_size, size) if isinstance(expected_size, str) else expected_size):
                break
        else:
            return
    known = ", ".join(f"{name} = {size}" for name, size in sizes.items())
    expected = f"({', '.join(map(str, column.shape))})" + (f" with {known}" if known else "")
    raise MessageError(f"{schema}.{column.name}: shape {shape}, expected {expected}")


def check_strings(schema: str, column: Column, strings: Sequence[object] | NDArray[Any]) -> None:
    """Check that all items are text of at most MAX_TEXT characters."""
    if not all(isinstance(item, str) and len(item) <= MAX_TEXT for item in strings):
        raise MessageError(f"{schema}.{column.name}: not a list of {len(strings)} short strings")


def check_values(schema: str, column: Column, array: NDArray[Any]) -> None:
    """Check values: finite and plausible numbers, quaternions not zero, valid indices."""
    if column.dtype == "float64":
        # One pass without temporaries: the sum of squares is not finite, or too large, if any value is.
        # The mean is limited, not the sum, so that a message collated from many valid ones is valid.
        flat = array.reshape(-1)
        squares = np.vdot(flat, flat)
        if not squares <= MAX_SQUARES * max(len(flat), 1):
            raise MessageError(f"{schema}.{column.name}: a value is not finite or beyond {MAX_MAGNITUDE:g}")
        if squares < limit_of(column):
            raise MessageError(f"{schema}.{column.name}: a quaternion of length 0 is not a rotation")
    elif column.dtype == "uint8" and array.size and int(array.max()) >= column.below:
        raise MessageError(f"{schema}.{column.name}: index {int(array.max())}, expected below {column.below}")


def check_references(message: Message) -> None:
    """Check relations between columns: row numbers exist, ids are unique."""
    schema, body = message.header.schema, message.body
    if schema == "collated":
        agent, rows = body["agent"], len(body["agents"])
        if agent.size and not (agent.min() >= 0 and agent.max() < rows):
            raise MessageError(f"collated.agent: a row outside `agents`, which has {rows}")
    elif schema in ("tracks", "picture") and len(set(body["id"].tolist())) != len(body["id"]):
        raise MessageError(f"{schema}.id: an id occurs twice")


def names_differ(schema: str, body: Any, columns: tuple[Column, ...]) -> str:
    """An error message that lists the missing and the unknown columns of a body."""
    expected = {column.name for column in columns}
    actual = set(map(str, body)) if isinstance(body, Mapping) else set()
    return f"{schema}: columns missing: {sorted(expected - actual)}, unknown: {sorted(actual - expected)[:8]}"
