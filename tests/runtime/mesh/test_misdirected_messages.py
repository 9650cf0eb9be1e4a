"""A message that Zenoh delivers on another key than that on which it was sent is counted and dropped, never handled.

Zenoh does so for a moment after its router was suspended, see docs/known_limits.md.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from queue import Empty
from typing import Any, NamedTuple
from unittest.mock import MagicMock

import numpy as np
import pytest
import zenoh

from mast_zenoh.config.resolved import NodeSpec, Resolved
from mast_zenoh.launch.context import Mesh
from mast_zenoh.launch.mesh_run import MeshLauncher
from mast_zenoh.launch.reports import Reports
from mast_zenoh.mesh.control.codec import InvalidMessages, Signatures
from mast_zenoh.mesh.control.flow import Epoch
from mast_zenoh.mesh.protocol.events import EpochEvent, MessageEvent
from mast_zenoh.mesh.zenoh_process import ZenohProcess
from mast_zenoh.messages import codec
from mast_zenoh.messages.schemas import Header
from mast_zenoh.node import Context, Node, Received
from mast_zenoh.wiring.model import Endpoint, Leg, Wire, Wiring

CONTROL = "mast/x/@control"
POSES = {subject: f"agent/{subject}/pose" for subject in ("a", "b")}
POSE = {"position": np.zeros(3), "rotation": np.array([1.0, 0.0, 0.0, 0.0]), "velocity": np.zeros(3)}
TAPPED = "agent/b/pose/@tap/0"
PROBE = Endpoint("probe", "poses")


def wiring(tap: bool = False) -> Wiring:
    """Two wires of one type from one node to another, the second through a relay if it is tapped."""
    gps = Endpoint("gps", "pose")
    wires = {subject: Wire(key, subject, "pose", (Leg(key, gps, (PROBE,)),)) for subject, key in POSES.items()}
    if tap:
        legs = (Leg(TAPPED, gps, (Endpoint("relay", "pose"),)), Leg(POSES["b"], Endpoint("relay", "out"), (PROBE,)))
        wires["b"] = replace(wires["b"], legs=legs)
    clocked = tuple(Endpoint(node, "clock") for node in ("gps", "probe"))
    return Wiring((Wire("clock", "", "clock", (Leg("clock", Endpoint("sim", "clock"), clocked),)), *wires.values()))


class Gps(Node):
    """Publishes two poses in every frame."""

    inputs = {"clock": "clock"}
    outputs = {"pose": "pose"}

    def on_clock(self, received: Received, context: Context) -> None:
        for subject in POSES:
            context.publish("pose", POSE, subject=subject)


class Probe(Node):
    """Keeps the subjects of the poses that it receives."""

    inputs = {"clock": "clock", "poses": "pose"}

    def __init__(self) -> None:
        self.subjects: list[str] = []

    def on_clock(self, received: Received, context: Context) -> None: ...

    def on_poses(self, received: Received, context: Context) -> None:
        self.subjects.append(received.subject)


class Message(NamedTuple):
    """A sample or a query, as Zenoh passes it."""

    key_expr: str
    payload: Any
    attachment: Any
    reply_err: Callable[[bytes], None] = lambda payload: None

    def reply(self, key: str, payload: bytes) -> None: ...

    def drop(self) -> None: ...

    def __enter__(self) -> Message:
        return self

    def __exit__(self, *_: object) -> None: ...


class Session(MagicMock):
    """A session that keeps what is sent, by key, and delivers it on any key."""

    def begin(self) -> Session:
        self.sent: dict[str, list[Message]] = {}
        self.callbacks: dict[str, Callable[[Any], None]] = {}
        self.declare_publisher = lambda key, **_: MagicMock(
            put=lambda *args, **options: self.put(key, *args, **options)
        )
        self.declare_subscriber = self.declare_queryable = self._declare
        return self

    def put(self, key: str, payload: bytes, attachment: bytes | None = None, **_: Any) -> None:
        attached = None if attachment is None else zenoh.ZBytes(attachment)
        self.sent.setdefault(key, []).append(Message(key, zenoh.ZBytes(payload), attached))

    def get(self, key: str, handler: Any, payload: bytes, attachment: bytes | None = None, **_: Any) -> None:
        self.put(key, payload, attachment)

    def _declare(self, key: str, handler: Any) -> MagicMock:
        self.callbacks[key] = handler.callback
        return MagicMock()

    def deliver(self, message: Message, key: str, at: str = "") -> None:
        """Deliver a message on a key; at: the key expression of the subscriber, if it is another one."""
        self.callbacks[at or key](message._replace(key_expr=key))


def process_of(name: str, node: Node, session: Session, mode: str, tap: bool = False, run: str = "x") -> ZenohProcess:
    specs = {each: NodeSpec("agent", f"{each}.py", "Any", {}, "continue") for each in ("sim", "gps", "probe", "relay")}
    resolved = Resolved("poses", 1, mode, 1.0, 10, 10**8, specs, wiring(tap).to_json(), {})
    process = ZenohProcess(run, resolved, name, node, session, Signatures(run))
    process.protocol.start()
    process.protocol.handle(EpochEvent(Epoch(1, dict.fromkeys(specs, "agent"), None)))
    clock = codec.encode(codec.conform(Header("clock", "sim", 0, 0, 0), {}))
    process.protocol.receive_message(MessageEvent("clock", clock, 1, 0))
    handle_all(process)
    return process


def handle_all(process: ZenohProcess) -> None:
    while True:
        try:
            item = process._queue.get_nowait()
        except Empty:
            return
        process.protocol.handle(process.inbox.take(item))


@pytest.mark.parametrize("mode", ["realtime", "lockstep"])
def test_a_message_of_another_wire_of_the_same_source_and_type_is_not_handled(mode, caplog) -> None:
    session, heard = Session().begin(), Session().begin()
    process_of("gps", Gps(), session, mode)
    probe = Probe()
    process = process_of("probe", probe, heard, mode)
    (pose,) = session.sent[f"mast/x/{POSES['a']}"]
    with caplog.at_level(logging.WARNING):
        for _ in range(2):
            heard.deliver(pose, f"mast/x/{POSES['b']}")
            handle_all(process)
    assert probe.subjects == []
    host = process.protocol.host
    assert host.rejected == {(POSES["b"], "wrong key"): 2}
    assert host.handled[POSES["b"]] == 0, "the driver does not count it on this key: it was not sent there"
    assert [record.message for record in caplog.records if "wrong key" in record.message] == [
        f"rejected a message on {POSES['b']}: wrong key: sent on another key, and delivered on this one by Zenoh "
        "(more on this key will only be counted)"
    ]
    heard.deliver(pose, f"mast/x/{POSES['a']}")
    handle_all(process)
    assert probe.subjects == ["a"], "on its own key it is handled"


def test_two_legs_of_one_wire_are_not_exchanged() -> None:
    session, heard = Session().begin(), Session().begin()
    process_of("gps", Gps(), session, "realtime", tap=True)
    probe = Probe()
    process = process_of("probe", probe, heard, "realtime", tap=True)
    (pose,) = session.sent[f"mast/x/{TAPPED}"]
    heard.deliver(pose, f"mast/x/{POSES['b']}")
    handle_all(process)
    assert probe.subjects == []
    assert process.protocol.host.rejected.keys() == {(POSES["b"], "wrong key")}


def test_equal_runs_have_equal_attachments() -> None:
    """Attachments do not depend on the run's id, so that streams of two runs can be equal."""
    attachments = []
    for run in ("x", "y"):
        session = Session().begin()
        process_of("gps", Gps(), session, "realtime", run=run)
        attachments.append([message.attachment.to_bytes() for message in session.sent[f"mast/{run}/{POSES['a']}"]])
    assert attachments[0] == attachments[1]


def test_a_node_does_not_leave_when_another_one_is_asked_to(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    launcher_session, heard = Session().begin(), Session().begin()
    launcher = MeshLauncher(
        MagicMock(folder=tmp_path, frame=-1, run_id="x", signatures=Signatures("x")),
        Mesh(launcher_session, MagicMock()),
        MagicMock(live=False),
    )
    process = process_of("probe", Probe(), heard, "realtime")
    launcher.leave("gps", "leave")
    (request,) = launcher_session.sent[f"{CONTROL}/leave/gps"]
    with caplog.at_level(logging.WARNING):
        heard.deliver(request, f"{CONTROL}/leave/probe")
    handle_all(process)
    assert process.protocol.stop_reason is None
    assert process.protocol.invalid.counts == {"leave/probe": 1}
    assert "mark of @control/leave/probe" in caplog.text
    launcher.leave("probe", "leave")
    (request,) = launcher_session.sent[f"{CONTROL}/leave/probe"]
    heard.deliver(request, f"{CONTROL}/leave/probe")
    handle_all(process)
    assert process.protocol.stop_reason == "leave"


def test_results_and_failures_of_one_node_are_not_taken_for_those_of_another() -> None:
    session, launcher = Session().begin(), Session().begin()
    process = process_of("gps", Gps(), session, "realtime")
    process.stop("end")
    process.control("failed/gps", b"")
    handle_all(process)
    invalid = InvalidMessages(lambda line: None)
    children: Any = {name: MagicMock(spec=None, restarts=0) for name in ("gps", "probe")}
    Reports(launcher, CONTROL, children, invalid, MagicMock())
    result, failed = (session.sent[f"{CONTROL}/{key}/gps"][0] for key in ("result", "failed"))
    launcher.deliver(result, f"{CONTROL}/result/probe", at=f"{CONTROL}/result/*")
    launcher.deliver(failed, f"{CONTROL}/failed/probe", at=f"{CONTROL}/failed/*")
    assert invalid.reasons == {
        f"{kind}/probe": f"{kind}: sent on another key: expected the mark of @control/{kind}/probe"
        for kind in ("result", "failed")
    }
