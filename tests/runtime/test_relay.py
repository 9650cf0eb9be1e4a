"""Relaying: unchanged, changed, damaged, twice, restamped or delayed."""

import logging
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tiny_world import tracks

from mast_zenoh.errors import ConfigurationError
from mast_zenoh.mesh.host import Host, Outgoing
from mast_zenoh.messages import codec
from mast_zenoh.messages.schemas import Header, Message
from mast_zenoh.node import Context, Node, Received
from mast_zenoh.wiring.model import Input, Ports

PERIOD_NS = 10**8
Act = Callable[[Received, Context], None]


class Interposer(Node):
    """Runs the test's action on statuses."""

    inputs = {"clock": "clock", "status": "status"}
    outputs = {"status_out": "status"}

    def __init__(self, act: Act) -> None:
        self.act = act

    def on_clock(self, received: Received, context: Context) -> None: ...

    def on_status(self, received: Received, context: Context) -> None:
        self.act(received, context)


class Reporting(Interposer):
    """A relay that publishes at every clock."""

    outputs = {"status_out": "status", "report": "tracks"}

    def on_clock(self, received: Received, context: Context) -> None:
        context.publish("report", tracks())


class Deaf(Interposer):
    """A relay without a clock."""

    inputs = {"status": "status"}


class Time:
    """A machine clock advanced by the test."""

    def __init__(self) -> None:
        self.ns = 5_000

    def __call__(self) -> int:
        return self.ns


def hosting(
    act: Act, *, encode: bool = True, now: Callable[[], int] | None = None, node: type = Interposer
) -> tuple[Host, list[Outgoing]]:
    """A host, and the messages that left it."""
    inputs = {"in": Input("status", "a", "status", "a")}
    if "clock" in node.inputs:
        inputs["clock"] = Input("clock", "", "clock", "simulator")
    ports = Ports(inputs, {("status_out", "a"): "out", ("report", ""): "report"})
    outbox: list[Outgoing] = []
    emit = outbox.append
    return Host("link", node(act), ports, 7, encode=encode, emit=emit, period_ns=PERIOD_NS, now=now), outbox


def status(frame: int, seq: int | None = None, n_tracks: int = 0) -> Message:
    header = Header("status", "a", frame, frame * PERIOD_NS, frame if seq is None else seq)
    return codec.conform(header, {"mobile": np.zeros(1), "detections": np.zeros(1), "tracks": np.array([n_tracks])})


def send(host: Host, message: Message, step: int | None = None) -> None:
    payload = codec.encode(message) if host._encode else message
    host.deliver("in", payload, message.header.frame if step is None else step)


def clock(host: Host, frame: int) -> None:
    message = codec.conform(Header("clock", "simulator", frame, frame * PERIOD_NS, frame), {})
    host.deliver("clock", codec.encode(message) if host._encode else message, frame)


def content(out: Outgoing) -> Message:
    return codec.decode(out.payload, "status") if isinstance(out.payload, bytes) else out.payload


def sent_messages(outbox: list[Outgoing]) -> list[tuple[int, int]]:
    """(step, seq) of the messages that left."""
    return [(out.step, content(out).header.seq) for out in outbox if out.key == "out"]


def relaying(**how: Any) -> Act:
    return lambda received, context: context.relay("status_out", received, **how)


both = pytest.mark.parametrize("encode", [True, False], ids=["bytes", "objects"])


@both
def test_relay_can_replace_only_the_time_of_a_message(encode: bool) -> None:
    host, outbox = hosting(relaying(time_ns=123), encode=encode)
    clock(host, 0)
    send(host, status(0, n_tracks=4))
    (out,) = outbox
    assert content(out).header == status(0).header._replace(time_ns=123)
    assert content(out).body["tracks"].tolist() == [4]


@both
def test_a_payload_is_sent_unchanged(encode: bool) -> None:
    host, outbox = hosting(relaying(payload=b"\xc1 nonsense"), encode=encode)
    clock(host, 0)
    send(host, status(0))
    assert [out.payload for out in outbox] == [b"\xc1 nonsense"]


def test_bytes_in_one_process_are_decoded_and_forwarded_unchanged() -> None:
    """Valid bytes with another packing are kept by the next node."""
    sound = status(0, n_tracks=3)
    odd = codec.encode(sound).replace(b"\xa5frame\x00", b"\xa5frame\xcc\x00")
    assert odd != codec.encode(sound)
    assert codec.decode(odd, "status").header == sound.header
    seen: list[Received] = []

    def act(received: Received, context: Context) -> None:
        seen.append(received)
        context.relay("status_out", received)

    host, outbox = hosting(act, encode=False)
    clock(host, 0)
    host.deliver("in", odd, 0)
    assert [out.payload for out in outbox] == [odd]
    assert seen[0].body["tracks"].tolist() == [3]
    assert seen[0].encoded == odd


def test_damaged_bytes_in_one_process_cost_the_receiver_one_message() -> None:
    host, outbox = hosting(relaying(), encode=False)
    clock(host, 0)
    host.deliver("in", codec.encode(status(0))[:-3], 0)
    assert not outbox
    assert host.rejected.total() == 1


@pytest.mark.parametrize(("after_s", "leaves"), [(0.0, 1), (0.0999, 1), (0.1, 2), (0.1 + 0.2, 4)])
def test_in_lock_step_a_message_leaves_in_the_frame_that_contains_its_due_time(after_s, leaves) -> None:
    host, outbox = hosting(relaying(after_s=after_s))
    for frame in range(6):
        clock(host, frame)
        if frame == 1:
            send(host, status(1))
    assert sent_messages(outbox) == [(leaves, 1)]
    assert host.sent["out"] == host.handled["in"] == 1


def test_delayed_messages_leave_by_due_time_then_arrival_before_those_of_the_frame() -> None:
    delays = iter([0.25, 0.1, 0.12, 0.0])
    host, outbox = hosting(lambda received, context: context.relay("status_out", received, after_s=next(delays)))
    clock(host, 0)
    send(host, status(0, seq=0))  # due at 0.25
    clock(host, 1)
    send(host, status(1, seq=1))  # due at 0.2
    send(host, status(1, seq=2))  # due at 0.22
    send(host, status(2, seq=3))  # of the next frame: it has to wait
    clock(host, 2)
    assert sent_messages(outbox) == [(2, 1), (2, 2), (2, 0), (2, 3)]


def test_after_a_missing_clock_messages_due_at_the_same_time_leave_in_order_of_arrival() -> None:
    host, outbox = hosting(relaying(after_s=0.1))
    clock(host, 0)
    for seq in range(5):
        send(host, status(0, seq=seq))
    clock(host, 3)
    assert sent_messages(outbox) == [(3, seq) for seq in range(5)]


def test_delayed_messages_leave_after_the_clock_handlers_messages() -> None:
    host, outbox = hosting(relaying(after_s=0.1), node=Reporting)
    clock(host, 0)
    send(host, status(0))
    clock(host, 1)
    assert [(out.key, out.step) for out in outbox] == [("report", 0), ("report", 1), ("out", 1)]


def test_a_delayed_message_counts_as_sent_when_it_leaves() -> None:
    host, _ = hosting(relaying(after_s=0.1))
    clock(host, 0)
    send(host, status(0))
    assert (host.sent["out"], host.handled["in"]) == (0, 1), "lock-step does not wait for it"
    host.reset_counts()
    clock(host, 1)
    assert host.sent["out"] == 1, "it counts when it leaves"


def test_in_real_time_a_delayed_message_leaves_when_it_is_due_not_at_a_clock() -> None:
    now = Time()
    host, outbox = hosting(relaying(after_s=0.05), now=now)
    clock(host, 0)
    send(host, status(0))
    assert host.release() == pytest.approx(0.05)
    now.ns += 30_000_000
    clock(host, 1)
    assert host.release() == pytest.approx(0.02)
    assert not outbox
    now.ns += 20_000_000
    assert host.release() is None
    assert sent_messages(outbox) == [(1, 0)]


def test_time_is_that_of_the_frame_in_lock_step_and_advances_between_frames_in_real_time() -> None:
    for now, expected in ((None, [4 * PERIOD_NS]), (Time(), [7])):
        seen: list[int] = []
        host, _ = hosting(lambda received, context, seen=seen: seen.append(context.now_ns), now=now)
        assert now is None or host.now_ns == 0
        clock(host, 4)
        if now:
            now.ns += 7
        send(host, status(4))
        assert host.release() is None
        clock(host, 5)
        assert seen == expected
        assert now is None or host.now_ns == 7


@given(st.lists(st.tuples(st.integers(0, 4), st.floats(0.0, 1.0)), max_size=30))
def test_each_delayed_message_leaves_once_and_not_early(plan: list[tuple[int, float]]) -> None:
    delays = iter([after_s for _, after_s in sorted(plan, key=lambda entry: entry[0])])
    host, outbox = hosting(lambda received, context: context.relay("status_out", received, after_s=next(delays)))
    order = sorted(plan, key=lambda entry: entry[0])
    for frame in range(16):
        clock(host, frame)
        for seq, (arrives, _) in enumerate(order):
            if arrives == frame:
                send(host, status(frame, seq=seq))
    expected = sorted((arrives + round(after * 1e9) // PERIOD_NS, seq) for seq, (arrives, after) in enumerate(order))
    assert sorted(sent_messages(outbox)) == expected
    assert [step for step, _ in sent_messages(outbox)] == sorted(step for step, _ in expected)


@pytest.mark.parametrize("after_s", [-0.1, float("nan"), float("inf"), -float("inf"), 3601.0, 1e300])
def test_an_invalid_delay_loses_one_message(after_s: float, caplog: pytest.LogCaptureFixture) -> None:
    delays = iter([after_s, 0.0])
    host, outbox = hosting(lambda received, context: context.relay("status_out", received, after_s=next(delays)))
    clock(host, 0)
    with caplog.at_level(logging.ERROR):
        send(host, status(0, seq=0))
    send(host, status(0, seq=1))
    assert sent_messages(outbox) == [(0, 1)]
    assert host.failures["on_status"].count == 1
    assert "after_s: found" in caplog.text


@pytest.mark.parametrize("how", [dict(payload=b"", time_ns=1), dict(payload=b"", body={})])
def test_contradictory_arguments_of_relay_are_refused(how: dict[str, Any]) -> None:
    host, _ = hosting(relaying())
    with pytest.raises(ConfigurationError, match=r"no body.*time_ns"):
        host.relay("status_out", Received(status(0), "a"), **how)


def test_a_node_without_a_clock_cannot_delay_messages() -> None:
    host, _ = hosting(relaying(), node=Deaf)
    with pytest.raises(ConfigurationError, match=r"does.*receive.*clock"):
        host.relay("status_out", Received(status(0), "a"), after_s=0.2)
