"""The host delays, checks, numbers and counts the messages of a node."""

import logging
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.errors import ConfigurationError, MessageError
from mast_zenoh.mesh.host import Host, Outgoing
from mast_zenoh.messages import codec
from mast_zenoh.messages.schemas import Header, text
from mast_zenoh.node import Context, Node, Overheard, Received
from mast_zenoh.streams import stream
from mast_zenoh.wiring.model import ANY, Input, Ports

WORLD = {"origin": np.zeros(3), "rotation": np.array([1.0, 0.0, 0.0, 0.0])}


class Listener(Node):
    """Records its messages, and runs the test's action on tracks."""

    inputs = {"clock": "clock", "tracks": "tracks", "truth": "truth", "collated": "collated"}
    outputs = {"tracks_out": "tracks", "status": "status", "nowhere": "status"}

    def __init__(self, act: Callable[[Received, Context], None] | None = None) -> None:
        self.got: list[tuple[str, int]] = []
        self.received: list[Received] = []
        self.act = act

    def on_clock(self, received: Received, context: Context) -> None:
        self.got.append((received.message.header.schema, received.frame))

    on_truth = on_collated = on_clock

    def on_tracks(self, received: Received, context: Context) -> None:
        self.got.append((received.subject, received.frame))
        self.received.append(received)
        if self.act:
            self.act(received, context)


CLOCK = {"clock": Input("clock", "", "clock", "simulator")}
TRACKS = {f"agent/{name}/tracks": Input("tracks", name, "tracks", name) for name in ("a", "b")}
OUTPUTS = {("tracks_out", "a"): "out/a", ("tracks_out", "b"): "out/b", ("status", ""): "out/status"}


class Hosting(Host):
    """A host of a node that hears the clock and the tracks of `a` and `b`; outbox: what it has sent."""

    def __init__(self, node: Node, ports: Ports, encode: bool) -> None:
        self.outbox: list[Outgoing] = []
        super().__init__("listener", node, ports, seed=7, encode=encode, emit=self.outbox.append)


def listening(node: Node | None = None, *, clocked: bool = True, encode: bool = True) -> Hosting:
    return Hosting(node or Listener(), Ports((CLOCK if clocked else {}) | TRACKS, OUTPUTS), encode)


def tracks(n: int = 1, **columns: np.ndarray) -> dict[str, np.ndarray]:
    states = ObjectStates.of(np.zeros((n, 3)), covariance=np.tile(np.eye(9), (n, 1, 1)))
    return states.columns() | WORLD | columns


def message(schema: str, source: str, frame: int, body: dict[str, np.ndarray], seq: int = 0) -> bytes:
    return codec.encode(codec.conform(Header(schema, source, frame, frame * 10**8, seq), body))


def clock(frame: int, source: str = "simulator") -> bytes:
    return message("clock", source, frame, {})


def tracks_payload(name: str, frame: int, n: int = 1) -> bytes:
    return message("tracks", name, frame, tracks(n))


def test_a_message_of_a_later_step_waits_for_its_clock_or_a_later_one() -> None:
    host = listening()
    host.deliver("clock", clock(0), 0)
    host.deliver("agent/a/tracks", tracks_payload("a", 1), 1)
    host.deliver("agent/b/tracks", tracks_payload("b", 3), 3)
    assert host.node.got == [("clock", 0)]
    assert host.handled["agent/a/tracks"] == 0, "lock-step continues to wait for it"
    host.deliver("clock", clock(2), 2)
    assert host.node.got == [("clock", 0), ("clock", 2), ("a", 1)]
    assert (host.handled["agent/a/tracks"], host.handled["agent/b/tracks"]) == (1, 0)


def test_a_node_without_a_clock_handles_messages_at_once_and_sends_in_their_step() -> None:
    relay = Listener(lambda received, context: context.relay("tracks_out", received))
    host = listening(relay, clocked=False)
    for step in (0, 1):
        host.deliver("agent/a/tracks", tracks_payload("a", step), step)
    assert relay.got == [("a", 0), ("a", 1)]
    assert [out.step for out in host.outbox] == [0, 1], "otherwise the next node would not wait for its clock"


def test_a_node_without_a_clock_cannot_publish_without_a_frame() -> None:
    problems: list[str] = []

    def publish(received: Received, context: Context) -> None:
        with pytest.raises(ConfigurationError) as caught:
            context.publish("tracks_out", received.body, subject=received.subject)
        problems.append(str(caught.value))
        context.publish("tracks_out", received.body, subject=received.subject, frame=received.frame, time_ns=0)

    host = listening(Listener(publish), clocked=False)
    host.deliver("agent/a/tracks", tracks_payload("a", 3), 3)
    (problem,) = problems
    assert problem.startswith("listener: tracks_out: published")
    assert len(host.outbox) == 1


@given(st.data())
def test_each_message_is_handled_once_after_its_clock_in_any_order_of_arrival(data: st.DataObject) -> None:
    queues: dict[str, list[tuple[str, bytes, int]]] = {
        "clock": [("clock", clock(k), k) for k in range(4)],
        **{f"agent/{x}/tracks": [(f"agent/{x}/tracks", tracks_payload(x, k), k) for k in range(4)] for x in "ab"},
    }
    host = listening()
    while queues:
        key = data.draw(st.sampled_from(sorted(queues)))
        host.deliver(*queues[key].pop(0))
        if not queues[key]:
            del queues[key]
    got = host.node.got
    assert sorted(got) == sorted((source, k) for source in ("clock", "a", "b") for k in range(4))
    for source, frame in got:
        assert got.index((source, frame)) >= got.index(("clock", frame))
    assert set(host.handled.values()) == {4}


@pytest.mark.parametrize(
    ("key", "payload", "kind"),
    [
        ("agent/a/tracks", tracks_payload("b", 0), "tracks"),
        ("agent/a/tracks", clock(0), "tracks"),
        ("agent/a/tracks", tracks_payload("a", 0)[:-3], "tracks"),
        ("agent/a/tracks", b"", "tracks"),
        ("agent/a/tracks", message("tracks", "a", 0, tracks(id=np.zeros(1))).replace(b"tracks", b"trucks"), "tracks"),
        ("clock", clock(0, source="mallory"), "clock"),
    ],
)
def test_an_invalid_message_is_rejected_and_counted(key: str, payload: bytes, kind: str) -> None:
    host = listening()
    host.deliver(key, payload, -1)
    assert host.node.got == []
    assert sum(host.rejected.values()) == 1
    assert next(iter(host.rejected))[0] == key
    assert next(iter(host.rejected))[1].startswith(kind)
    assert host.handled[key] == 1, "lock-step does not wait for it"
    host.deliver("agent/a/tracks", tracks_payload("a", 0), -1)
    assert host.node.got == [("a", 0)]


def test_messages_from_outside_the_run_are_handled_at_once_and_do_not_count_for_lock_step() -> None:
    host = listening()
    host.deliver("agent/a/tracks", b"rubbish", -1, counted=False)
    host.deliver("agent/a/tracks", tracks_payload("a", 5), -1, counted=False)
    assert host.node.got == [("a", 5)]
    assert sum(host.rejected.values()) == 1
    assert not host.handled


def test_a_clock_never_goes_backwards() -> None:
    host = listening()
    for frame in (0, 2, 2, 1, 3):
        host.deliver("clock", clock(frame), frame)
    assert host.node.got == [("clock", 0), ("clock", 2), ("clock", 3)]
    assert host.rejected["clock", "clock"] == 2
    assert host.handled["clock"] == 5
    assert (host.frame, host.time_ns) == (3, 3 * 10**8)


def test_rejections_are_logged_once_per_key(caplog: pytest.LogCaptureFixture) -> None:
    host = listening()
    with caplog.at_level(logging.WARNING):
        for key in ("agent/a/tracks", "agent/b/tracks"):
            for payload in (b"rubbish", b"", tracks_payload("mallory", 0)):
                host.deliver(key, payload, -1)
    assert [key for record in caplog.records for key in TRACKS if key in record.getMessage()] == list(TRACKS)
    assert sum(host.rejected.values()) == 6
    host.drop("agent/c/tracks", "of two\nlines\n: which results may not hold")
    assert host.rejected["agent/c/tracks", "of two lines"] == 1


def test_a_handler_that_raises_loses_one_message_and_is_logged_once(caplog: pytest.LogCaptureFixture) -> None:
    def fail_on_even(received: Received, context: Context) -> None:
        if received.frame % 2 == 0:
            raise ZeroDivisionError(f"in frame {received.frame}")
        context.publish("status", status())

    host = listening(Listener(fail_on_even))
    with caplog.at_level(logging.ERROR):
        for frame in range(6):
            host.deliver("clock", clock(frame), frame)
            host.deliver("agent/a/tracks", tracks_payload("a", frame), frame)
    entry = host.failures["on_tracks"].entry()
    assert host.failures.keys() == {"on_tracks"}
    assert (entry["count"], entry["frames"], entry["first_frame"], entry["last_frame"]) == (3, 3, 0, 4)
    assert "in frame 0" in entry["exception"]
    assert entry["where"].partition(":")[0] == __file__
    assert host.handled["agent/a/tracks"] == 6
    assert len(host.outbox) == 3
    assert ["in frame 0" in record.exc_text for record in caplog.records] == [True]


def status() -> dict[str, np.ndarray]:
    return {"mobile": np.array([0]), "detections": np.array([1]), "tracks": np.array([2])}


@pytest.mark.parametrize("encode", [True, False])
def test_a_message_relayed_in_a_later_frame_is_unchanged(encode: bool) -> None:
    kept: list[Received] = []
    host = listening(Listener(lambda received, context: kept.append(received)), encode=encode)
    payload = tracks_payload("a", 0)
    host.deliver("clock", clock(0), 0)
    host.deliver("agent/a/tracks", payload if encode else codec.decode(payload, "tracks"), 0)
    host.deliver("clock", clock(1), 1)
    host.relay("tracks_out", kept[0])
    (out,) = host.outbox
    assert (out.payload if encode else codec.encode(out.payload)) == payload
    assert out.step == 1, "it is sent with the current step"


def test_a_message_cannot_be_relayed_on_a_port_of_another_type() -> None:
    host = listening()
    with pytest.raises(ConfigurationError, match=r"'status' messages.*'tracks'"):
        host.relay("status", Received(codec.decode(tracks_payload("b", 3), "tracks"), "b"))


def test_valid_messages_are_numbered_for_each_key_and_about_the_current_frame_by_default() -> None:
    host = listening()
    host.deliver("clock", clock(4), 4)
    with pytest.raises(MessageError, match=r"status.*missing: \['mobile'\]"):
        host.publish("status", {"detections": np.zeros(1), "tracks": np.zeros(1)})
    for subject in "aba":
        host.publish("tracks_out", tracks(), subject=subject)
    host.publish("status", status(), frame=2, time_ns=5)
    headers = [codec.decode(o.payload, "tracks" if o.key < "out/s" else "status").header for o in host.outbox]
    assert [(h.frame, h.time_ns, h.seq) for h in headers] == [(4, 4 * 10**8, seq) for seq in (0, 0, 1)] + [(2, 5, 0)]
    assert [(out.key, out.step) for out in host.outbox] == [("out/a", 4), ("out/b", 4), ("out/a", 4), ("out/status", 4)]
    assert host.sent == {"out/a": 2, "out/b": 1, "out/status": 1}
    host.reset_counts()
    assert not host.sent


def test_messages_to_an_unconnected_port_are_discarded() -> None:
    host = listening()
    host.publish("nowhere", status())
    host.publish("tracks_out", tracks(), subject="nobody")
    host.relay("tracks_out", Received(codec.decode(tracks_payload("c", 0), "tracks"), "c"))
    assert host.outbox == []
    assert not host.sent
    assert not host.connected("nowhere")
    assert not host.connected("tracks_out", "nobody")
    assert host.connected("tracks_out", "a")
    assert host.connected("tracks_out"), "there is a wire"


@pytest.mark.parametrize(
    "use",
    [
        lambda host: host.publish("tracks_ot", tracks()),
        lambda host: host.relay("tracks_ot", Received(codec.decode(tracks_payload("a", 0), "tracks"), "a")),
        lambda host: host.connected("tracks_ot"),
    ],
)
def test_an_unknown_port_is_refused_with_the_nearest(use: Callable[[Host], None]) -> None:
    with pytest.raises(ConfigurationError, match=r"output.*'tracks_ot'.*'tracks_out'"):
        use(listening())


def test_a_port_with_several_wires_requires_a_choice() -> None:
    with pytest.raises(ConfigurationError, match=r"wires: choose.*subject"):
        listening().publish("tracks_out", tracks())


def strings(*values: Any) -> np.ndarray:
    column = text([""] * len(values))
    column[:] = values
    return column


def collated(**columns: np.ndarray) -> dict[str, np.ndarray]:
    states = ObjectStates.of(np.zeros((2, 3)), covariance=np.tile(np.eye(9), (2, 1, 1)))
    batch = {"agent": np.array([0, 1]), "agents": strings("a", "b"), "age_ns": np.zeros(2, np.int64)}
    return states.columns() | batch | columns


#: (message type, body, header fields): mistakes in publishing, and a valid message at the end.
SLIPS = {
    "not a number": ("tracks", tracks(position=np.full((1, 3), np.nan)), {}),
    "infinite": ("tracks", tracks(velocity=np.full((1, 3), -np.inf)), {}),
    "absurdly large": ("tracks", tracks(yaw=np.array([1e300])), {}),
    "a class that does not exist": ("tracks", tracks(class_id=np.array([200])), {}),
    "an id twice": ("tracks", tracks(2, id=np.array([3, 3])), {}),
    "no rotation": ("tracks", tracks(rotation=np.zeros(4)), {}),
    "before the first frame": ("tracks", tracks(), {"frame": -1}),
    "at a negative time": ("tracks", tracks(), {"time_ns": -5}),
    "at a time that is not a whole number": ("tracks", tracks(), {"time_ns": 1.5}),
    "an agent that does not exist": ("collated", collated(agent=np.array([0, 2])), {}),
    "a name that is not a string": ("collated", collated(agents=strings("a", 3)), {}),
    "a name without end": ("collated", collated(agents=strings("a", "b" * 300)), {}),
    "more than a message may hold": ("tracks", tracks(30_000, id=np.arange(30_000)), {}),
    "nothing wrong": ("tracks", tracks(2), {}),
}


class Speaker(Node):
    outputs = {"tracks": "tracks", "collated": "collated"}


@pytest.mark.parametrize("slip", SLIPS)
def test_encoded_and_unencoded_messages_are_refused_alike(slip: str) -> None:
    schema, body, header = SLIPS[slip]
    outcomes = []
    for encode in (True, False):
        outbox: list[Outgoing] = []
        speaker = Host("a", Speaker(), Ports({}, {(schema, ""): "key"}), seed=0, encode=encode, emit=outbox.append)
        heard = Ports({"key": Input(schema, "a", schema, "a")}, {})
        listener = Host("listener", Listener(), heard, seed=0, encode=encode, emit=[].append)
        speaker.publish(schema, body, **{"frame": 0, "time_ns": 0} | header)
        (out,) = outbox
        listener.deliver(out.key, out.payload, out.step, flaw=out.flaw)
        outcomes.append((dict(listener.rejected), dict(listener.handled), listener.node.got))
    assert outcomes[0] == outcomes[1]
    assert bool(outcomes[0][0]) == (slip != "nothing wrong")


@pytest.mark.parametrize("encode", [True, False])
def test_received_messages_are_read_only(encode: bool) -> None:
    host = listening(encode=encode)
    outbox: list[Outgoing] = []
    ports = Ports({}, {("tracks", ""): "agent/a/tracks"})
    speaker = Host("a", Speaker(), ports, seed=0, encode=encode, emit=outbox.append)
    body = tracks(3)
    speaker.publish("tracks", body, frame=0)
    host.deliver("agent/a/tracks", outbox[0].payload, -1)
    with pytest.raises(ValueError, match="read-only"):
        host.node.received[0].body["position"][0] = 1.0
    body["position"][0] = 0.0  # the publisher's own array is still writable


def test_the_observer_gets_every_valid_message_of_the_nodes_keys() -> None:
    host = listening()
    seen: list[tuple[str, int]] = []
    host.observe = lambda key, header: seen.append((key, header.frame))
    for key, payload in (("a", tracks_payload("a", 3)), ("a", b"rubbish"), ("c", tracks_payload("c", 0))):
        host.deliver(f"agent/{key}/tracks", payload, 3)
    assert seen == [("agent/a/tracks", 3)], "on arrival, though the message waits for its clock"
    assert host.rejected.total() == 1


def test_random_streams_depend_on_seed_node_and_purpose() -> None:
    host = listening()
    drawn = host.rng("noise", 3).random(4)
    np.testing.assert_array_equal(drawn, stream(7, "listener", "noise", 3).random(4))
    assert not np.array_equal(drawn, host.rng("noise", 4).random(4))


def test_a_node_is_informed_of_other_nodes_before_the_first_frame_and_later() -> None:
    class Watcher(Node):
        def __init__(self) -> None:
            self.saw: list[tuple[str, ...]] = []

        def start(self, context: Context) -> None:
            self.saw.append(("start", context.name))

        def joined(self, node: str, role: str, context: Context) -> None:
            self.saw.append(("joined", node, role))

        def left(self, node: str, role: str, context: Context) -> None:
            self.saw.append(("left", node, role))

    host = Host("watcher", Watcher(), Ports({}, {}), seed=0, encode=True, emit=[].append)
    host.start({"ego": "agent", "broker": "broker"})
    host.left("ego", "agent")
    host.joined("ego", "agent")
    assert host.node.saw == [
        ("start", "watcher"),
        ("joined", "broker", "broker"),
        ("joined", "ego", "agent"),
        ("left", "ego", "agent"),
        ("joined", "ego", "agent"),
    ]


class Ear(Node):
    """Records all messages."""

    inputs = {"everything": ANY}

    def __init__(self) -> None:
        self.heard: list[Overheard] = []

    def on_everything(self, overheard: Overheard, context: Context) -> None:
        self.heard.append(overheard)


def ear(*, encode: bool = True) -> Host:
    heard = {
        key: Input("everything", hears.subject, hears.message, hears.source) for key, hears in (CLOCK | TRACKS).items()
    }
    return Host("ear", Ear(), Ports(heard, {}), seed=7, encode=encode, emit=[].append)


def test_a_node_that_receives_every_key_gets_bytes_and_header_immediately() -> None:
    host = ear()
    host.deliver("agent/a/tracks", tracks_payload("a", 3), 3)
    host.deliver("clock", clock(2), 2)
    assert [(o.key, o.payload, o.header.frame, o.step) for o in host.node.heard] == [
        ("agent/a/tracks", tracks_payload("a", 3), 3, 3),
        ("clock", clock(2), 2, 2),
    ]
    assert host.handled == {"agent/a/tracks": 1, "clock": 1}
    assert (host.frame, host.time_ns) == (2, 2 * 10**8), "it knows the current frame"
    assert set(host.subscriptions) == (CLOCK | TRACKS).keys()


def test_it_gets_malformed_messages_whose_body_raises_the_error() -> None:
    host = ear()
    broken = message("tracks", "a", 0, tracks(position=np.full((1, 3), np.nan)))
    payloads = [b"rubbish", bytes(bytearray(b"rubbish")), tracks_payload("mallory", 0), clock(0)]
    payloads += [tracks_payload("a", 0)[:-1], broken]
    for payload in payloads:
        host.deliver("agent/a/tracks", payload, -1, counted=False)
    assert [o.payload for o in host.node.heard] == payloads
    assert [o.same_bytes(host.node.heard[0]) for o in host.node.heard] == [True, True, *[False] * 4]
    assert host.node.heard[-1].header.frame == 0, "the body is decoded on first access"
    reasons = (*["not MessagePack"] * 2, "expected 'a'", "found clock", "not MessagePack", "not finite")
    for overheard, words in zip(host.node.heard, reasons, strict=True):
        with pytest.raises(MessageError, match=words):
            _ = (overheard.header, overheard.body)
    assert not host.rejected, "nothing was dropped"
    assert not host.handled


def test_in_one_process_messages_are_encoded_only_on_demand() -> None:
    host, payload = ear(encode=False), tracks_payload("a", 1)
    sent = codec.decode(payload, "tracks")
    host.deliver("agent/a/tracks", sent, 1)
    host.deliver("agent/a/tracks", sent, 1, flaw="a value is not finite")
    sound, flawed = host.node.heard
    assert sound.payload == payload
    assert sound.body is sent.body
    assert sound.same_bytes(flawed)
    with pytest.raises(MessageError, match="not finite"):
        _ = flawed.body


def test_ignored_keys_are_not_delivered_but_count_as_handled() -> None:
    host = ear()
    host.ignore({"agent/a/tracks"})
    host.deliver("agent/a/tracks", tracks_payload("a", 0), 0)
    host.deliver("clock", clock(0), 0)
    assert [o.key for o in host.node.heard] == ["clock"]
    assert host.handled == {"agent/a/tracks": 1, "clock": 1}
    host.ignore(())
    host.deliver("agent/a/tracks", tracks_payload("a", 1), 0)
    assert len(host.node.heard) == 2


def test_subscriptions_that_a_node_has_kept_grow_when_another_is_inserted() -> None:
    """The recorder's log keeps them from the start, and gets messages on the keys of nodes that are inserted later."""
    host = ear()
    kept = host.subscriptions
    host.add_input("wire/@tap/0", Input("everything", "", "tracks", "ego"))
    assert "wire/@tap/0" in kept
