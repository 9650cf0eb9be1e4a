"""Recordings of synthetic messages."""

from pathlib import Path
from typing import Any

import numpy as np

from mast_zenoh.messages import codec
from mast_zenoh.messages.schemas import Header
from mast_zenoh.run_folder.recording.writer import MessageLog
from mast_zenoh.wiring.model import Input

PERIOD_NS = 10**8
TAP = "agent/b/detections/@tap/0"

#: The keys of a small run.
HEARS = {
    "clock": Input("everything", "", "clock", "simulator"),
    "agent/a/status": Input("everything", "a", "status", "a"),
    "agent/b/status": Input("everything", "b", "status", "b"),
    "agent/b/detections": Input("everything", "b", "detections", "simulator"),
    TAP: Input("everything", "b", "detections", "simulator"),
}


def detections(*x: float) -> dict[str, np.ndarray]:
    """Columns of detections at (x, 0, 0)."""
    n = len(x)
    return {
        "position": np.array([(value, 0.0, 0.0) for value in x]).reshape(n, 3),
        "size": np.ones((n, 3)),
        "yaw": np.zeros(n),
        "score": np.ones(n),
        "class_id": np.zeros(n, np.uint8),
        "covariance": np.zeros((n, 3, 3)),
        "mount_position": np.zeros(3),
        "mount_rotation": np.array([1.0, 0.0, 0.0, 0.0]),
    }


def body_of(schema: str, frame: int) -> dict[str, np.ndarray]:
    if schema == "clock":
        return {}
    if schema == "detections":
        return detections(1.0, 2.0 + frame)
    return {name: np.array([frame]) for name in ("mobile", "detections", "tracks")}


def payload(key: str, frame: int, body: dict[str, Any] | None = None, **header: Any) -> bytes:
    """A message on a key, as its publisher would send it."""
    hears = HEARS[key]
    fields = dict(source=hears.source, frame=frame, time_ns=frame * PERIOD_NS, seq=frame) | header
    sent = body_of(hears.message, frame) if body is None else body
    return codec.encode(codec.conform(Header(hears.message, **fields), sent))


def small_run(frames: int = 6) -> list[tuple[str, bytes]]:
    """(key, bytes) of all messages, by frame and key."""
    return [(key, payload(key, frame)) for frame in range(frames) for key in sorted(HEARS)]


def begun(path: Path) -> MessageLog:
    """A recording that has begun."""
    log = MessageLog(path)
    log.begin(HEARS)
    return log


def add(log: MessageLog, messages: list[tuple[str, bytes]]) -> None:
    """Add messages, some of which may be malformed."""
    for key, data in messages:
        try:
            header = codec.decode_header(data, HEARS[key].message)
            log.add(key, data, header, header.frame)
        except codec.MessageError:
            log.add_malformed(key, data, 2, 2 * PERIOD_NS, 2)


def write(path: Path, messages: list[tuple[str, bytes]]) -> Path:
    """A recording of messages, some of which may be malformed."""
    log = begun(path)
    add(log, messages)
    log.close()
    return path
