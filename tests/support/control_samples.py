"""Sound control messages of nodes: a handler that failed, and what a node hands in at its end."""

from __future__ import annotations

from typing import Any

import numpy as np

#: The failures of one handler.
ENTRY: dict[str, Any] = {
    "handler": "on_tracks",
    "count": 1,
    "frames": 1,
    "first_frame": 3,
    "last_frame": 3,
    "exception": "KeyError: 'x'",
    "where": "/a/node.py:3",
}
#: What a node hands in, one of whose handlers failed.
OUTCOME: dict[str, Any] = {
    "results": {"n": 1, "tables": {"mine": {"a": np.arange(3), "b": np.array(["x", "y", "z"])}}},
    "rejected": {"clock: clock": 2},
    "first_rejected": {"clock": [3, "not MessagePack"]},
    "foreign": {"clock": 1},
    "invalid": {"epoch": [1, "rubbish"]},
    "unsigned": 3,
    "process": "0123456789abcdef",
    "failures": [ENTRY],
    "last_frame": 11,
    "cpu_s": 0.5,
    "arrived_ns": {"clock": {0: 1_700_000_000_000_000_000}},
    "versions": {"numpy": "2.0"},
    "clock": {"offset_ms": -1.5, "round_trip_ms": 0.1},
}
#: The same of the node that drives the scene.
DRIVEN: dict[str, Any] = OUTCOME | {
    "frames": 12,
    "wall_s": 1.5,
    "stop_reason": "end",
    "sent_ns": {0: 1_700_000_000_000_000_000},
    "churn": [],
}
