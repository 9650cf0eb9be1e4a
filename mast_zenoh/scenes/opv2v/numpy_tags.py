"""NumPy numbers and arrays as PyYAML writes them, decoded from their bytes.

PyYAML's tags ask the reader to call a function or to find a class by its name. Here a tag is only compared with the
few that numbers and arrays have, and their bytes are read as numbers. Nothing is imported or called by name.
"""

from __future__ import annotations

import base64
import binascii
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

#: What all of Python's tags begin with.
PREFIX = "tag:yaml.org,2002:python/"

_APPLY = PREFIX + "object/apply:numpy."
_TUPLE = PREFIX + "tuple"
_DTYPE = _APPLY + "dtype"
_SCALAR = tuple(_APPLY + module + ".multiarray.scalar" for module in ("core", "_core"))
_ARRAY = tuple(_APPLY + module + ".multiarray._reconstruct" for module in ("core", "_core"))
_ARRAY_CLASS = PREFIX + "name:numpy.ndarray"
_TYPES = {"f4", "f8", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8", "b1"}
_ORDERS = {"<": "<", "=": "<", "|": "<", ">": ">"}  # written on machines that are little-endian
_MAX_AXES = 4


@dataclass(frozen=True)
class _Type:
    """The type of the numbers of an array. code: such as "<f8"."""

    code: str


class _ArrayClass:
    """Stands for the name of the array class."""


def decode_name(tag: str, text: str) -> Any:
    """The value of a scalar with one of Python's tags: only the name of the array class is known.

    Raises ValueError for all others.
    """
    if tag != _ARRAY_CLASS or text:
        raise ValueError(f"found the tag {tag}, expected text, a number or a NumPy array")
    return _ArrayClass()


def decode_binary(text: str) -> bytes:
    """The bytes of a binary scalar. Raises ValueError if it is not base64."""
    try:
        return base64.b64decode("".join(text.split()), validate=True)
    except (binascii.Error, ValueError) as error:
        raise ValueError(f"found binary data that is not base64: {error}") from error


def decode_container(tag: str, members: Any) -> Any:
    """The value of a list or a mapping with a tag: a list, a number, a list of numbers, or the type of numbers.

    members: as read. Raises ValueError for a tag that is not known, and for data that does not fit it.
    """
    if tag == _TUPLE and isinstance(members, list):
        return members
    if tag == _DTYPE:
        return _decode_type(*_parts(members, 3))
    if tag in _SCALAR:
        return _decode_scalar(*_parts(members, 2))
    if tag in _ARRAY:
        return _decode_array(*_parts(members, 3))
    raise ValueError(f"found the tag {tag}, expected a mapping, a list or a NumPy array")


def _parts(members: Any, count: int) -> tuple[list[Any], Any]:
    """Arguments and state of an object, of which there may be no state."""
    arguments, state = members, None
    if isinstance(members, dict):
        if not set(members) <= {"args", "state"} or "args" not in members:
            raise ValueError(f"found a NumPy value with {', '.join(map(str, members))}, expected args and state")
        arguments, state = members["args"], members.get("state")
    if not isinstance(arguments, list) or len(arguments) != count:
        raise ValueError(f"found a NumPy value with other arguments, expected {count}")
    return arguments, state


def _decode_type(arguments: list[Any], state: Any) -> _Type:
    code = arguments[0]
    if not isinstance(code, str) or code not in _TYPES:
        raise ValueError(f"found NumPy numbers of type {str(code)[:20]}, expected one of {', '.join(sorted(_TYPES))}")
    order = "<"
    if state is not None:
        if not isinstance(state, list) or len(state) < 2 or not isinstance(state[1], str) or state[1] not in _ORDERS:
            raise ValueError("found a NumPy type with an unknown byte order, expected <, > or |")
        order = _ORDERS[state[1]]
    return _Type(order + code)


def _decode_scalar(arguments: list[Any], state: Any) -> Any:
    if state is not None:
        raise ValueError("found a NumPy number with a state, expected type and bytes")
    return _numbers(arguments[0], arguments[1], 1)[0].item()


def _decode_array(arguments: list[Any], state: Any) -> Any:
    """Nested lists of the numbers of an array; a single number of one without axes."""
    if not isinstance(arguments[0], _ArrayClass):
        raise ValueError("found a NumPy value of another class, expected an array")
    if not isinstance(state, list) or len(state) != 5:
        raise ValueError("found a NumPy array with another state, expected version, shape, type, order and bytes")
    _, shape, kind, columns_first, data = state
    if (
        not isinstance(shape, list)
        or len(shape) > _MAX_AXES
        or not all(isinstance(n, int) and not isinstance(n, bool) and n >= 0 for n in shape)
    ):
        raise ValueError(f"found a NumPy array of shape {str(shape)[:40]}, expected up to {_MAX_AXES} whole numbers")
    if not isinstance(columns_first, (bool, int)):
        raise ValueError("found a NumPy array with an unknown order of its axes, expected true or false")
    numbers = _numbers(kind, data, math.prod(shape))
    return numbers.reshape(shape, order="F" if columns_first else "C").tolist()


def _numbers(kind: Any, data: Any, count: int) -> np.ndarray[Any, Any]:
    if not isinstance(kind, _Type):
        raise ValueError("found NumPy data without its type, expected one")
    dtype = np.dtype(kind.code)
    if not isinstance(data, bytes) or len(data) != count * dtype.itemsize:
        size = len(data) if isinstance(data, bytes) else 0
        raise ValueError(f"found {size} bytes of NumPy data, expected {count} of {dtype.itemsize}")
    return np.frombuffer(data, dtype)
