"""Control messages for files between a node on another host and the launcher."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import msgpack

from mast_zenoh import errors
from mast_zenoh.control import fields
from mast_zenoh.errors import MastError, MessageError, RunError

#: Largest part of a file in one query or reply.
PIECE_BYTES = 4 << 20

_MAX_ANSWER = PIECE_BYTES + (1 << 20)


class Join(NamedTuple):
    """A node's request for its files, with the versions of mast and its packages."""

    version: str
    versions: dict[str, str]


class Clock(NamedTuple):
    """A node's request for the launcher's time."""


class Piece(NamedTuple):
    """A node's request for a piece of one of its files."""

    path: str
    offset: int


class Written(NamedTuple):
    """A piece of a file that a node has written."""

    path: str
    offset: int
    piece: bytes


class NodeFiles(NamedTuple):
    """The files for a node.

    files: sizes in bytes by path; written: files that the node wrote before
    """

    files: dict[str, int]
    written: list[str]


def encode(request: Mapping[str, Any]) -> bytes:
    """Encode a request or an answer."""
    packed: bytes = msgpack.packb(dict(request))
    return packed


def decode_fetch(payload: bytes) -> Join | Clock | Piece:
    """A node's request to the launcher; raises MessageError."""
    request = fields.mapping(fields.unpack(payload, "fetch"), "fetch")
    do = request.get("do")
    if do == "join":
        fields.fields(request, ("do", "version", "versions"), "fetch")
        return Join(fields.text(request["version"], "fetch: version", 200), versions(request["versions"], "fetch"))
    if do == "clock":
        fields.fields(request, ("do",), "fetch")
        return Clock()
    if do == "piece":
        fields.fields(request, ("do", "path", "offset"), "fetch")
        return Piece(fields.text(request["path"], "fetch: path"), fields.whole(request["offset"], "fetch: offset"))
    raise MessageError(f"fetch: found {fields.abbreviated(do)}, expected join, clock or piece")


def decode_file(payload: bytes) -> Written:
    """A piece of a file from a node; raises MessageError."""
    request = fields.fields(fields.unpack(payload, "file"), ("path", "offset", "piece"), "file")
    path, offset = fields.text(request["path"], "file: path"), fields.whole(request["offset"], "file: offset")
    return Written(path, offset, _piece(request["piece"], "file"))


def decode_node_files(payload: bytes) -> NodeFiles:
    """The answer to Join; raises MessageError."""
    answer = fields.unpack(payload, "fetch", _MAX_ANSWER)
    fields.fields(answer, ("files", "written"), "fetch: answer")
    files = fields.counters(answer["files"], "fetch: files")
    written = [fields.text(path, "fetch: written") for path in fields.listed(answer["written"], "fetch: written")]
    return NodeFiles(files, written)


def decode_clock(payload: bytes) -> int:
    """The answer to Clock: the launcher's time, ns; raises MessageError."""
    answer = fields.fields(fields.unpack(payload, "fetch", _MAX_ANSWER), ("now_ns",), "fetch: answer")
    return fields.whole(answer["now_ns"], "fetch: now_ns")


def decode_piece(payload: bytes) -> bytes:
    """The answer to Piece; raises MessageError."""
    answer = fields.fields(fields.unpack(payload, "fetch", _MAX_ANSWER), ("piece",), "fetch: answer")
    return _piece(answer["piece"], "fetch")


def decode_nothing(payload: bytes) -> None:
    """The answer to Written; raises MessageError."""
    fields.fields(fields.unpack(payload, "file"), (), "file: answer")


def encode_refusal(error: BaseException) -> bytes:
    """Encode an error as an answer of the launcher."""
    packed: bytes = msgpack.packb([type(error).__name__, str(error)[:4000]])
    return packed


def decode_refusal(payload: bytes) -> MastError | None:
    """The error in an answer; None for Zenoh's own, after a timeout."""
    try:
        kind, message = fields.items(fields.unpack(payload, "fetch"), 2, "refusal")
        kind, message = fields.text(kind, "refusal"), fields.text(message, "refusal")
    except MessageError:
        return None
    error_class = getattr(errors, kind, None)
    return (
        error_class(message)
        if isinstance(error_class, type) and issubclass(error_class, MastError)
        else RunError(message)
    )


def versions(value: object, what: str) -> dict[str, str]:
    """The version of each package."""
    by_package = fields.mapping(value, f"{what}: versions")
    if len(by_package) > 100:
        raise MessageError(f"{what}: found {len(by_package)} versions, expected at most 100")
    return {fields.text(name, what, 100): fields.text(version, what, 300) for name, version in by_package.items()}


def _piece(value: object, what: str) -> bytes:
    if type(value) is not bytes or len(value) > PIECE_BYTES:
        raise MessageError(f"{what}: found {fields.abbreviated(value)}, expected at most {PIECE_BYTES} bytes")
    return value
