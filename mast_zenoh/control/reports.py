"""Control messages by which a node tells the launcher of itself: handlers that fail, and at its end its results."""

from __future__ import annotations

from typing import Any

import msgpack

from mast_zenoh.control import fields, results
from mast_zenoh.control.failures import Entry
from mast_zenoh.control.files import versions
from mast_zenoh.control.invalid import OTHERS
from mast_zenoh.errors import MessageError
from mast_zenoh.messagelog.churn import BACK, LOST

#: Bytes that a node may hand in. The evaluator's tables have a row for each object, agent and frame.
MAX_RESULT = 32 << 20
MAX_EVALUATION = 512 << 20

MAX_HANDLERS = 256  #: of which one process may report failures
_MAX_KEYS = 4096
_ENTRY = ("handler", "count", "frames", "first_frame", "last_frame", "exception", "where")
_COMMON = (
    "results",
    "rejected",
    "first_rejected",
    "foreign",
    "invalid",
    "unsigned",
    "process",
    "failures",
    "last_frame",
    "cpu_s",
    "arrived_ns",
)
_OF_DRIVER = ("frames", "wall_s", "stop_reason", "sent_ns", "churn")
_OF_HOST = ("versions", "clock")


def max_result(node: str) -> int:
    """Bytes that a node may hand in."""
    return MAX_EVALUATION if node == results.EVALUATOR else MAX_RESULT


def encode_failure(process: str, entry: Entry) -> bytes:
    """The failures of one handler in one process of a node."""
    packed: bytes = msgpack.packb([process, entry])
    return packed


def decode_failure(payload: bytes) -> tuple[str, Entry]:
    """(process, failures of one handler in it); raises MessageError."""
    process, entry = fields.items(fields.unpack(payload, "failed"), 2, "failed")
    return fields.text(process, "failed: process", 64), failure(entry)


def failure(value: object) -> Entry:
    """The failures of one handler, see runtime.failures; raises MessageError."""
    entry = fields.fields(value, _ENTRY, "a handler failure")
    for name in ("handler", "exception"):
        fields.line(entry[name], f"a handler failure: {name}", 300)
    fields.line(entry["where"], "a handler failure: where")
    for name, least in (("count", 1), ("frames", 1), ("first_frame", -1), ("last_frame", -1)):
        fields.whole(entry[name], f"a handler failure: {name}", least)
    return entry


def decode_result(payload: bytes, node: str, *, drives: bool) -> dict[str, Any]:
    """What a node hands in, as `MeshNode.hand_in` makes it; raises MessageError.

    drives: whether it is the node that drives the scene: only that has stop_reason, frames, wall_s, sent_ns, churn
    """
    fields.fits(payload, "result", max_result(node))
    expected = (*_COMMON, *_OF_HOST, *(_OF_DRIVER if drives else ()))
    found = fields.fields(results.unpack(payload), expected, "result", optional=_OF_HOST)
    try:
        results.checked(found["results"])
    except TypeError as error:
        raise MessageError(f"result: {error}") from None
    for part in ("rejected", "foreign"):
        for key in fields.counters(_few(found[part], f"result: {part}"), f"result: {part}"):
            fields.line(key, f"result: {part}")
    for part, first, most in (("first_rejected", -1, 200), ("invalid", 1, 200)):
        for key, pair in _few(found[part], f"result: {part}").items():
            number, reason = fields.items(pair, 2, f"result: {part}")
            fields.line(key, f"result: {part}")
            fields.whole(number, f"result: {part}", first)
            fields.line(reason, f"result: {part}", most)
    fields.whole(found["unsigned"], "result: unsigned")
    if not drives and (of_others := found["invalid"].keys() - _refused_by(node)):
        raise MessageError(f"result: invalid: found {fields.shown(min(of_others))}, which {node} does not hear")
    fields.text(found["process"], "result: process", 64)
    entries = fields.listed(found["failures"], "result: failures")
    if len(entries) > MAX_HANDLERS:
        raise MessageError(f"result: found failures of {len(entries)} handlers, expected at most {MAX_HANDLERS}")
    for entry in entries:
        failure(entry)
    fields.whole(found["last_frame"], "result: last_frame", -1)
    fields.finite(found["cpu_s"], "result: cpu_s")
    for times in _few(found["arrived_ns"], "result: arrived_ns").values():
        _times(times, "result: arrived_ns")
    if "versions" in found:
        versions(found["versions"], "result")
    if "clock" in found:
        clock = fields.fields(found["clock"], ("offset_ms", "round_trip_ms"), "result: clock")
        for value in clock.values():
            fields.finite(value, "result: clock", 1e12)
    if drives:
        fields.whole(found["frames"], "result: frames")
        fields.finite(found["wall_s"], "result: wall_s")
        fields.text(found["stop_reason"], "result: stop_reason")
        _times(found["sent_ns"], "result: sent_ns")
        _churn(found["churn"])
    return found


def _refused_by(node: str) -> set[str]:
    """Control keys on which a node that does not drive the scene can have refused messages."""
    return {"epoch", "stop", f"leave/{node}", f"drain/{node}", OTHERS}


def _churn(value: object) -> None:
    """Who was lost and who came back, see messagelog.churn."""
    for event in fields.listed(value, "result: churn"):
        found = fields.fields(event, ("frame", "node", "what"), "result: churn")
        fields.whole(found["frame"], "result: churn: frame")
        fields.text(found["node"], "result: churn: node", fields.MAX_NAME)
        if found["what"] not in (LOST, BACK):
            raise MessageError(f"result: churn: found {fields.shown(found['what'])}, expected {LOST} or {BACK}")


def _few(value: object, what: str) -> dict[str, Any]:
    """A map of at most as many keys as a run may have."""
    found = fields.mapping(value, what)
    if len(found) > _MAX_KEYS:
        raise MessageError(f"{what}: found {len(found)} keys, expected at most {_MAX_KEYS}")
    return found


def _times(value: object, what: str) -> None:
    """A map of frames to times in ns."""
    if type(value) is not dict:
        raise MessageError(f"{what}: found {fields.shown(value)}, expected times by frame")
    for frame, at in value.items():
        fields.whole(frame, f"{what}: frame")
        fields.whole(at, what)
