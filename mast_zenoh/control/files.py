"""Control messages by which a node on another host gets its files from the launcher, and gives it what it writes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import msgpack

from mast_zenoh import errors
from mast_zenoh.control import fields
from mast_zenoh.errors import MastError, MessageError, RunError

#: Below which no query or reply of a file becomes too large.
PIECE_BYTES = 4 << 20

_MAX_ANSWER = PIECE_BYTES + (1 << 20)


class Join(NamedTuple):
    """A node asks for its files, and says which version it runs, and which of everything."""

    version: str
    versions: dict[str, str]


class Clock(NamedTuple):
    """A node asks what time it is."""


class Piece(NamedTuple):
    """A node asks for a piece of one of its files."""

    path: str
    offset: int


class Written(NamedTuple):
    """A node gives a piece of a file that it writes."""

    path: str
    offset: int
    piece: bytes


class Belongings(NamedTuple):
    """files: bytes by path; without: nodes that are not up; written: files that the node has written before."""

    files: dict[str, int]
    without: list[str]
    written: list[str]


def encode(request: Mapping[str, Any]) -> bytes:
    """A request, or an answer."""
    packed: bytes = msgpack.packb(dict(request))
    return packed


def decode_fetch(payload: bytes) -> Join | Clock | Piece:
    """What a node asks the launcher for; raises MessageError."""
    found = fields.mapping(fields.unpack(payload, "fetch"), "fetch")
    do = found.get("do")
    if do == "join":
        fields.fields(found, ("do", "version", "versions"), "fetch")
        return Join(fields.text(found["version"], "fetch: version", 200), versions(found["versions"], "fetch"))
    if do == "clock":
        fields.fields(found, ("do",), "fetch")
        return Clock()
    if do == "piece":
        fields.fields(found, ("do", "path", "offset"), "fetch")
        return Piece(fields.text(found["path"], "fetch: path"), fields.whole(found["offset"], "fetch: offset"))
    raise MessageError(f"fetch: found {fields.shown(do)}, expected join, clock or piece")


def decode_file(payload: bytes) -> Written:
    """What a node gives the launcher; raises MessageError."""
    found = fields.fields(fields.unpack(payload, "file"), ("path", "offset", "piece"), "file")
    path, offset = fields.text(found["path"], "file: path"), fields.whole(found["offset"], "file: offset")
    return Written(path, offset, _piece(found["piece"], "file"))


def decode_belongings(payload: bytes) -> Belongings:
    """The answer to Join; raises MessageError."""
    found = fields.unpack(payload, "fetch", _MAX_ANSWER)
    fields.fields(found, ("files", "without", "written"), "fetch: answer")
    files = fields.counters(found["files"], "fetch: files")
    written = [fields.text(path, "fetch: written") for path in fields.listed(found["written"], "fetch: written")]
    return Belongings(files, list(fields.names(found["without"], "fetch: without")), written)


def decode_clock(payload: bytes) -> int:
    """The answer to Clock: the launcher's time, ns; raises MessageError."""
    found = fields.fields(fields.unpack(payload, "fetch", _MAX_ANSWER), ("now_ns",), "fetch: answer")
    return fields.whole(found["now_ns"], "fetch: now_ns")


def decode_piece(payload: bytes) -> bytes:
    """The answer to Piece; raises MessageError."""
    found = fields.fields(fields.unpack(payload, "fetch", _MAX_ANSWER), ("piece",), "fetch: answer")
    return _piece(found["piece"], "fetch")


def decode_nothing(payload: bytes) -> None:
    """The answer to Written; raises MessageError."""
    fields.fields(fields.unpack(payload, "file"), (), "file: answer")


def encode_refusal(error: BaseException) -> bytes:
    """An error as the launcher answers it."""
    packed: bytes = msgpack.packb([type(error).__name__, str(error)[:4000]])
    return packed


def decode_refusal(payload: bytes) -> MastError | None:
    """The error in an answer; None for Zenoh's own, when nobody has answered in time."""
    try:
        kind, message = fields.items(fields.unpack(payload, "fetch"), 2, "refusal")
        kind, message = fields.text(kind, "refusal"), fields.text(message, "refusal")
    except MessageError:
        return None
    known = getattr(errors, kind, None)
    return known(message) if isinstance(known, type) and issubclass(known, MastError) else RunError(message)


def versions(value: object, what: str) -> dict[str, str]:
    """By package the version of it."""
    found = fields.mapping(value, f"{what}: versions")
    if len(found) > 100:
        raise MessageError(f"{what}: found {len(found)} versions, expected at most 100")
    return {fields.text(name, what, 100): fields.text(version, what, 300) for name, version in found.items()}


def _piece(value: object, what: str) -> bytes:
    if type(value) is not bytes or len(value) > PIECE_BYTES:
        raise MessageError(f"{what}: found {fields.shown(value)}, expected at most {PIECE_BYTES} bytes")
    return value
