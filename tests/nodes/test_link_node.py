"""The link node applies its rules and reports message fates."""

from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from link_rules import RULES
from tiny_world import Bench, Run, picture, pose, tiny, tracks

from mast_zenoh.arrays.geometry import rotation_from_quaternion, rotation_from_yaw
from mast_zenoh.config.resolved import Resolved, build_node
from mast_zenoh.integrity.views import view_columns
from mast_zenoh.links import FATES, WIRES
from mast_zenoh.mesh.host import Host, Outgoing
from mast_zenoh.messages import codec
from mast_zenoh.messages.schemas import Header, Message
from mast_zenoh.tracking.view import SensorView
from mast_zenoh.wiring.model import Wiring

TRACKS, STATUS, PICTURE = ("agent/ego/tracks/@tap/broker/0", "agent/ego/status/@tap/broker/0", "cc/picture/@tap/ego/0")
REPORT = "link/link_ego/report"
SAID = {"mobile": [1], "detections": [3], "tracks": [2]}


def world(up: list[dict[str, Any]], down: list[dict[str, Any]] | None = None, **more: Any) -> Resolved:
    """The shipped baseline with a link on the ego."""

    def edit(content: dict[str, Any]) -> None:
        content["links"] = {"ego": dict(up=up, down=down or [])}

    return tiny("baseline", edit=edit, infrastructure=1, **more)


def bench(*up: dict[str, Any], down: list[dict[str, Any]] | None = None, encode: bool = True) -> Bench:
    """The ego's link by itself, at the first frame."""
    link = Bench(world(list(up), down), "link_ego", encode=encode)
    link.clock(0)
    return link


def status() -> dict[str, np.ndarray]:
    schema = {"mobile": np.uint8, "detections": np.int64, "tracks": np.int64}
    return {name: np.array(SAID[name], dtype) for name, dtype in schema.items()}


def rows(link: Bench) -> list[tuple[Any, ...]]:
    """All reports of the link: (step after it, port, frame, seq, fate, rule)."""
    return [
        (message.header.frame, WIRES[port], *columns, FATES[fate], rule)
        for message in link.heard(REPORT)
        for port, *columns, fate, rule in zip(
            *(message.body[name].tolist() for name in ("port", "frame", "seq", "fate", "rule")), strict=True
        )
    ]


@pytest.mark.parametrize("encode", [True, False])
def test_a_link_without_rules_forwards_everything_unchanged(encode: bool) -> None:
    link = bench(encode=encode)
    for key, port, body in (
        (TRACKS, "tracks", tracks((1.0, 2.0))),
        (STATUS, "status", status()),
        (PICTURE, "picture", picture((3.0, 4.0))),
    ):
        message = link.message(link.key(port), body, 0)
        assert [out_key for out_key, _ in link.deliver(link.key(port), message)] == [key]
        assert link.payloads[-1] == codec.encode(message)
    link.clock(1)
    assert rows(link) == []


def test_messages_from_and_to_the_agent_have_separate_rules() -> None:
    link = bench(dict(type="Cut"), down=[dict(type="Flood", copies=2)])
    assert link.send("tracks", tracks((1.0, 2.0)), 0) == []
    assert [key for key, _ in link.send("picture", picture(), 0)] == [PICTURE] * 3
    link.clock(1)
    assert rows(link) == [(1, "tracks", 0, 0, "dropped", 0), (1, "picture", 0, 0, "duplicated", 0)]


@pytest.mark.parametrize(("mean_s", "frames"), [(0.25, 2), (0.099, 0)])
def test_a_delay_is_rounded_down_to_whole_frames(mean_s: float, frames: int) -> None:
    link = bench(dict(type="Delay", mean_s=mean_s, distribution="constant"))
    published = [link.send("tracks", tracks((1.0, 2.0)), 0), link.clock(1), link.clock(2)]
    assert [TRACKS in dict(messages) for messages in published] == [frame == frames for frame in range(3)]
    (message,) = link.heard(TRACKS)
    assert (message.header.frame, message.header.seq) == (0, 0)
    assert rows(link) == ([(1, "tracks", 0, 0, "delayed", 0)] if frames else [])


def test_reports_cover_the_previous_step_and_are_sorted() -> None:
    link = bench(dict(type="Cut"), down=[dict(type="Cut")])
    for frame in range(3):
        link.send("picture", picture(), frame)
        link.send("tracks", tracks(), frame)
        link.clock(frame + 1)
    assert rows(link) == [
        (frame + 1, wire, frame, frame, "dropped", 0) for frame in range(3) for wire in ("tracks", "picture")
    ]


def test_a_new_agent_position_takes_effect_in_the_next_frame_in_any_order() -> None:
    limit = dict(type="RangeLimit", range_m=50.0, gateways=[[0.0, 0.0, 0.0]])
    for pose_first in (True, False):
        link, passed = bench(limit), []
        for frame, x in enumerate((10.0, 80.0, 20.0, 20.0)):
            if frame:
                link.clock(frame)
            if pose_first:
                link.send("pose", pose(x), frame)
            passed.append(bool(link.send("tracks", tracks(), frame)))
            if not pose_first:
                link.send("pose", pose(x), frame)
        assert passed == [True, True, False, True]


def test_a_wrong_clock_and_pose_change_only_the_header_time_and_the_frame_of_reference() -> None:
    link = bench(dict(type="ClockSkew", offset_s=0.03), dict(type="PoseError", bias_m=[2.0, -1.0]))
    body = tracks((1.0, 2.0))
    ((_, message),) = link.send("tracks", body, 0)
    assert message.header == Header("tracks", "ego", 0, 30_000_000, 0)
    assert message.body["origin"].tolist() == [2.0, -1.0, 0.0]
    for name in body.keys() - {"origin"}:
        assert np.array_equal(message.body[name], body[name])
    ((_, message),) = link.send("status", status(), 0)
    assert message.header.time_ns == 30_000_000
    early = bench(dict(type="ClockSkew", offset_s=-5.0)).send("tracks", tracks(), 0)
    assert early[0][1].header.time_ns == 0, "time does not become negative"
    link.clock(1)
    assert rows(link) == [(1, "tracks", 0, 0, "altered", 0), (1, "status", 0, 0, "altered", 0)]


@pytest.mark.parametrize("encode", [True, False])
@pytest.mark.parametrize("skew", [[], [dict(type="ClockSkew", offset_s=1.0)]])
def test_a_corrupted_message_differs_from_the_otherwise_altered_one_in_some_bits(encode, skew) -> None:
    link = bench(*skew, dict(type="Corrupt", probability=1.0, flips=1), encode=encode)
    key = link.key("tracks")
    message = link.message(key, tracks((1.0, 2.0)), 0)
    link.host.deliver(key, codec.encode(message) if encode else message, 0)
    (out,) = link.outbox
    assert isinstance(out.payload, bytes)
    header = message.header._replace(time_ns=10**9 if skew else 0)
    sound = codec.encode(Message(header, message.body))
    assert sum((a ^ b).bit_count() for a, b in zip(out.payload, sound, strict=True)) == 1


EVERY_RULE = [dict(type=name, **config) for name, config in RULES.items()]
rules = st.lists(st.sampled_from(EVERY_RULE), max_size=5)


@given(up=rules, down=rules, shuffle=st.integers(0, 1000), encode=st.booleans())
@example(up=EVERY_RULE, down=EVERY_RULE, shuffle=1, encode=False)
@settings(max_examples=6)
def test_with_any_rules_a_run_does_not_depend_on_delivery_order_or_encoding(up, down, shuffle, encode) -> None:
    resolved = world(up, down, frames=10)
    plain, other = Run(resolved), Run(resolved, shuffle=shuffle, encode=encode)
    assert other.messages == plain.messages
    assert other.packed == plain.packed
    assert not plain.failures
    assert plain.messages[REPORT] or up != EVERY_RULE


@cache
def skewed_link() -> Bench:
    return bench(dict(type="ClockSkew", offset_s=1.0), dict(type="PoseError", bias_m=[1.0, 0.0]))


@given(payload=st.binary(max_size=200))
def test_malformed_bytes_are_forwarded_unchanged(payload: bytes) -> None:
    link = skewed_link()
    for port in ("tracks", "picture", "pose"):
        link.host.deliver(link.key(port), payload, 0)
    assert [out.payload for out in link.outbox] == [payload, payload], "their subscribers will refuse them"
    assert not link.host.failures
    link.outbox.clear()
    assert [key for key, _ in link.send("tracks", tracks(), 0)] == [TRACKS]
    link.said.clear()


@pytest.mark.parametrize("encode", [True, False])
def test_a_malformed_body_passes_an_undecoding_link(encode: bool) -> None:
    link = bench(dict(type="ClockSkew", offset_s=1.0), dict(type="PoseError", bias_m=[1.0, 0.0]), encode=encode)
    key, body = link.key("tracks"), tracks((1.0, 2.0))
    body["position"] = np.full((1, 3), np.nan)
    message = link.message(key, body, 0)
    if encode:
        link.host.deliver(key, codec.encode(message), 0)
    else:
        link.host.deliver(key, message, 0, flaw="not finite")
    (out,) = link.outbox
    assert out.payload == codec.encode(message)
    assert not link.host.failures


def test_the_results_count_the_fates_of_messages() -> None:
    link = bench(dict(type="Cut"), down=[dict(type="Loss", probability=0.0)])
    for _ in range(3):
        link.send("tracks", tracks(), 0)
        link.send("picture", picture(), 0)
    link.clock(1)
    assert link.host.finish() == {"link": {"picture": {"came": 3}, "tracks": {"came": 3, "dropped": 3}}}


@given(
    delays_ms=st.lists(st.sampled_from([0.0, 0.001, 3.0, 50.0]), min_size=2, max_size=12),
    gaps_us=st.lists(st.integers(1, 4000), min_size=12, max_size=12),
)
def test_in_real_time_messages_leave_in_order(delays_ms: list[float], gaps_us: list[int]) -> None:
    starts = [1e-3 * i for i in range(len(delays_ms) + 1)]  # each message has its own delay
    rules = [
        dict(type="Delay", mean_s=ms * 1e-3, distribution="constant", at=at, until=until)
        for ms, at, until in zip(delays_ms, starts, starts[1:], strict=False)
    ]
    built = _RealTime(rules)
    for number in range(len(delays_ms)):
        built.now += 1000 * gaps_us[number]
        built.clock(number, time_ns=number * 1_000_000)
        built.now += 7  # time advances during handlers
        built.send(number)
    built.now += 10**9
    built.host.release()
    assert built.sent() == list(range(len(delays_ms)))


def test_in_a_realistic_network_static_agents_are_wired_and_mobile_ones_wireless() -> None:
    resolved = tiny("realistic_network")
    rules = {name: spec.config["rules_up"] for name, spec in resolved.nodes.items() if spec.role == "link"}
    ranged = {name: any(rule["type"] == "RangeLimit" for rule in directions) for name, directions in rules.items()}
    assert ranged == {"link_ego": True, "link_infra_1": False, "link_infra_2": False}


class _RealTime:
    """The ego's link on a test clock that advances by 1 ns per reading."""

    def __init__(self, rules: list[dict[str, Any]]) -> None:
        resolved = world(rules)
        self.now = 10**12
        ports = Wiring.from_json(resolved.wiring).ports("link_ego")
        built = build_node(resolved.nodes["link_ego"], "link_ego")
        self.outbox: list[Outgoing] = []
        self.host = Host("link_ego", built, ports, 0, encode=True, emit=self.outbox.append, now=self.tick)
        self.host.start({})

    def tick(self) -> int:
        self.now += 1
        return self.now

    def clock(self, frame: int, time_ns: int) -> None:
        message = codec.conform(Header("clock", "simulator", frame, time_ns, frame), {})
        self.host.deliver("clock", codec.encode(message), frame)

    def send(self, seq: int) -> None:
        message = codec.conform(Header("tracks", "ego", seq, 0, seq), tracks())
        self.host.deliver("agent/ego/tracks", codec.encode(message), seq)

    def sent(self) -> list[int]:
        out = [out.payload for out in self.outbox if out.key == TRACKS]
        return [codec.decode(payload, "tracks").header.seq for payload in out if isinstance(payload, bytes)]


# -- an error of a sender's pose moves its tracks and its view alike ---------------------------------------------------


def with_views(*up: dict[str, Any]) -> Bench:
    """The ego's link by itself, in a run whose agents send views."""

    def edit(content: dict[str, Any]) -> None:
        content["links"] = {"ego": dict(up=list(up))}
        content["keyexpr"] = dict(map="testbed.toml", rewrites=["views.toml"])

    link = Bench(tiny("baseline", edit=edit, infrastructure=1), "link_ego")
    link.play(0, pose=pose(40.0, -30.0))
    link.clock(1)
    return link


def view(x: float, y: float, yaw: float = 0.0) -> dict[str, np.ndarray]:
    """The view of a sensor."""
    sensor = SensorView(np.array([x, y, 1.8]), rotation_from_yaw(yaw), -1.0, 1.0, -0.3, 0.1, 100.0)
    return view_columns(sensor, np.full((2, 3), 50.0))


def sent(link: Bench, frame: int) -> tuple[Message, Message]:
    """The tracks and the view of a frame, after the link."""
    (_, moved_tracks), (_, moved_view) = (
        *link.send("tracks", tracks((50.0, -30.0)), frame),
        *link.send("view", view(41.0, -30.0, 0.3), frame),
    )
    return moved_tracks, moved_view


def place(message: Message, point: tuple[float, float, float]) -> np.ndarray:
    """A point of a tracks message in the world."""
    turn = rotation_from_quaternion(message.body["rotation"])
    return np.asarray(turn @ np.array(point) + message.body["origin"])


def test_a_constant_error_moves_tracks_and_view_as_one_rigid_body() -> None:
    link = with_views(dict(type="PoseError", bias_m=[2.0, -1.0], bias_yaw_rad=0.1))
    moved_tracks, moved_view = sent(link, 1)
    assert moved_view.body["position"] == pytest.approx(place(moved_tracks, (41.0, -30.0, 1.8)))
    before, after = (rotation_from_quaternion(body["rotation"]) for body in (view(0, 0, 0.3), moved_view.body))
    assert after == pytest.approx(rotation_from_yaw(0.1) @ before)
    assert np.array_equal(moved_view.body["free"], view(0, 0)["free"])


def test_a_wrong_heading_turns_tracks_about_the_sender() -> None:
    """Not about the origin of the world: an object at the sender stays, one 10 m ahead moves by 1 m."""
    link = with_views(dict(type="PoseError", bias_yaw_rad=0.1))
    moved, _ = sent(link, 1)
    assert place(moved, (40.0, -30.0, 0.0)) == pytest.approx([40.0, -30.0, 0.0])
    assert place(moved, (50.0, -30.0, 0.0)) == pytest.approx([40 + 10 * np.cos(0.1), -30 + 10 * np.sin(0.1), 0.0])


def test_tracks_and_view_of_a_frame_have_the_same_random_error() -> None:
    link = with_views(dict(type="Delay", mean_s=0.0), dict(type="PoseError", position_std_m=1.0, yaw_std_rad=0.05))
    places = []
    for frame in range(1, 4):
        moved_tracks, moved_view = sent(link, frame)
        assert moved_view.body["position"] == pytest.approx(place(moved_tracks, (41.0, -30.0, 1.8)))
        places.append(moved_view.body["position"])
        link.send("pose", pose(40.0, -30.0), frame)
        link.clock(frame + 1)
    assert np.ptp(np.array(places), axis=0)[:2].min() > 0.01, "another error for each frame"


def test_reports_tell_that_the_view_was_altered() -> None:
    link = with_views(dict(type="PoseError", bias_m=[2.0, 0.0]))
    sent(link, 1)
    ((_, report),) = link.clock(2)
    assert report.body["port"].tolist() == [0, 5]
    assert set(report.body["fate"].tolist()) == {4}
