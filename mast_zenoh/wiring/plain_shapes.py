"""Plain values, as in JSON: names that are safe everywhere, and the types of what objects and lists hold."""

from __future__ import annotations

import math
import re
from typing import Any

MAX_NAME = 100
#: Path separators, special characters of key expressions, control characters, and surrogates (bytes that are not text).
REFUSED = re.compile(r"[/\\*#?$\x00-\x1f\x7f\ud800-\udfff]")
EXPECTED_NAME = f"expected at most {MAX_NAME} characters, none of / \\ * # ? $, and no . at the beginning"


def is_name(text: object) -> bool:
    """Whether a name is safe as a part of a path and of a key expression."""
    return isinstance(text, str) and 0 < len(text) <= MAX_NAME and not REFUSED.search(text) and text[0] != "."


_MAX_INT = 1 << 63

#: A shape is a type or a tuple of types, [shape of all items], {key: shape} or {ANY: shape of all values}; {} is any
#: object. Null is allowed everywhere, and keys may be absent: nothing else about a value is promised.
ANY = "*"
NAMED = "*name"  # like ANY, for keys that are names: of nodes
NUMBER = (int, float)


class Name:
    """A string that `is_name` accepts."""


def check_shape(value: Any, shape: Any, place: str = "") -> None:
    """Raise ValueError, with the place, for a value of another shape. place: of the value in what is checked"""
    if value is None and place:
        return
    expected: str | None = None
    if isinstance(shape, dict):
        if isinstance(value, dict):
            _check_object(value, shape, place)
        else:
            expected = "an object"
    elif isinstance(shape, list):
        if isinstance(value, list):
            for index, item in enumerate(value):
                check_shape(item, shape[0], f"{place}[{index}]")
        else:
            expected = "a list"
    elif shape is Name:
        expected = None if is_name(value) else f"a name: {EXPECTED_NAME.removeprefix('expected ')}"
    elif not isinstance(value, shape) or (isinstance(value, bool) and shape is not bool):
        words = {str: "a string", bool: "true or false", int: "a whole number", (str, list): "a string or a list"}
        expected = words.get(shape, "a number")
    elif isinstance(value, float) and not math.isfinite(value):
        expected = "a finite number"
    elif isinstance(value, int) and not -_MAX_INT <= value < _MAX_INT:
        expected = "a number of 64 bits"
    if expected is not None:
        raise ValueError(f"{place.lstrip('.') or 'content'}: found {value!r:.60}, expected {expected}")


def _check_object(value: dict[str, Any], shape: dict[str, Any], place: str) -> None:
    for key, item in value.items():
        if NAMED in shape and not is_name(key):
            raise ValueError(f"{place.lstrip('.')}: found {key!r:.60} as a name, {EXPECTED_NAME}")
        inner = shape.get(key, shape.get(ANY, shape.get(NAMED)))
        if inner is not None:
            check_shape(item, inner, f"{place}.{key:.60}")
