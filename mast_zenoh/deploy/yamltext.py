"""Writes plain values as readable YAML, the subset for Compose and Swarm files."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from typing import Any

_PLAIN = re.compile(r"[A-Za-z_][\w./-]*")
_WORDS = frozenset({"true", "false", "yes", "no", "on", "off", "null", "y", "n"})


class Anchored(dict[str, Any]):
    """A mapping with an anchor, `KEY: &name`, that others can merge in."""

    def __init__(self, name: str, content: Mapping[str, Any]) -> None:
        super().__init__(content)
        self.name = name


class Merged(str):
    """The value of the key `<<`: the name of the anchor to merge in."""


class Interpolated(str):
    """Text in which Compose replaces `${VARIABLE:-default}`."""


def dump(content: Mapping[str, Any]) -> str:
    """The YAML text; lists of plain values are on one line.

    `$` in strings is doubled, for Compose, except in Interpolated.
    """
    return "\n".join(_mapping(content, "")) + "\n"


def _mapping(content: Mapping[str, Any], indent: str) -> Iterator[str]:
    for key, value in content.items():
        if isinstance(value, Anchored):
            yield f"{indent}{_scalar(key)}: &{value.name}"
            yield from _mapping(value, indent + "  ")
        elif isinstance(value, Mapping) and value:
            yield f"{indent}{_scalar(key)}:"
            yield from _mapping(value, indent + "  ")
        elif isinstance(value, (list, tuple)) and any(isinstance(item, Mapping) for item in value):
            yield f"{indent}{_scalar(key)}:"
            for item in value:
                first, *others = _mapping(item, indent + "    ")
                yield f"{indent}  - {first.strip()}"
                yield from others
        elif isinstance(value, Merged):
            yield f"{indent}<<: *{value}"
        else:
            yield f"{indent}{_scalar(key)}: {_inline(value)}"


def _inline(value: Any) -> str:
    if isinstance(value, Mapping):
        return "{}"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(_scalar(item) for item in value) + "]"
    return _scalar(value)


def _scalar(value: Any) -> str:
    if isinstance(value, float):
        digits, exponent, power = json.dumps(value).partition("e")
        return f"{digits if '.' in digits else f'{digits}.0'}{exponent}{power}"  # YAML 1.1 requires the point
    if not isinstance(value, str):
        return json.dumps(value)
    if isinstance(value, Interpolated):
        return quoted(value)
    if _PLAIN.fullmatch(value) and value.lower() not in _WORDS:
        return value
    return quoted(value.replace("$", "$$"))


def quoted(text: str) -> str:
    """Text in double quotes on one line, also for comments; characters that are not printable are escaped."""
    written = json.dumps(text, ensure_ascii=False)
    return "".join(each if each.isprintable() else f"\\U{ord(each):08x}" for each in written)
