"""Messages of a compromised node on its own control keys, with its certificate."""

from __future__ import annotations

import itertools
import time
from pathlib import Path
from typing import Any

import msgpack

from mast_zenoh.control import results
from mast_zenoh.runtime.mesh.driver import Driver
from mast_zenoh.runtime.mesh.node import MeshNode

RUBBISH = (b"", b"\xc1", b"\x93", b"\xff" * 40, msgpack.packb([]), msgpack.packb({}), msgpack.packb([1, 2, 3]))


def send(node: MeshNode) -> None:
    """Send all invalid messages that a node may send, results first."""
    control = f"{node._prefix}/@control"
    outcome = {
        "results": {
            "metrics": {"frames": 666},
            "tables": {
                name: {"a": [1]} for name in ("metrics", "/tmp/mast_escaped", "../../mast_escaped", "../metrics")
            },
        },
        "sent_ns": {},
        "stop_reason": "end",
        "failures": [],
        "process": "x",
    }
    payloads = [*RUBBISH, results.pack(outcome), results.pack({"sent_ns": {}}), results.pack([1])]
    for payload in payloads:
        list(node.session.get(f"{control}/result/{node.name}", payload=payload, timeout=5.0))
    questions: list[Any] = [
        {"do": "piece", "path": "scenario.json", "offset": offset} for offset in (float("inf"), -1, 1 << 63)
    ]
    for what, payload in itertools.product(("fetch", "file"), (*RUBBISH, *map(msgpack.packb, questions))):
        list(node.session.get(f"{control}/{what}/{node.name}", payload=payload, timeout=5.0))
    for payload in RUBBISH:
        node.session.put(f"{control}/failed/{node.name}", payload)


def send_invalid_messages() -> None:
    """Make this process's node send all of them when it starts; otherwise honest."""
    life, report = MeshNode.run_until_stopped, MeshNode.report

    def run(self: MeshNode) -> None:
        send(self)
        life(self)

    def first_report(self: MeshNode) -> None:
        if self.epoch:  # the driver is subscribed
            MeshNode.report = report  # type: ignore[method-assign]
            for payload in RUBBISH:
                self._reports["counts"].put(payload)
        report(self)

    MeshNode.run_until_stopped = run  # type: ignore[method-assign]
    MeshNode.report = first_report  # type: ignore[method-assign]


def overreport(key: str) -> None:
    """Make this process's node report a billion handled messages on a key."""
    report = MeshNode.report

    def lie(self: MeshNode) -> None:
        self.host.handled[key] = 10**9
        report(self)

    MeshNode.report = lie  # type: ignore[method-assign]


def hold(frame: int, go: str, stall_timeout_s: float) -> None:
    """Make this process's driver wait before a frame until the file `go` exists.

    stall_timeout_s: its limit for waiting until the mesh is quiet
    """
    carry_out, init = Driver._carry_out, Driver.__init__

    def waiting(self: Driver) -> str:
        while self.frames == frame and not Path(go).exists() and not self._end_reason:
            self._wait(time.monotonic() + 0.02)
        return carry_out(self)

    def hasty(self: Driver, *arguments: Any, **more: Any) -> None:
        init(self, *arguments, **{**more, "stall_timeout_s": stall_timeout_s})

    Driver._carry_out = waiting  # type: ignore[method-assign]
    Driver.__init__ = hasty  # type: ignore[method-assign]
