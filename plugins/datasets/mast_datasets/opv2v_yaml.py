"""Reads the YAML files of OPV2V."""

from __future__ import annotations

import base64
import binascii
import math
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from mast_datasets.files import Element
from mast_zenoh.errors import SceneError
from mast_zenoh.scenes.detection_tables import read_text

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


_MAX_BYTES = 50_000_000  # of one file
_MAX_DEPTH = 32
_MAX_VALUES = 2_000_000  # of one file, aliases expanded
_MAX_DIGITS = 40  # of a number
_LETTERS = 16  # of text, or of the bytes of an array, that count as one more value

_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # only its parser is used; the C library is optional
_WHOLE = re.compile(r"[-+]?(0|[1-9][0-9]*)")
_REAL = re.compile(r"[-+]?([0-9]+\.[0-9]*|\.[0-9]+|[0-9]+(?=[eE]))([eE][-+]?[0-9]+)?")
_WORDS: dict[str, Any] = dict.fromkeys(("", "~", "null", "Null", "NULL"))
_WORDS |= dict.fromkeys(("true", "True", "TRUE"), True) | dict.fromkeys(("false", "False", "FALSE"), False)
_WORDS |= {sign + name: float(sign + "inf") for sign in ("", "+", "-") for name in (".inf", ".Inf", ".INF")}
_WORDS |= dict.fromkeys((".nan", ".NaN", ".NAN"), float("nan"))


class _Refused(ValueError):
    """The text is YAML, but not of the closed form."""


@dataclass(slots=True)
class _Container:
    """A mapping or a list that is being read.

    members: a dict or a list; key: of the value that follows, in a mapping
    weight: number of values in it, aliases expanded; line: where it begins
    """

    members: Any
    tag: str | None
    anchor: str | None
    line: int
    weight: int = 1
    key: Any = None
    has_key: bool = field(default=False)


def read_yaml(path: Path) -> Element:
    """The content of a YAML file.

    Raises SceneError if it is missing, too large, not YAML, too deep, or has a key twice or a tag that is not known.
    """
    try:
        size = path.stat().st_size
    except OSError as error:
        raise SceneError(f"{path}: {error}") from error
    if size > _MAX_BYTES:
        raise SceneError(f"{path}: found {size} bytes, expected at most {_MAX_BYTES}")
    text = read_text(path)
    try:
        return Element(_value(text), path)
    except _Refused as error:
        raise SceneError(f"{path}: {error}") from error
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise SceneError(f"{path}: not YAML: {' '.join(str(error).split())}") from error


def _value(text: str) -> Any:
    """The value of the only document of a text."""
    stack: list[_Container] = []
    anchors: dict[str, tuple[Any, int]] = {}
    documents: list[Any] = []
    total = 0
    for event in yaml.parse(text, Loader=_LOADER):
        kind = type(event)
        if kind is yaml.ScalarEvent:
            value, weight = _scalar(event), 1 + len(event.value) // _LETTERS
            if event.anchor is not None:
                anchors[event.anchor] = value, weight
        elif kind is yaml.AliasEvent:
            if event.anchor not in anchors:
                raise _Refused(f"{_line(event)}: found the alias *{event.anchor}, expected one of a value before it")
            value, weight = anchors[event.anchor]
        elif kind is yaml.MappingStartEvent or kind is yaml.SequenceStartEvent:
            if len(stack) == _MAX_DEPTH:
                raise _Refused(f"{_line(event)}: nested deeper than {_MAX_DEPTH} levels")
            members: Any = {} if kind is yaml.MappingStartEvent else []
            stack.append(_Container(members, event.tag, event.anchor, event.start_mark.line))
            continue
        elif kind is yaml.MappingEndEvent or kind is yaml.SequenceEndEvent:
            closed = stack.pop()
            value, weight = _closed(closed), closed.weight
            if closed.anchor is not None:
                anchors[closed.anchor] = value, weight
            total -= weight - 1  # it is added again, as a value of its parent
        else:
            continue
        total += weight
        if total > _MAX_VALUES:
            raise _Refused(f"{_line(event)}: more than {_MAX_VALUES} values, aliases included")
        if stack:
            _add(stack[-1], value, weight, event)
        else:
            documents.append(value)
    if len(documents) != 1:
        raise _Refused(f"found {len(documents)} documents, expected one")
    return documents[0]


def _add(parent: _Container, value: Any, weight: int, event: Any) -> None:
    """Put a value into the container that is being read."""
    parent.weight += weight
    if type(parent.members) is list:
        parent.members.append(value)
    elif parent.has_key:
        parent.members[parent.key] = value
        parent.has_key = False
    else:
        if value is not None and not isinstance(value, (str, int, float)):
            raise _Refused(f"{_line(event)}: found a key that is no text or number")
        if value in parent.members:
            raise _Refused(f"{_line(event)}: found the key {str(value)[:_MAX_DIGITS]} twice, expected it once")
        parent.key, parent.has_key = value, True


def _scalar(event: Any) -> Any:
    """The value of a scalar: of a plain one a number or a word, else text."""
    text: str = event.value
    if event.tag is not None:
        if event.tag.startswith(PREFIX):
            return _tagged(lambda: decode_name(event.tag, text), event.start_mark.line)
        if event.tag == "tag:yaml.org,2002:binary":
            return _tagged(lambda: decode_binary(text), event.start_mark.line)
        if event.tag != "!":  # which says that it is text
            raise _Refused(f"{_line(event)}: found the tag {event.tag}, expected text or a number")
        return text
    if not event.implicit[0]:
        return text
    if text in _WORDS:
        return _WORDS[text]
    if len(text) > _MAX_DIGITS:
        return text
    if _WHOLE.fullmatch(text):
        return int(text)
    return float(text) if _REAL.fullmatch(text) else text


def _closed(container: _Container) -> Any:
    """The value of a container that is complete."""
    if container.has_key:
        raise _Refused(f"line {container.line + 1}: found a key without a value")
    if container.tag is None:
        return container.members
    tag, members = container.tag, container.members
    return _tagged(lambda: decode_container(tag, members), container.line)


def _tagged(decode: Callable[[], Any], line: int) -> Any:
    """What `decode` returns; its ValueError names the line."""
    try:
        return decode()
    except ValueError as error:
        raise _Refused(f"line {line + 1}: {error}") from error


def _line(event: Any) -> str:
    return f"line {event.start_mark.line + 1}"
