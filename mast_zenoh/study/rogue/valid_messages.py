"""Valid control messages, from which malformed and false ones are made."""

from __future__ import annotations

from typing import Any

import msgpack

from mast_zenoh.study.rogue.position import MARKER, Position

#: A failed handler.
FAILURE: dict[str, Any] = {
    "handler": "on_clock",
    "count": 3,
    "frames": 3,
    "first_frame": 1,
    "last_frame": 3,
    "exception": "KeyError: 'forged'",
    "where": f"/tmp/{MARKER}.py:1",
}
#: What a node that does not drive the scene reports at its end.
RESULT: dict[str, Any] = {
    "results": {"n": 1},
    "rejected": {"clock: forged": 2},
    "first_rejected": {"clock": [3, "forged"]},
    "foreign": {"clock": 1},
    "invalid": {"epoch": [1, "forged"]},
    "unsigned": 3,
    "process": "0123456789abcdef",
    "failures": [],
    "last_frame": 3,
    "cpu_s": 0.5,
    "arrived_ns": {"clock": {0: 1_700_000_000_000_000_000}},
    "versions": {"numpy": "2.0"},
    "clock": {"offset_ms": -1.5, "round_trip_ms": 0.1},
}


def valid_message(control: str, position: Position) -> Any:
    """A valid message of this kind, as plain values; a str for bare text."""
    return {
        "counts": [1, dict.fromkeys(position.publishes[:1], 3), dict.fromkeys(position.subscribes[:2], 3)],
        "epoch": [2, position.roles, None],
        "failed": ["0123456789abcdef", FAILURE],
        "act": [3, [["kill", position.others[0]]]],
        "result": RESULT | {"failures": [FAILURE]},
        "fetch": {"do": "piece", "path": "scenario.json", "offset": 0},
        "file": {"path": "messages.mcap", "offset": 0, "piece": MARKER.encode()},
        "rewire": {"wiring": position.wiring, "join": {}, "leave": [position.others[0]]},
        "intercept": [msgpack.packb({"do": "release", "number": "1", "name": None, "wire": "clock"}), b"\0" * 32],
        "stop": "end",
        "leave": "leave",
        "drain": (*position.subscribes, "clock")[0],
    }[control]
