"""Waiting messages are limited by source; legitimate runs stay far below."""

import logging
from collections import deque
from contextlib import nullcontext
from dataclasses import replace
from unittest.mock import MagicMock, call

import numpy as np
import pytest
import zenoh
from hosted import Hosted
from hypothesis import given
from hypothesis import strategies as st
from tiny_world import tracks

from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.mesh.control.flow import Epoch
from mast_zenoh.mesh.control.key_marks import control_mark
from mast_zenoh.mesh.host import Host, Outgoing
from mast_zenoh.mesh.protocol.events import DroppedEvent, EpochEvent, MessageEvent, StopEvent
from mast_zenoh.mesh.protocol.pacer import SETTLE_EVERY
from mast_zenoh.mesh.protocol.traffic import (
    ATTACHMENT,
    FOREIGN,
    MARK,
    MISDIRECTED,
    EventInbox,
    Item,
    Outlets,
    stamp,
    stamp_of,
)
from mast_zenoh.mesh.waiting import DELAYED, EARLY, HELD, INBOX, Limit, Room
from mast_zenoh.messages import codec
from mast_zenoh.messages.schemas import SCHEMAS, Header, Message, text
from mast_zenoh.node import Context, Node, Received
from mast_zenoh.wiring.insertion import InsertionPoint, insert
from mast_zenoh.wiring.model import Endpoint, Leg, Wire, Wiring

MIB = 1 << 20
LATER = 5


class Relay(Node):
    """Forwards the tracks of two agents, delayed on request."""

    inputs = {"clock": "clock", "tracks": "tracks"}
    outputs = {"tracks_out": "tracks"}

    def __init__(self, after_s: float = 0.0) -> None:
        self.after_s = after_s
        self.got: list[tuple[str, int]] = []

    def on_clock(self, received: Received, context: Context) -> None: ...

    def on_tracks(self, received: Received, context: Context) -> None:
        self.got.append((received.subject, received.message.header.seq))
        context.relay("tracks_out", received, after_s=self.after_s)


def wire(key: str, subject: str, message: str, publisher: str, subscriber: str) -> Wire:
    return Wire(key, subject, message, (Leg(key, Endpoint(publisher, message), (Endpoint(subscriber, message),)),))


#: Tracks of two agents reach the relay; `mallory` intercepts the second agent's.
WIRING = Wiring(
    (
        wire("clock", "", "clock", "simulator", "relay"),
        *(wire(f"agent/{name}/tracks", name, "tracks", name, "broker") for name in "ab"),
    )
)
for node, agent in (("relay", "a"), ("mallory", "b"), ("relay", "b")):
    WIRING = insert(WIRING, node, InsertionPoint(f"agent/{agent}/tracks", "tracks", "tracks_out"))
KEY_A, KEY_B = "agent/a/tracks/@tap/0", "agent/b/tracks/@tap/1"


def hosting(node: Node, *, encode: bool = True) -> tuple[Host, list[Outgoing]]:
    outbox: list[Outgoing] = []
    ports = WIRING.ports("relay")
    return Host("relay", node, ports, 0, encode=encode, emit=outbox.append, wiring=WIRING), outbox


def tracks_of(name: str, seq: int = 0, n: int = 1, frame: int = 0) -> Message:
    states = ObjectStates.of(np.zeros((n, 3)), covariance=np.tile(np.eye(9), (n, 1, 1)))
    body = tracks() | states.columns() | {"id": np.arange(n)}
    return codec.conform(Header("tracks", name, frame, frame * 10**8, seq), body)


def clock(frame: int) -> bytes:
    return codec.encode(codec.conform(Header("clock", "simulator", frame, frame * 10**8, frame), {}))


def test_a_floods_held_messages_are_bounded_and_take_no_other_sources_room() -> None:
    host, _ = hosting(Relay())
    big = codec.encode(tracks_of("b", n=20_000))
    assert 14 * MIB < len(big) < 16 * MIB
    for _ in range(20):
        host.deliver(KEY_B, big, LATER)
    host.deliver(KEY_A, codec.encode(tracks_of("a")), LATER)
    assert host.waiting == 3, "two of 15 MB from one source, and the other source's"
    assert host.rejected == {(KEY_B, "held"): 18}
    assert host.handled[KEY_B] == 18, "lock-step does not wait for dropped messages"
    frame, reason = host.first_rejected[KEY_B]
    assert (frame, reason.startswith("held: "), "of mallory" in reason) == (-1, True, True)
    host.deliver("clock", clock(LATER), LATER)
    assert host.node.got == [("b", 0), ("b", 0), ("a", 0)]
    host.deliver(KEY_B, big, LATER + 1)
    assert host.waiting == 1, "there is space again"


def test_the_source_of_a_key_is_its_publisher_in_the_newest_wiring() -> None:
    host, _ = hosting(Relay())
    assert host.publisher(KEY_B) == "mallory"
    *others, of_b = WIRING.wires
    legs = of_b.legs[0], replace(of_b.legs[1], publisher=Endpoint("eve", "tracks_out")), of_b.legs[2]
    host.rewired(Wiring((*others, replace(of_b, legs=legs))))
    assert host.publisher(KEY_B) == "eve"


@pytest.mark.parametrize("encode", [True, False])
def test_a_flood_through_a_delaying_link_loses_only_its_own_messages(encode, monkeypatch) -> None:
    one = len(codec.encode(tracks_of("b", n=10)))
    monkeypatch.setattr("mast_zenoh.mesh.host.DELAYED", Limit(100, 3 * one))
    host, outbox = hosting(Relay(after_s=0.1), encode=encode)
    host.deliver("clock", clock(0), 0)
    for seq in range(5):
        content = tracks_of("b", seq, n=10)
        host.deliver(KEY_B, codec.encode(content) if encode else content, 0)
    content = tracks_of("a")
    host.deliver(KEY_A, codec.encode(content) if encode else content, 0)
    assert host.rejected == {(KEY_B, "delayed"): 2}
    assert not host.failures, "receiving too much is not the node's own fault"
    host.deliver("clock", clock(1), 1)
    assert [out.key for out in outbox] == ["agent/b/tracks"] * 3 + ["agent/a/tracks"]
    host.deliver(KEY_B, codec.encode(tracks_of("b", 9, n=30)) if encode else tracks_of("b", 9, n=28), 1)
    assert host.rejected == {(KEY_B, "delayed"): 2}, "there is space again"


@given(st.lists(st.tuples(st.sampled_from("abc"), st.integers(0, 40), st.booleans())))
def test_each_source_has_exactly_its_room(steps: list[tuple[str, int, bool]]) -> None:
    room = Room(Limit(5, 100))
    waiting: dict[str, list[int]] = {source: [] for source in "abc"}
    for source, size, leaves in steps:
        own = waiting[source]
        if leaves and own:
            room.free(source, own.pop(0))
            continue
        fits = len(own) < 5 and sum(own) + size <= 100
        assert room.take(source, size) == fits
        if fits:
            own.append(size)


def test_the_inbox_drops_and_counts_excess_messages_of_a_source() -> None:
    items: deque[Item] = deque()
    inbox = EventInbox(items.append, nullcontext(), Limit(3, 1000))
    for number in range(5):
        assert inbox.put_message("mallory", MessageEvent("bad", bytes(400), 7, number), 7) == (number < 2)
    good = MessageEvent("good", b"x", 7, 0)
    assert inbox.put_message("a", good, 7)
    inbox.put(StopEvent("end"))
    bad = [MessageEvent("bad", bytes(400), 7, number) for number in range(2)]
    assert [inbox.take(item) for item in items] == [*bad, DroppedEvent({("bad", 7): 3}), good, StopEvent("end")]
    assert inbox.take_dropped() == {}
    assert inbox.put_message("mallory", bad[0], 7), "there is space again"


def on_no_mesh(node: Node) -> Hosted:
    hosted = Hosted("relay", node, WIRING, period_ns=10**8)
    hosted.protocol.handle(EpochEvent(Epoch(1, {"relay": "link", "a": "agent"}, None)))
    return hosted


def test_messages_of_a_later_epoch_are_bounded_by_source(caplog: pytest.LogCaptureFixture) -> None:
    mesh = on_no_mesh(Relay())
    big = codec.encode(tracks_of("b", n=20_000))
    with caplog.at_level(logging.WARNING):
        for epoch in (2, 2, 2, 2, 9, 2**32 - 1):
            mesh.protocol.receive_message(MessageEvent(KEY_B, big, epoch, -1))
            mesh.handle_all()
    mesh.protocol.receive_message(MessageEvent(KEY_A, codec.encode(tracks_of("a")), 2, -1))
    mesh.handle_all()
    assert mesh.protocol.host.rejected == {(KEY_B, "early"): 4}
    assert len(caplog.records) == 1
    mesh.protocol.handle(EpochEvent(Epoch(2, {"relay": "link", "a": "agent"}, None)))
    assert mesh.protocol.host.node.got == [("b", 0), ("b", 0), ("a", 0)]
    assert mesh.protocol.host.handled[KEY_B] == 4, "the driver does not wait for messages dropped in this epoch"
    for _ in range(2):
        mesh.protocol.receive_message(MessageEvent(KEY_B, big, 3, -1))
        mesh.handle_all()
    mesh.protocol.handle(EpochEvent(Epoch(3, {"relay": "link", "a": "agent"}, None)))
    assert mesh.protocol.host.rejected == {(KEY_B, "early"): 4}, "there is space again"
    assert mesh.protocol.host.handled[KEY_B] == 2


def test_a_slow_node_keeps_no_more_of_a_flood_than_the_limit_of_its_source() -> None:
    mesh = on_no_mesh(Relay())
    big = codec.encode(tracks_of("b", n=20_000))
    for _ in range(30):
        mesh.protocol.receive_message(MessageEvent(KEY_B, big, 1, -1))
    mesh.protocol.receive_message(MessageEvent(KEY_A, codec.encode(tracks_of("a")), 1, -1))
    mesh.handle_all()
    fits = INBOX.bytes // len(big)
    assert fits < 10
    assert mesh.protocol.host.node.got == [("b", 0)] * fits + [("a", 0)]
    assert mesh.protocol.host.rejected == {(KEY_B, "queued"): 30 - fits}
    assert mesh.protocol.host.handled[KEY_B] == 30
    mesh.protocol.handle(EpochEvent(Epoch(2, {"relay": "link", "a": "agent"}, None)))
    assert mesh.protocol.host.handled[KEY_B] == 0
    for _ in range(30):
        mesh.protocol.receive_message(MessageEvent(KEY_B, big, 3, -1))
    mesh.handle_all()
    assert mesh.protocol.host.handled[KEY_B] == 0
    mesh.protocol.handle(EpochEvent(Epoch(3, {"relay": "link", "a": "agent"}, None)))
    assert mesh.protocol.host.handled[KEY_B] == 30, "those of the next epoch that were dropped count there"


def test_held_back_messages_are_published_on_the_new_key_and_the_old_one_is_undeclared() -> None:
    actions = MagicMock()
    outlets = Outlets(WIRING, "relay", actions)
    outlet = outlets["agent/a/tracks"]
    outlet.held = []
    outlets.send(Outgoing("agent/a/tracks", b"x", 3), 1)
    assert not actions.mock_calls
    assert outlets.move(outlet, "other") == 1
    assert actions.mock_calls == [call.publish("other", b"x", stamp("other", 1, 3)), call.undeclare("agent/a/tracks")]


@pytest.mark.parametrize(
    ("attachment", "expected"),
    [
        (stamp(KEY_A, 3, 7), (3, 7)),
        (stamp(KEY_B, 3, 7), MISDIRECTED),
        (control_mark("stop"), MISDIRECTED),
        (ATTACHMENT.pack(MARK, 3, 7), MISDIRECTED),
        (b"NONE" + stamp(KEY_A, 3, 7)[4:], FOREIGN),
        (b"short", FOREIGN),
        (stamp(KEY_A, 3, 7) + b"more", FOREIGN),
    ],
)
def test_only_a_stamp_of_this_testbed_and_of_the_key_is_believed(attachment: bytes, expected: tuple[int, int]) -> None:
    assert stamp_of(zenoh.ZBytes(attachment), KEY_A) == expected


def test_forty_agents_in_a_large_scene_stay_far_below_every_limit() -> None:
    """60 tracks of each of 40 agents, 300 road users, 10 Hz; maximal lag."""
    agents, objects, seen = 40, 300, 60
    rows = {"collated": agents * seen, "picture": objects, "tracks": seen, "detections": seen, "truth": objects}
    size = {schema: _encoded(schema, n, agents) for schema, n in rows.items()} | {"pose": 300, "status": 300}
    by_source = {
        "simulator": (1 + 2 * agents + 1, agents * (size["pose"] + size["detections"]) + size["truth"]),
        "agent": (3, 2 * size["tracks"] + size["status"]),
        "broker": (1, size["collated"]),
        "command_center": (1, size["picture"]),
    }
    for messages, n_bytes in by_source.values():
        for limit, frames in ((HELD, 3), (EARLY, 3), (INBOX, SETTLE_EVERY)):
            assert messages * frames <= limit.messages / 2
            assert n_bytes * frames <= limit.bytes * 3 / 4
    half_a_minute = 300  # frames by which a link delays messages
    assert 3 * half_a_minute <= DELAYED.messages / 2
    assert max(size["tracks"], size["picture"]) * half_a_minute <= DELAYED.bytes * 3 / 4


def _encoded(schema: str, n: int, agents: int) -> int:
    """Bytes of a message with n objects."""
    sizes = {"n": n, "a": agents}
    body = {}
    for column in SCHEMAS[schema].columns:
        shape = tuple(sizes[size] if isinstance(size, str) else size for size in column.shape)
        body[column.name] = text(["infra_10"] * shape[0]) if column.dtype == "str" else np.zeros(shape, column.dtype)
    return len(codec.encode(codec.conform(Header(schema, "broker", 200, 20 * 10**9, 200), body)))


def test_the_limits_of_one_source_fit_into_the_memory_of_a_process() -> None:
    assert HELD.bytes + EARLY.bytes + INBOX.bytes + DELAYED.bytes <= 320 * MIB
    assert all(limit.bytes >= 2 * codec.MAX_BYTES for limit in (HELD, EARLY, INBOX, DELAYED))
