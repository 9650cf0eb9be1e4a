"""What the launcher sends on request: the files of a node on another host, and a description of the run.

The nodes' requests are controls (fetch, file). A description is a query that changes nothing, so it is not.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Annotated, Any, TypeVar

from msgspec import Meta

from mast_zenoh import errors
from mast_zenoh.errors import MastError, MessageError, RunError
from mast_zenoh.mesh.control import codec
from mast_zenoh.mesh.control.codec import ControlMessage, Name, Text, Versions, Whole, encode

T = TypeVar("T")

#: Largest part of a file in one query or reply.
PIECE_BYTES = 4 << 20

_MAX_ANSWER = PIECE_BYTES + (1 << 20)
_Content = Annotated[bytes, Meta(max_length=PIECE_BYTES)]


class FilesRequest(ControlMessage, frozen=True, tag_field="do", tag="join"):
    """A node's request for its files, with the versions of mast and its packages."""

    version: Annotated[str, Meta(max_length=200)]
    versions: Versions


class Clock(ControlMessage, frozen=True, tag_field="do", tag="clock"):
    """A node's request for the launcher's time."""


class Piece(ControlMessage, frozen=True, tag_field="do", tag="piece"):
    """A node's request for a piece of one of its files."""

    path: Text
    offset: Whole


class Written(ControlMessage, frozen=True):
    """A piece of a file that a node has written."""

    path: Text
    offset: Whole
    piece: _Content


class NodeFiles(ControlMessage, frozen=True):
    """The answer to Join: the files for a node.

    files: sizes in bytes by path; written: files that the node wrote before
    """

    files: dict[str, Whole]
    written: list[Text]


class LauncherTime(ControlMessage, frozen=True):
    """The answer to Clock."""

    now_ns: Whole


class Content(ControlMessage, frozen=True):
    """The answer to Piece."""

    piece: _Content


class Nothing(ControlMessage, frozen=True):
    """The answer to Written."""


def decode_fetch(payload: bytes) -> FilesRequest | Clock | Piece:
    """A node's request to the launcher; raises MessageError."""
    request: FilesRequest | Clock | Piece = codec.converted(
        codec.unpack(payload, "fetch"), FilesRequest | Clock | Piece, "fetch"
    )
    return request


def decode_file(payload: bytes) -> Written:
    """A piece of a file from a node; raises MessageError."""
    return codec.decode(Written, payload, "file")


def decode_answer(kind: type[T], payload: bytes) -> T:
    """The launcher's answer to a request: NodeFiles, LauncherTime, Content or Nothing; raises MessageError."""
    return codec.decode(kind, payload, "answer", _MAX_ANSWER)


def encode_refusal(error: BaseException) -> bytes:
    """Encode an error as an answer of the launcher."""
    return encode([type(error).__name__, str(error)[:4000]])


def decode_refusal(payload: bytes) -> MastError | None:
    """The error in an answer; None for Zenoh's own, after a timeout."""
    try:
        kind, message = codec.decode(tuple[Text, Text], payload, "fetch")
    except MessageError:
        return None
    error_class = getattr(errors, kind, None)
    if not isinstance(error_class, type) or not issubclass(error_class, MastError):
        error_class = RunError
    return error_class(message)


#: Most bytes of a description, with the scene.
MAX_DESCRIPTION_BYTES = 256 << 20

#: Key below the run's prefix, and the request for a description without the scene.
DESCRIBE, WITHOUT_SCENE = "@description", b"without scene"


class Description(ControlMessage, frozen=True):
    """A running run, for an observer without access to the run folder.

    run: its id;  scenario: scenario.json;  wiring: the current one, as in wiring.json
    scene: content of scene.npz; empty: there is none, or it was not asked for
    """

    run: Name
    scenario: dict[str, Any]
    wiring: dict[str, Any]
    scene: bytes


def encode_description(run: str, scenario: Mapping[str, Any], wiring: Mapping[str, Any], scene: bytes) -> bytes:
    """Encode a description."""
    return encode({"run": run, "scenario": json.dumps(scenario), "wiring": wiring, "scene": scene})


def decode_description(payload: bytes) -> Description:
    """Decode a description; raises MessageError.

    Scenario and wiring are objects of any content: their users check them.
    """
    content = codec.decode(dict[str, Any], payload, DESCRIBE, MAX_DESCRIPTION_BYTES)
    try:
        content["scenario"] = json.loads(content.get("scenario", "null"))
    except (ValueError, TypeError, RecursionError) as error:
        raise MessageError(f"{DESCRIBE}: scenario: not JSON: {str(error)[:100]}") from None
    description: Description = codec.converted(content, Description, DESCRIBE)
    return description
