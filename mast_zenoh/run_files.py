"""Files of a run folder: names, bounded reading, and writing that never follows a link.

A run folder is data, and may come from anybody: what is in it neither runs, nor hangs or fills its reader, nor makes it
write elsewhere. All that reads or rewrites a run folder goes through this module.
"""

from __future__ import annotations

import json
import os
import re
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from mast_zenoh.errors import RunFolderError

# -- names -------------------------------------------------------------------------------------------------------------

MAX_NAME = 100
#: Path separators, special characters of key expressions, control characters, and surrogates (bytes that are not text).
REFUSED = re.compile(r"[/\\*#?$\x00-\x1f\x7f\ud800-\udfff]")
EXPECTED_NAME = f"expected at most {MAX_NAME} characters, none of / \\ * # ? $, and no . at the beginning"


def is_name(text: object) -> bool:
    """Whether a name is safe as a part of a path and of a key expression."""
    return isinstance(text, str) and 0 < len(text) <= MAX_NAME and not REFUSED.search(text) and text[0] != "."


# -- reading -----------------------------------------------------------------------------------------------------------

#: Limits of a JSON file. A run of a thousand agents needs a tenth of each; the largest content takes about 150 MB.
MAX_JSON_BYTES = 32 << 20
MAX_DEPTH = 64
MAX_CONTAINERS = 200_000
MAX_ITEMS = 2_000_000
_MAX_INT = 1 << 63


def check_regular(path: Path) -> Path:
    """Return the path; raises RunFolderError for a device, a pipe, a socket or a folder: reading it may never end.

    Raises FileNotFoundError if there is none.
    """
    mode = path.stat().st_mode
    if not stat.S_ISREG(mode):
        raise RunFolderError(f"{path}: found {_kind(mode)}, expected a file")
    return path


def read_json(path: Path, *, shaped: bool = True) -> Any:
    """The content of a JSON file; that of run.json and of others in SHAPES has the types that they promise.

    shaped: whether these types are checked

    Raises RunFolderError for a file that is missing, is no plain file, is too large, or has another content.
    """
    try:
        content = parse_json(_bytes(path))
        if shaped and path.name in SHAPES:
            _check(content, SHAPES[path.name], "")
    except FileNotFoundError:
        raise RunFolderError(f"{path}: missing; is {path.parent} a run folder?") from None
    except OSError as error:
        raise RunFolderError(f"{path}: cannot be read: {error.strerror or error}") from None
    except ValueError as error:
        raise RunFolderError(f"{path}: cannot be read: {error}") from None
    return content


def read_object(path: Path, *, shaped: bool = True) -> dict[str, Any]:
    """The object in a JSON file; raises RunFolderError as `read_json` does."""
    content = read_json(path, shaped=shaped)
    if not isinstance(content, dict):
        raise RunFolderError(f"{path}: cannot be read: found {type(content).__name__}, expected an object")
    return content


@contextmanager
def reading(folder: Path) -> Iterator[None]:
    """Turn errors that only contents of a run folder explain into RunFolderError.

    SHAPES has what every run has; nodes of users add what they like.
    """
    try:
        yield
    except (TypeError, ValueError, LookupError, AttributeError, ArithmeticError, RecursionError) as error:
        description = " ".join(f"{type(error).__name__}: {error}".split())
        raise RunFolderError(f"{folder}: its contents cannot be used: {description:.300}") from error


def parse_json(content: bytes | str) -> Any:
    """JSON of limited size and depth; raises ValueError for any other."""
    data = content.encode("utf-8", "surrogatepass") if isinstance(content, str) else content
    if len(data) > MAX_JSON_BYTES:
        raise ValueError(f"found {len(data)} bytes of JSON, expected at most {MAX_JSON_BYTES}")
    if data.count(b"[") + data.count(b"{") > MAX_CONTAINERS or data.count(b",") > MAX_ITEMS:
        raise ValueError(f"expected JSON with at most {MAX_CONTAINERS} objects and lists, and {MAX_ITEMS} items")
    try:
        value = json.loads(data)
    except RecursionError:
        value = None
        depth = MAX_DEPTH + 1
    else:
        depth = _depth(value)
    if depth > MAX_DEPTH:
        raise ValueError(f"found JSON that is nested more than {MAX_DEPTH} levels deep")
    if b"\\u" in data:  # a lone surrogate cannot be written anywhere; bytes of paths that are not UTF-8 can
        json.dumps(value, ensure_ascii=False).encode("utf-8", "surrogateescape")
    return value


def _bytes(path: Path) -> bytes:
    """The content of a file, unless it is a link, is no plain file or is too large."""
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOFOLLOW | os.O_CLOEXEC)
    except OSError:
        if path.is_symlink():
            raise ValueError("found a link, expected a file") from None
        raise
    with os.fdopen(descriptor, "rb") as file:
        status = os.fstat(descriptor)
        if not stat.S_ISREG(status.st_mode):
            raise ValueError(f"found {_kind(status.st_mode)}, expected a file")
        if status.st_size > MAX_JSON_BYTES:
            raise ValueError(f"found {status.st_size} bytes of JSON, expected at most {MAX_JSON_BYTES}")
        return file.read(MAX_JSON_BYTES + 1)


def _kind(mode: int) -> str:
    return "a folder" if stat.S_ISDIR(mode) else "a pipe" if stat.S_ISFIFO(mode) else "a special file"


def _depth(value: Any) -> int:
    """How many objects and lists are inside each other, up to one more than MAX_DEPTH."""
    depth, level = 0, [value] if isinstance(value, (dict, list)) else []
    while level and depth <= MAX_DEPTH:
        depth += 1
        level = [
            item
            for each in level
            for item in (each.values() if isinstance(each, dict) else each)
            if isinstance(item, (dict, list))
        ]
    return depth


# -- content -----------------------------------------------------------------------------------------------------------

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
}
_LEG = {"key": str, "from": _Name, "from_port": str, "to": [_Name], "to_ports": [str], "before": str}
_WIRE: dict[str, Any] = {
    **dict.fromkeys(("key", "subject", "message", "publisher"), str),
    "subscribers": [str],
    "interposers": [str],
    "listeners": [{"node": _Name, "port": str, "source": str, "key": str}],
    "legs": [_LEG],
}
_REPLAY = {"run": str, "folder": str, "from": str, "played": [str], "live": [str], "changed": {ANY: [str]}}
_LAUNCHER = {"pid": int, "began": str, "machine": str, "boot": str, "pid_namespace": str}
_HOST = {"reach": {}, "nodes": [str], "run_folder": str}

#: By file, the types that readers rely on.
SHAPES: dict[str, Any] = {
    "run.json": {
        **dict.fromkeys(("id", "name", "status", "message", "runtime", "security", "mode", "started"), str),
        **dict.fromkeys(("endpoint", "viewer_credentials"), str),
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


# -- writing -----------------------------------------------------------------------------------------------------------


def subfolder(folder: Path, *names: str) -> Path:
    """A folder inside a run folder, created if needed; raises RunFolderError if one of its parts is a link."""
    for name in names:
        folder = folder / name
        with suppress(FileExistsError):
            folder.mkdir(parents=True)
        if folder.is_symlink() or not folder.is_dir():
            found = "a link" if folder.is_symlink() else "a file"
            raise RunFolderError(f"{folder}: found {found}, expected a folder: remove it")
    return folder


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A new file that takes the place of `path`, whole or not at all, at the end of the block.

    A link there is replaced, and never followed. Raises RunFolderError if a folder is in the way.
    """
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=".new-", suffix=path.suffix)
    os.close(handle)
    try:
        yield Path(name)
        os.chmod(name, 0o644)
        os.replace(name, path)
    except BaseException as error:
        with suppress(FileNotFoundError):
            os.unlink(name)
        if isinstance(error, IsADirectoryError):
            raise RunFolderError(f"{path}: found a folder, expected a file: remove it") from None
        raise


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file of a run folder; see `replacing`."""
    with replacing(path) as new:
        new.write_bytes(content)
