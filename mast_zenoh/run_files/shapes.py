"""What files of a run folder may contain: names, and the types in JSON files."""

from __future__ import annotations

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
#: object. Null is allowed everywhere, and keys may be absent: nothing else about a file is promised.
ANY = "*"
NAMED = "*name"  # like ANY, for keys that are names: of nodes
_NUMBER = (int, float)
_COUNTS = {ANY: _NUMBER}


class _Name:
    """A string that `is_name` accepts."""


_NODE: dict[str, Any] = {
    **dict.fromkeys(("role", "ended", "log"), str),
    **dict.fromkeys(("last_frame", "restarts", "pid", "exit"), int),
    **{name: {} for name in ("rejected", "first_rejected", "foreign", "invalid_control")},
    "failures": [{}],
    "unaccepted": [str],
}
_LEG = {"key": str, "from": _Name, "from_port": str, "to": [_Name], "to_ports": [str], "before": str}
_WIRE: dict[str, Any] = {
    **dict.fromkeys(("key", "subject", "message", "publisher"), str),
    "subscribers": [str],
    "interposers": [str],
    "listeners": [{"node": _Name, "port": str, "source": bool, "key": str}],
    "legs": [_LEG],
}
_REPLAY = {"run": str, "folder": str, "from": str, "played": [str], "live": [str], "changed": {ANY: [str]}}
_LAUNCHER = {"pid": int, "began": str, "machine": str, "boot": str, "pid_namespace": str}
_HOST = {"reach": {}, "nodes": [str], "run_folder": str}

#: By file, the types that readers rely on.
SHAPES: dict[str, Any] = {
    "run.json": {
        **dict.fromkeys(("id", "name", "status", "message", "runtime", "security", "mode", "started"), str),
        **dict.fromkeys(("endpoint", "viewer_credentials", "kernels_not_used", "engine_plugin"), str),
        **dict.fromkeys(("seed", "frames"), int),
        "rate": _NUMBER,
        "command": (str, list),
        "launcher": _LAUNCHER,
        "versions": {ANY: str},
        "timings": {},
        "nodes": {NAMED: _NODE},
        "churn": [{"frame": int, "node": str, "what": str}],
        "steps": [{}],
        "recording": {"complete": bool, "from_frame": int},
        "recorded": {"messages": int, "malformed": int, "lost": int, "problem": str, "disk_full": bool},
        "notices": [{"kind": str, "text": str}],
        "innovations": {ANY: {}},
        "replay": _REPLAY,
        "deployment": {"engine": str, "label": str, "stack": str, "hosts": {ANY: _HOST}},
    },
    "scenario.json": {
        "name": _Name,
        "mode": str,
        "rate": _NUMBER,
        **dict.fromkeys(("seed", "frames", "period_ns", "leeway_ns"), int),
        "scene": {},
        "modules": [str],
        "timeline": [{"label": str, "kind": str, "at_s": _NUMBER, "until_s": _NUMBER, "nodes": [str]}],
        "network": {},
        "origin": [_NUMBER],
        "messages": [{}],
        "steps": [{"frame": int, "action": str, "node": str}],
        "nodes": {NAMED: {"role": str, "file": str, "type": str, "on_exit": str, "config": {}}},
    },
    "wiring.json": {"wires": [_WIRE], "overhearers": [{"node": _Name, "port": str}]},
    "metrics.json": {
        "agents": {ANY: {ANY: {}}},
        "same_as": {ANY: {ANY: str}},
        "scored_frames": [int],
        **{name: {ANY: {}} for name in ("latency_ms", "interposers", "achieved")},
    },
    "study.json": {"name": str},
}


def check_shape(content: Any, file: str) -> None:
    """Check content that was not read from a file, such as a recorded wiring; raises ValueError.

    file: the name of the file with such content
    """
    _check(content, SHAPES[file], "")


def _check(value: Any, shape: Any, place: str) -> None:
    """Raise ValueError, with the place, for a value of another shape."""
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
                _check(item, shape[0], f"{place}[{index}]")
        else:
            expected = "a list"
    elif shape is _Name:
        expected = None if is_name(value) else f"a name: {EXPECTED_NAME.removeprefix('expected ')}"
    elif not isinstance(value, shape) or (isinstance(value, bool) and shape is not bool):
        words = {str: "a string", bool: "true or false", int: "a whole number", (str, list): "a string or a list"}
        expected = words.get(shape, "a number")
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
            _check(item, inner, f"{place}.{key:.60}")
