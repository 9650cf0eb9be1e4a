"""The link node applies its rules and reports message fates."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from tiny_world import Bench, Run, picture, pose, tiny, tracks

from mast_zenoh import scenario
from mast_zenoh.config.registry import known_types
from mast_zenoh.config.resolved import Resolved, build_node
from mast_zenoh.links import FATES, WIRES, Rule
from mast_zenoh.messages import codec
from mast_zenoh.messages.schemas import Header, Message
from mast_zenoh.runtime.host import Host, Outgoing
from mast_zenoh.wiring.model import Wiring

TRACKS, STATUS, PICTURE = (
    "agent/ego/tracks/@tap/broker/0",
    "agent/ego/status/@tap/broker/0",
    "cc/picture/@tap/ego/0",
)
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
    assert rows(link) == [
        (1, "tracks", 0, 0, "altered", 0),
        (1, "status", 0, 0, "altered", 0),
    ]


@pytest.mark.parametrize("encode", [True, False])
@pytest.mark.parametrize("skew", [[], [dict(type="ClockSkew", offset_s=1.0)]])
def test_a_corrupted_message_differs_from_the_otherwise_altered_one_in_some_bits(
    encode: bool, skew: list[dict]
) -> None:
    link = bench(*skew, dict(type="Corrupt", probability=1.0, flips=1), encode=encode)
    key = link.key("tracks")
    message = link.message(key, tracks((1.0, 2.0)), 0)
    link.host.deliver(key, codec.encode(message) if encode else message, 0)
    (out,) = link.outbox
    assert isinstance(out.payload, bytes)
    header = message.header._replace(time_ns=10**9 if skew else 0)
    sound = codec.encode(Message(header, message.body))
    assert sum((a ^ b).bit_count() for a, b in zip(out.payload, sound, strict=True)) == 1


ANY_RULE: dict[str, dict[str, Any]] = {
    "Bandwidth": dict(bits_per_s=1e5, queue_s=0.3),
    "BlindSector": dict(azimuth_min_deg=-30.0, azimuth_max_deg=30.0),
    "ClockSkew": dict(offset_s=-0.15, drift=0.2),
    "Corrupt": dict(probability=0.4, flips=3),
    "Cut": dict(at=0.4, until=0.6),
    "Delay": dict(mean_s=0.1, jitter_s=0.1),
    "Duplicate": dict(probability=0.4, copies=2),
    "Flood": dict(copies=2, until=0.3),
    "GhostDetections": dict(places=[[20.0, 5.0, 0.75]]),
    "GilbertElliott": dict(good_to_bad=0.3, bad_to_good=0.5),
    "Hold": dict(at=0.2, until=0.5),
    "Loss": dict(probability=0.3),
    "PoseError": dict(position_std_m=1.0, yaw_std_rad=0.1),
    "RangeLimit": dict(range_m=35.0, gateways=[[20.0, 25.0, 15.0]]),
    "Reorder": dict(probability=0.4, by_s=0.15),
}
EVERY_RULE = [dict(type=name, **config) for name, config in ANY_RULE.items()]
rules = st.lists(st.sampled_from(sorted(ANY_RULE)), max_size=5).map(
    lambda names: [dict(type=name, **ANY_RULE[name]) for name in names]
)


def test_the_following_tests_cover_every_shipped_rule() -> None:
    ours = {name for name, rule in known_types(Rule).items() if rule.__module__.startswith("mast_zenoh.")}
    assert ours == ANY_RULE.keys()


@given(up=rules, down=rules, shuffle=st.integers(0, 1000), encode=st.booleans())
@example(up=EVERY_RULE, down=EVERY_RULE, shuffle=1, encode=False)
@settings(max_examples=12)
def test_with_any_rules_a_run_does_not_depend_on_delivery_order_or_encoding(
    up: list[dict], down: list[dict], shuffle: int, encode: bool
) -> None:
    resolved = world(up, down, frames=10)
    plain, other = Run(resolved), Run(resolved, shuffle=shuffle, encode=encode)
    assert other.messages == plain.messages
    assert other.packed == plain.packed
    assert not plain.failures
    assert plain.messages[REPORT] or up != EVERY_RULE


@given(payload=st.binary(max_size=200))
@settings(max_examples=60)
def test_malformed_bytes_are_forwarded_unchanged(payload: bytes) -> None:
    link = _broken_link()
    for port in ("tracks", "picture", "pose"):
        link.host.deliver(link.key(port), payload, 0)
    assert [out.payload for out in link.outbox] == [payload, payload], "their subscribers will refuse them"
    assert not link.host.failures
    link.outbox.clear()
    assert [key for key, _ in link.send("tracks", tracks(), 0)] == [TRACKS]
    link.said.clear()


_LINKS: list[Bench] = []


def _broken_link() -> Bench:
    if not _LINKS:
        _LINKS.append(bench(dict(type="ClockSkew", offset_s=1.0), dict(type="PoseError", bias_m=[1.0, 0.0])))
    return _LINKS[0]


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


@pytest.mark.parametrize("attack", ["none", "coordinated"])
def test_in_a_realistic_network_static_agents_are_wired_and_mobile_ones_wireless(attack: str) -> None:
    resolved = tiny("realistic_network", f"attack={attack}")
    rules = {name: spec.config["rules_up"] for name, spec in resolved.nodes.items() if spec.role == "link"}
    ranged = {name: any(rule["type"] == "RangeLimit" for rule in directions) for name, directions in rules.items()}
    assert ranged == {"link_ego": True, "link_infra_1": False, "link_infra_2": False}
    assert any(spec.role == "adversary" for spec in resolved.nodes.values()) is (attack != "none")
    plain, other = Run(resolved), Run(resolved, shuffle=1, encode=False)
    assert other.messages == plain.messages
    assert not plain.failures


OWN_MAP = {
    "insert": [
        {
            "wire": "agent/{agent}/detections",
            "role": "link",
            "input": "detections",
            "output": "detections_out",
        }
    ]
}


def test_a_user_map_can_insert_a_link_into_another_wire() -> None:
    def edit(content: dict[str, Any]) -> None:
        content["nodes"] = {"loose": dict(role="link", agent="ego", rules_up=[dict(type="Cut", at=0.3, until=0.6)])}
        content["keyexpr"] = dict(map="testbed.toml", rewrites=[OWN_MAP])

    run = Run(tiny("baseline", edit=edit))
    sent = [message.header.frame for message in run.decoded("agent/ego/detections/@tap/0", "detections")]
    frames = [message.header.frame for message in run.decoded("agent/ego/detections", "detections")]
    assert sent == list(range(12))
    assert frames == [frame for frame in sent if not 3 <= frame < 6]


def test_a_link_can_be_on_any_wire_that_a_map_names(tmp_path: Path) -> None:
    (tmp_path / "own.py").write_text("")
    _, content = scenario.load("baseline")
    content["scene"] = dict(type="TinyScene", n_infrastructure=1)
    content["nodes"] = {"loose": dict(role="link", agent="ego", rules_up=[dict(type="Flood", copies=1)])}
    content["keyexpr"] = dict(rewrites=[dict(insert=[dict(wire="agent/{agent}/mission", role="link")])])
    run = Run(scenario.resolve(tmp_path / "own.py", content, frames=4))
    assert len(run.messages["agent/ego/mission"]) == 2 * len(run.messages["agent/ego/mission/@tap/0"]) == 8


@given(
    delays_ms=st.lists(st.sampled_from([0.0, 0.001, 3.0, 50.0]), min_size=2, max_size=12),
    gaps_us=st.lists(st.integers(1, 4000), min_size=12, max_size=12),
)
@settings(max_examples=40)
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


def test_in_real_time_a_message_leaves_when_its_delay_is_over() -> None:
    built = _RealTime([dict(type="Delay", mean_s=0.02, distribution="constant")])
    built.clock(0, time_ns=0)
    built.send(0)
    built.now += 19_000_000
    assert built.host.release() == pytest.approx(0.001, abs=1e-7)
    assert built.sent() == []
    built.now += 1_000_000
    assert built.host.release() is None
    assert built.sent() == [0]


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
