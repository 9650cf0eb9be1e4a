"""Control messages from a node to the launcher: failures, and its results."""

from __future__ import annotations

from typing import Any

import msgpack

from mast_zenoh.control import fields, results
from mast_zenoh.control.failures import Entry
from mast_zenoh.control.files import versions
from mast_zenoh.control.invalid import OTHERS
from mast_zenoh.errors import MessageError
from mast_zenoh.messagelog.churn import BACK, LOST

#: Limits of a node's result, bytes. The evaluator's tables have a row for each object, agent and frame.
MAX_RESULT = 32 << 20
MAX_EVALUATION = 512 << 20

MAX_HANDLERS = 256  #: handlers of which one process may report failures
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
    """The largest result that a node may hand in, bytes."""
    return MAX_EVALUATION if node == results.EVALUATOR else MAX_RESULT


def encode_failure(process: str, entry: Entry) -> bytes:
    """Encode the failures of one handler in one process of a node."""
    packed: bytes = msgpack.packb([process, entry])
    return packed


def decode_failure(payload: bytes) -> tuple[str, Entry]:
    """(process, failures of one handler in it); raises MessageError."""
    process, entry = fields.items(fields.unpack(payload, "failed"), 2, "failed")
    return fields.text(process, "failed: process", 64), failure(entry)


def failure(value: object) -> Entry:
    """The entry of one handler, as in control.failures; raises MessageError."""
    entry = fields.fields(value, _ENTRY, "a handler failure")
    for name in ("handler", "exception"):
        fields.line(entry[name], f"a handler failure: {name}", 300)
    fields.line(entry["where"], "a handler failure: where")
    for name, least in (("count", 1), ("frames", 1), ("first_frame", -1), ("last_frame", -1)):
        fields.whole(entry[name], f"a handler failure: {name}", least)
    return entry


def decode_result(payload: bytes, node: str, *, drives: bool) -> dict[str, Any]:
    """Decode a node's result, as runtime.protocol.node makes it; raises MessageError.

    drives: whether the node drives the scene: only that one has stop_reason, frames, wall_s, sent_ns, churn
    """
    fields.fits(payload, "result", max_result(node))
    expected = (*_COMMON, *_OF_HOST, *(_OF_DRIVER if drives else ()))
    result = fields.fields(results.unpack(payload), expected, "result", optional=_OF_HOST)
    try:
        results.checked(result["results"])
    except TypeError as error:
        raise MessageError(f"result: {error}") from None
    for part in ("rejected", "foreign"):
        for key in fields.counters(_bounded_map(result[part], f"result: {part}"), f"result: {part}"):
            fields.line(key, f"result: {part}")
    for part, minimum in (("first_rejected", -1), ("invalid", 1)):
        for key, pair in _bounded_map(result[part], f"result: {part}").items():
            number, reason = fields.items(pair, 2, f"result: {part}")
            fields.line(key, f"result: {part}")
            fields.whole(number, f"result: {part}", minimum)
            fields.line(reason, f"result: {part}", 200)
    fields.whole(result["unsigned"], "result: unsigned")
    if not drives and (unexpected := result["invalid"].keys() - _refused_by(node)):
        raise MessageError(
            f"result: invalid: found {fields.abbreviated(min(unexpected))}, which {node} does not receive"
        )
    fields.text(result["process"], "result: process", 64)
    entries = fields.listed(result["failures"], "result: failures")
    if len(entries) > MAX_HANDLERS:
        raise MessageError(f"result: found failures of {len(entries)} handlers, expected at most {MAX_HANDLERS}")
    for entry in entries:
        failure(entry)
    fields.whole(result["last_frame"], "result: last_frame", -1)
    fields.finite(result["cpu_s"], "result: cpu_s")
    for times in _bounded_map(result["arrived_ns"], "result: arrived_ns").values():
        _times(times, "result: arrived_ns")
    if "versions" in result:
        versions(result["versions"], "result")
    if "clock" in result:
        clock = fields.fields(result["clock"], ("offset_ms", "round_trip_ms"), "result: clock")
        for value in clock.values():
            fields.finite(value, "result: clock", 1e12)
    if drives:
        fields.whole(result["frames"], "result: frames")
        fields.finite(result["wall_s"], "result: wall_s")
        fields.text(result["stop_reason"], "result: stop_reason")
        _times(result["sent_ns"], "result: sent_ns")
        _churn(result["churn"])
    return result


def _refused_by(node: str) -> set[str]:
    """Control keys on which a node that does not drive the scene can refuse messages."""
    return {"epoch", "stop", f"leave/{node}", f"drain/{node}", OTHERS}


def _churn(value: object) -> None:
    """Check a list of nodes that were lost or came back, as in messagelog.churn."""
    for item in fields.listed(value, "result: churn"):
        event = fields.fields(item, ("frame", "node", "what"), "result: churn")
        fields.whole(event["frame"], "result: churn: frame")
        fields.text(event["node"], "result: churn: node", fields.MAX_NAME)
        if event["what"] not in (LOST, BACK):
            raise MessageError(f"result: churn: found {fields.abbreviated(event['what'])}, expected {LOST} or {BACK}")


def _bounded_map(value: object, what: str) -> dict[str, Any]:
    """A map with at most as many keys as a run may have."""
    entries = fields.mapping(value, what)
    if len(entries) > _MAX_KEYS:
        raise MessageError(f"{what}: found {len(entries)} keys, expected at most {_MAX_KEYS}")
    return entries


def _times(value: object, what: str) -> None:
    """Check a map from frames to times in ns."""
    if type(value) is not dict:
        raise MessageError(f"{what}: found {fields.abbreviated(value)}, expected times by frame")
    for frame, time_ns in value.items():
        fields.whole(frame, f"{what}: frame")
        fields.whole(time_ns, what)
