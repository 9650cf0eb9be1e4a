"""Strict readers of a control message's fields: a typed value, or MessageError."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection
from typing import Any

import msgpack

from mast_zenoh.control import CONTROLS
from mast_zenoh.errors import MessageError

MAX_NAME = 256  #: characters of the name of a node
MAX_KEY = 1024  #: characters of a key
MAX_NUMBER = 1 << 62  #: counters, frames, times in ns: less than this
MAX_ENTRIES = 1 << 16  #: entries of a list or a map
MAX_VALUES = 1 << 19  #: lists, maps and their entries in one message

_NAME = re.compile(r"[A-Za-z0-9_.\-]+")
_KEY = re.compile(r"[A-Za-z0-9_.\-@]+(/[A-Za-z0-9_.\-@]+)*")
_ONE_STR, _ONE_INT = {str}, {int}


def unpack(payload: bytes, what: str, max_bytes: int = 0) -> Any:
    """Unpack a control message of a kind; max_bytes: 0 for the limit in CONTROLS."""
    fits(payload, what, max_bytes)
    count = at_most(MAX_VALUES, what)
    limits = {"max_ext_len": 0, "max_map_len": MAX_ENTRIES, "max_array_len": MAX_ENTRIES}
    try:
        return msgpack.unpackb(payload, strict_map_key=True, object_hook=count, list_hook=count, **limits)
    except MessageError:
        raise
    except Exception as error:  # msgpack has several, and UnicodeDecodeError
        raise MessageError(f"{what}: not MessagePack: {type(error).__name__}: {str(error)[:100]}") from None


def at_most(values: int, what: str) -> Callable[[Any], Any]:
    """A hook for msgpack that limits the number of values in all lists and maps.

    It raises MessageError beyond that number.
    An empty list takes one byte in a message and eighty in memory, so a limit of bytes is not enough.
    """
    remaining = values

    def counted(container: Any) -> Any:
        nonlocal remaining
        remaining -= 1 + len(container)
        if remaining < 0:
            raise MessageError(f"{what}: found more than {values} values")
        return container

    return counted


def fits(payload: bytes, what: str, max_bytes: int = 0) -> None:
    """Raise MessageError for a message that is too long for its kind."""
    limit = max_bytes or CONTROLS[what].max_bytes
    if len(payload) > limit:
        raise MessageError(f"{what}: found {len(payload)} bytes, expected at most {limit}")


def plain_text(payload: bytes, what: str) -> str:
    """Decode a message that is plain UTF-8 text."""
    fits(payload, what)
    try:
        return payload.decode()
    except UnicodeDecodeError:
        raise MessageError(f"{what}: found bytes that are not UTF-8") from None


def items(value: object, count: int, what: str) -> list[Any]:
    """A list of exactly `count` items."""
    if type(value) is not list or len(value) != count:
        raise MessageError(f"{what}: found {abbreviated(value)}, expected a list of {count}")
    return value


def listed(value: object, what: str) -> list[Any]:
    """A list of any length."""
    if type(value) is not list:
        raise MessageError(f"{what}: found {abbreviated(value)}, expected a list")
    return value


def fields(value: object, names: Collection[str], what: str, optional: Collection[str] = ()) -> dict[str, Any]:
    """A map with exactly these names; optional ones may be missing."""
    if type(value) is not dict:
        raise MessageError(f"{what}: found {abbreviated(value)}, expected a map")
    for name in names:
        if name not in value and name not in optional:
            raise MessageError(f"{what}: {name} is missing")
    for name in value:
        if name not in names:
            raise MessageError(f"{what}: found {abbreviated(name)}, expected only {', '.join(names)}")
    return value


def mapping(value: object, what: str) -> dict[str, Any]:
    """A map whose keys are strings."""
    if type(value) is not dict or not {*map(type, value)} <= _ONE_STR:
        raise MessageError(f"{what}: found {abbreviated(value)}, expected a map of strings")
    return value


def whole(value: object, what: str, least: int = 0, below: int = MAX_NUMBER) -> int:
    """A whole number, `least` <= value < `below`."""
    if type(value) is not int or not least <= value < below:
        raise MessageError(f"{what}: found {abbreviated(value)}, expected a whole number from {least} to below {below}")
    return value


def finite(value: object, what: str, limit: float = 1e15) -> float:
    """A finite number of at most this magnitude."""
    if type(value) not in (int, float) or not math.isfinite(value) or abs(value) > limit:  # type: ignore[arg-type]
        raise MessageError(f"{what}: found {abbreviated(value)}, expected a finite number")
    return float(value)  # type: ignore[arg-type]


def flag(value: object, what: str) -> bool:
    """True or false."""
    if type(value) is not bool:
        raise MessageError(f"{what}: found {abbreviated(value)}, expected true or false")
    return value


def text(value: object, what: str, limit: int = 4096) -> str:
    """A text of at most `limit` characters."""
    if type(value) is not str or len(value) > limit:
        raise MessageError(f"{what}: found {abbreviated(value)}, expected a string of at most {limit} characters")
    return value


def line(value: object, what: str, limit: int = 4096) -> str:
    """A text of one line, of at most `limit` characters."""
    if len(text(value, what, limit).splitlines()) > 1:
        raise MessageError(f"{what}: found several lines, expected one")
    return value  # type: ignore[return-value]


def name(value: object, what: str) -> str:
    """The name of a node, or of a role."""
    if type(value) is not str or len(value) > MAX_NAME or not _NAME.fullmatch(value):
        raise MessageError(f"{what}: found {abbreviated(value)}, expected a name of letters, digits, '_', '.', '-'")
    return value


def names(value: object, what: str) -> tuple[str, ...]:
    """A list of unique names."""
    result = tuple(name(item, what) for item in listed(value, what))
    if len({*result}) != len(result):
        raise MessageError(f"{what}: found a name twice")
    return result


def roles(value: object, what: str) -> dict[str, str]:
    """A map from names of nodes to their roles."""
    return {name(node, what): name(role, what) for node, role in mapping(value, what).items()}


def key(value: object, what: str) -> str:
    """A key below the run's prefix: chunks without wildcards, joined by slashes."""
    if type(value) is not str or len(value) > MAX_KEY or not _KEY.fullmatch(value):
        raise MessageError(f"{what}: found {abbreviated(value)}, expected a key without wildcards")
    return value


def counters(value: object, what: str) -> dict[str, int]:
    """A map from strings to whole numbers from 0. Called for every frame, so optimised."""
    try:
        "".join(value)  # type: ignore[arg-type]  # the fastest check that all are strings
        if type(value) is dict and _are_counts(value.values()):
            return value
    except TypeError:
        pass
    raise MessageError(f"{what}: found {abbreviated(value)}, expected counters by key: whole numbers from 0")


def _are_counts(values: Collection[Any]) -> bool:
    return not values or ({*map(type, values)} == _ONE_INT and min(values) >= 0 and max(values) < MAX_NUMBER)


def abbreviated(value: object) -> str:
    """A value for an error message, shortened."""
    if type(value) in (dict, list):
        return f"a {type(value).__name__} of {len(value)}"  # type: ignore[arg-type]
    return repr(value[:40])[:60] if isinstance(value, (str, bytes)) else repr(value)[:60]
