"""A closed YAML reader: mappings, lists, text, numbers, and NumPy numbers and arrays. It never makes other objects.

It builds values from the parser's events itself. So no tag can name a class or a function to call, the depth and the
number of values are limited, and an alias counts as all the values that it stands for.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from mast_zenoh.errors import SceneError
from mast_zenoh.scenes.files.elements import Element, read_text
from mast_zenoh.scenes.opv2v.numpy_tags import PREFIX, decode_binary, decode_container, decode_name

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
