"""Failures of handlers: counted by nodes, merged and formatted by the launcher.

An entry is a failure as plain values, as in messages and in run.json:

    {"handler": "on_detections", "count": 19, "frames": 19, "first_frame": 11, "last_frame": 29,
     "exception": "ZeroDivisionError: division by zero", "where": "/home/me/shover.py:31"}
"""

from __future__ import annotations

import sysconfig
import traceback
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec

from mast_zenoh.config import bundle, plugins
from mast_zenoh.errors import HandlerFailed
from mast_zenoh.mesh.control import codec
from mast_zenoh.mesh.control.codec import ControlMessage, FrameOrNone, Id, Line, Positive, ShortLine

Entry = dict[str, Any]

MAX_HANDLERS = 256  #: handlers of which one process may report failures
_MAX_TEXT = 300
_PACKAGE = Path(__file__).parents[2]
_PYTHON = sysconfig.get_path("stdlib")
_INSTALLED = {"site-packages", "dist-packages"}
#: Parts of the package that a node calls: an error raised there is attributed to the caller.
_PLUMBING = {"mesh", "kernels", "node.py", "wiring", "messages"}


#: Folders of shipped files besides the package.
_SHIPPED = ("nodes", "scenarios", "studies")


class Failure:
    """The failures of one handler, with the exception of the first.

    frames: the frames in which it failed
    """

    def __init__(self, handler: str, error: BaseException, call: Callable[..., Any]) -> None:
        self.handler = handler
        self.count = 0
        self.frames: set[int] = set()
        self.exception = described(error)
        self.where = location(error, call)

    def note(self, frame: int) -> None:
        """Count one more failure."""
        self.count += 1
        self.frames.add(frame)

    def entry(self) -> Entry:
        """The failure as plain values."""
        return {
            "handler": self.handler,
            "count": self.count,
            "frames": len(self.frames),
            "first_frame": min(self.frames),
            "last_frame": max(self.frames),
            "exception": self.exception,
            "where": self.where,
        }


class FailureEntry(ControlMessage, frozen=True):
    """An entry, as a message holds it."""

    handler: ShortLine
    count: Positive
    frames: Positive
    first_frame: FrameOrNone
    last_frame: FrameOrNone
    exception: ShortLine
    where: Line


def encode_failure(process: str, entry: Entry) -> bytes:
    """Encode the failures of one handler in one process of a node."""
    return codec.encode((process, entry))


def decode_failure(payload: bytes) -> tuple[str, Entry]:
    """(process, failures of one handler in it); raises MessageError."""
    process, entry = codec.decode(tuple[Id, FailureEntry], payload, "failed")
    return process, msgspec.structs.asdict(entry)


def described(error: BaseException) -> str:
    """The type and text of an exception on one line of at most 300 characters."""
    try:
        text = " ".join(str(error).split())
    except Exception:  # a user's exception may fail to format itself
        text = ""
    name = type(error).__name__
    return f"{name}: {text}"[:_MAX_TEXT] if text else name


def location(error: BaseException, call: Callable[..., Any]) -> str:
    """`file:line` of the innermost frame in a user's file, then, if it is elsewhere, of the one that raised the error.

    Without a user's file, the latter alone; without that, of `call`'s definition.

    call: the handler that raised the error. Frames in the standard library, in installed packages that are no plugins,
    and in the runtime are skipped. An error about the return value of a function has the function in `about`.
    """
    if (about := getattr(error, "about", None)) is not None:
        return _definition(about)
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if _is_node_code(frame.filename)]
    places = [f"{frame.filename}:{frame.lineno}" for frame in frames]
    if not places:
        return _definition(call)
    of_user = [place for frame, place in zip(frames, places, strict=True) if not _is_shipped(frame.filename)]
    return places[-1] if not of_user or of_user[-1] == places[-1] else f"{of_user[-1]}, raised in {places[-1]}"


def _definition(call: Callable[..., Any]) -> str:
    """`file:line` of a function's definition."""
    code = getattr(call, "__code__", None)
    return f"{code.co_filename}:{code.co_firstlineno}" if code else "unknown"


def _is_node_code(file: str) -> bool:
    path = Path(file)
    if path.is_relative_to(_PACKAGE):
        return path.relative_to(_PACKAGE).parts[0] not in _PLUMBING
    if _INSTALLED & set(path.parts):
        return any(plugin.package in (*path.parts, path.stem) for plugin in plugins.installed())
    return path.is_absolute() and not path.is_relative_to(_PYTHON)


def _is_shipped(file: str) -> bool:
    """Whether a file comes with mast: of the package, or one that users read and copy."""
    return any(Path(file).is_relative_to(folder) for folder in (_PACKAGE, *(bundle.ROOT / kind for kind in _SHIPPED)))


def merged(parts: Iterable[Sequence[Entry]]) -> list[Entry]:
    """One entry for each handler, from the successive processes of one node."""
    by_handler: dict[str, Entry] = {}
    for entry in (entry for part in parts for entry in part):
        known = by_handler.get(entry["handler"])
        if known is None:
            by_handler[entry["handler"]] = dict(entry)
            continue
        known["count"] += entry["count"]
        known["frames"] += entry["frames"]
        known["first_frame"] = min(known["first_frame"], entry["first_frame"])
        known["last_frame"] = max(known["last_frame"], entry["last_frame"])
    return [by_handler[handler] for handler in sorted(by_handler)]


def lines(failures: Mapping[str, Sequence[Entry]], logs: Mapping[str, str] | None = None) -> list[str]:
    """A line for each node and handler; `logs` are the paths of the nodes' logs."""
    return [
        f"{node}.{entry['handler']} failed {how_often(entry)}: {entry['exception']} ({entry['where']})"
        + (f"; log: {logs[node]}" if logs and node in logs else "")
        for node, entries in failures.items()
        for entry in entries
    ]


def summary(failures: Mapping[str, Sequence[Entry]], logs: Mapping[str, str] | None = None) -> str:
    """The failures of a run and their consequence, on several lines that can be joined to one."""
    return "handlers failed, so the numbers may be wrong:\n  " + ";\n  ".join(lines(failures, logs))


def error(failures: Mapping[str, Sequence[Entry]], logs: Mapping[str, str] | None = None) -> HandlerFailed:
    """The error of a run in which handlers failed."""
    hint = "the results are kept; --allow-failures makes this a warning"
    return HandlerFailed(f"{summary(failures, logs)};\n{hint}")


def how_often(entry: Entry) -> str:
    """How often, and in which frames if known, a handler failed, as text."""
    times = "once" if entry["count"] == 1 else f"{entry['count']} times"
    if "first_frame" not in entry:
        return times
    first, last = entry["first_frame"], entry["last_frame"]
    if last < 0:
        return f"{times} before the first frame"
    return f"{times} in frame {first}" if first == last else f"{times} in {entry['frames']} frames ({first} to {last})"
