"""Messages of a compromised node on its own control keys, with its certificate."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import msgpack

from mast_zenoh.control import results
from mast_zenoh.runtime.mesh.zenoh_process import ZenohProcess
from mast_zenoh.runtime.protocol.driver import DriverProtocol, DriverState, Phase
from mast_zenoh.runtime.protocol.node import NodeProtocol

RUBBISH = (b"", b"\xc1", b"\x93", b"\xff" * 40, msgpack.packb([]), msgpack.packb({}), msgpack.packb([1, 2, 3]))


def send(node: ZenohProcess) -> None:
    """Send all invalid messages that a node may send, results first."""
    control, name = f"{node.prefix}/@control", node.protocol.name
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
        list(node.session.get(f"{control}/result/{name}", payload=payload, timeout=5.0))
    questions: list[Any] = [
        {"do": "piece", "path": "scenario.json", "offset": offset} for offset in (float("inf"), -1, 1 << 63)
    ]
    for what, payload in itertools.product(("fetch", "file"), (*RUBBISH, *map(msgpack.packb, questions))):
        list(node.session.get(f"{control}/{what}/{name}", payload=payload, timeout=5.0))
    for payload in RUBBISH:
        node.session.put(f"{control}/failed/{name}", payload)


def send_invalid_messages() -> None:
    """Make this process's node send all of them when it starts; otherwise honest."""
    life, report = ZenohProcess.run, NodeProtocol.report

    def run(self: ZenohProcess) -> None:
        send(self)
        life(self)

    def first_report(self: NodeProtocol) -> None:
        if self.epoch:  # the driver is subscribed
            NodeProtocol.report = report  # type: ignore[method-assign]
            for payload in RUBBISH:
                self.actions.control(f"counts/{self.name}", payload)
        report(self)

    ZenohProcess.run = run  # type: ignore[method-assign]
    NodeProtocol.report = first_report  # type: ignore[method-assign]


def overreport(key: str) -> None:
    """Make this process's node report a billion handled messages on a key."""
    report = NodeProtocol.report

    def lie(self: NodeProtocol) -> None:
        self.host.handled[key] = 10**9
        report(self)

    NodeProtocol.report = lie  # type: ignore[method-assign]


def hold(frame: int, go: str, stall_timeout_s: float) -> None:
    """Make this process's driver wait before a frame until the file `go` exists.

    stall_timeout_s: its limit for waiting until the mesh is quiet
    """
    carry_out, init = DriverProtocol._carry_out, DriverProtocol.__init__

    def waiting(self: DriverProtocol) -> Phase:
        while self.frames == frame and not Path(go).exists() and not self._end_reason:
            yield from self._wait(DriverState.PACING, self._now_s + 0.02)
        return (yield from carry_out(self))

    def hasty(self: DriverProtocol, *arguments: Any, **more: Any) -> None:
        init(self, *arguments, **{**more, "stall_timeout_s": stall_timeout_s})

    DriverProtocol._carry_out = waiting  # type: ignore[method-assign]
    DriverProtocol.__init__ = hasty  # type: ignore[method-assign]
