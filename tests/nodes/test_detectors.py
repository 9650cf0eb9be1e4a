"""Detectors that are slow, fail or hang, and bad scans: what a run does, and what it tells."""

from dataclasses import replace
from typing import Any

import msgpack
import numpy as np
import pytest
from damage import refused
from tiny_world import PERIOD_NS, Bench, Run, tiny

from mast_zenoh.arrays.geometry import quaternion_from_rotation, rotation_from_yaw_pitch
from mast_zenoh.arrays.states import Detections
from mast_zenoh.attacks.point_attacks import PointAttack
from mast_zenoh.config import registry
from mast_zenoh.config.resolved import Resolved, build_node
from mast_zenoh.errors import MessageError
from mast_zenoh.mesh.host import Host
from mast_zenoh.messages import codec
from mast_zenoh.messages.schemas import Header, Message
from mast_zenoh.sensing.point_detector import PointDetector
from mast_zenoh.sensing.points import Points
from mast_zenoh.testing.simulation import Disturbance, Schedule, SimulatedWorld, SimulationOutcome, play
from mast_zenoh.wiring.model import Wiring

FRAMES = 6
NODE, SPOOFER = "detector_ego", "spoofer_1"
BEFORE = "agent/ego/points/@tap/0"  # of the spoofer


class SlowDetector(PointDetector):
    """Takes 80 ms of a clock that a test gives it."""

    def __init__(self) -> None:
        self.clock = [0]

    def detect(self, points: Points) -> Detections:
        self.clock[0] += 80_000_000
        return Detections.empty()


class FailingDetector(PointDetector):
    """Fails in every second scan."""

    def __init__(self) -> None:
        self.scans = 0

    def detect(self, points: Points) -> Detections:
        self.scans += 1
        if self.scans % 2:
            raise RuntimeError("no network")
        return Detections.empty()


def resolved(
    detector: str | dict[str, Any] = "ClusterDetector",
    frames: int = FRAMES,
    attack: dict[str, Any] | None = None,
    **points: Any,
) -> Resolved:
    finds = dict(type=detector) if isinstance(detector, str) else detector
    options = dict(detector=finds, lidar="VLP-16", clutter=None) | points

    def edit(content: dict[str, Any]) -> None:
        content["points"] = options
        if attack is not None:
            content["adversaries"] = {SPOOFER: dict(type="Adversary", agent="ego", attack=attack)}
            content["keyexpr"] = dict(map="testbed.toml", rewrites=["on_points.toml"])

    return tiny(frames=frames, edit=edit)


def scans(run: Run) -> list[Message]:
    return run.decoded("agent/ego/points", "points")


@pytest.fixture(scope="module")
def honest() -> Run:
    return Run(resolved())


def clock(frame: int) -> Message:
    return codec.conform(Header("clock", "simulator", frame, frame * PERIOD_NS, frame), {})


# -- slow --------------------------------------------------------------------------------------------------------------


def test_in_real_time_detections_are_as_old_as_their_detector_is_slow(honest: Run) -> None:
    world, sent = resolved("SlowDetector"), []
    node: Any = build_node(world.nodes[NODE], NODE)
    now = node.detector.clock
    host = Host.of(
        world, NODE, node, Wiring.from_json(world.wiring), encode=False, emit=sent.append, now=lambda: now[0]
    )
    for frame, scan in enumerate(scans(honest)):
        now[0] = frame * PERIOD_NS
        for message in (clock(frame), scan):
            key = "clock" if message is not scan else "agent/ego/points"
            host.deliver(key, message, frame)
    assert len(sent) == FRAMES
    assert host.finish()["oldest_s"] == pytest.approx(0.08)


def test_in_lock_step_a_slow_detector_is_not_late() -> None:
    run = Run(resolved("SlowDetector"))
    assert run.results[NODE]["oldest_s"] == 0.0
    assert run.results[NODE]["scans"] == FRAMES


def test_detections_that_come_after_the_next_frame_has_begun_count_for_nothing(honest: Run) -> None:
    bench = Bench(resolved(), "ego")
    for frame in (0, 1):
        late = honest.decoded("agent/ego/detections", "detections")[frame]
        assert len(late.body["yaw"])
        for key, schema in (("clock", "clock"), ("agent/ego/pose", "pose")):
            bench.deliver(key, honest.decoded(key, schema)[frame])
    tracks = dict(bench.deliver("agent/ego/detections", honest.decoded("agent/ego/detections", "detections")[0]))
    assert not tracks, "frame 0 was played without them"
    sent = bench.deliver("agent/ego/detections", honest.decoded("agent/ego/detections", "detections")[1])
    assert "agent/ego/tracks" in dict(sent)


# -- failing, hanging --------------------------------------------------------------------------------------------------


def test_a_detector_that_fails_finds_nothing_in_that_scan_and_the_run_names_it() -> None:
    run = Run(resolved("FailingDetector"))
    detections = run.decoded("agent/ego/detections", "detections")
    assert [len(message.body["yaw"]) for message in detections] == [0] * FRAMES
    failure = run.failures[NODE]["detect"]
    assert (failure.count, failure.exception) == (FRAMES // 2, "RuntimeError: no network")


def hanging(mode: str, at_s: float) -> SimulationOutcome:
    """A run on the simulated mesh in which a detector hangs from then on, for as long as anybody waits."""
    world = SimulatedWorld.of(replace(resolved(), mode=mode))
    outcome = play(world, Schedule(1, (Disturbance(at_s, "freeze", NODE, 45.0),), calm=True))
    assert not outcome.missed
    return outcome


def test_a_detector_that_hangs_stalls_a_run_in_lock_step_and_is_named() -> None:
    assert hanging("lockstep", 0.02).error.startswith(f"StallError: stall: {NODE} has handled 0 of 1 messages")


def test_in_real_time_a_run_goes_on_without_a_detector_that_hangs_and_kills_it_at_the_end() -> None:
    outcome = hanging("realtime", 0.3)
    assert (outcome.error, outcome.frames) == ("", FRAMES)
    assert outcome.lost == {NODE: "killed by signal 9 (SIGKILL)"}


# -- bad scans ---------------------------------------------------------------------------------------------------------


def altered(scan: Message, **columns: Any) -> dict[str, Any]:
    return {**scan.body, **columns}


def raw(scan: Message, **columns: np.ndarray) -> bytes:
    """The message with columns that are not checked, as an attacker encodes it."""
    fields = msgpack.unpackb(codec.encode(scan))
    for name, values in columns.items():
        fields["body"][name] = [values.dtype.str, list(values.shape), values.tobytes()]
    return bytes(msgpack.packb(fields))


def bad_scans(scan: Message) -> dict[str, bytes]:
    n, position = len(scan.body["channel"]), scan.body["position"]
    return {
        "NaN": raw(scan, position=np.where(np.arange(n)[:, None] == 3, np.float32(np.nan), position)),
        "infinite times": raw(scan, time_s=np.full(n, np.inf, np.float32)),
        "wrong dtype": raw(scan, position=position.astype(np.float64)),
        "wrong width": raw(scan, position=np.zeros((n, 2), np.float32)),
        "fewer channels": raw(scan, channel=scan.body["channel"][:-1]),
        "no rotation": raw(scan, level_rotation=np.zeros(4)),
        "rotation of three": raw(scan, level_rotation=np.zeros(3)),
        "ten million points": raw(scan, position=np.zeros((10_000_000, 3), np.float32)),
    }


def test_bad_scans_are_refused_and_cost_one_message_each(honest: Run) -> None:
    scan = scans(honest)[1]
    for node, place in ((NODE, "detector"), ("ego", "agent")):
        bench = Bench(resolved(detected_by=place), node)
        for key, message in (("clock", clock(0)), ("agent/ego/points", scans(honest)[0]), ("clock", clock(1))):
            bench.deliver(key, message)
        for what, payload in bad_scans(scan).items():
            assert refused(lambda payload: codec.decode(payload, "points"), payload), what
            bench.host.deliver("agent/ego/points", payload, 1, counted=False)
        assert sum(bench.host.rejected.values()) == len(bad_scans(scan))
        assert not bench.host.failures
        bench.deliver("agent/ego/points", scan)
        if node == NODE:
            (actual,) = [message for key, message in bench.said if key.endswith("detections") and message.header.frame]
            expected = honest.decoded("agent/ego/detections", "detections")[1]
            np.testing.assert_array_equal(actual.body["position"], expected.body["position"])


def strange_scans(scan: Message) -> dict[str, dict[str, Any]]:
    """Scans that are valid messages, and that no lidar returns."""
    n, tilted = len(scan.body["channel"]), quaternion_from_rotation(rotation_from_yaw_pitch(1.0, 1.2))
    empty = {name: scan.body[name][:0] for name in ("position", "intensity", "time_s", "channel")}
    many = {name: np.resize(scan.body[name], (200_000, *scan.body[name].shape[1:])) for name in empty}
    return {
        "empty": altered(scan, **empty),
        "one point": altered(scan, **{name: scan.body[name][:1] for name in empty}),
        "all in one place": altered(scan, position=np.ones((n, 3), np.float32)),
        "far away": altered(scan, position=9e8 * np.linspace(-1, 1, 3 * n, dtype=np.float32).reshape(n, 3)),
        "forged level": altered(scan, level_rotation=tilted),
        "not normalised": altered(scan, level_rotation=scan.body["level_rotation"] * 3.0),
        "two hundred thousand points": altered(scan, **many),
    }


def test_strange_scans_are_detected_in_and_the_next_scan_is_as_before(honest: Run) -> None:
    scan, expected = scans(honest)[1], honest.decoded("agent/ego/detections", "detections")[1]
    for what, body in strange_scans(scan).items():
        bench = Bench(resolved(), NODE)
        bench.deliver("clock", clock(0))
        try:
            sent = bench.deliver("agent/ego/points", codec.conform(scan.header._replace(frame=0, time_ns=0), body))
        except MessageError:
            continue  # it is refused where it is made
        assert len(sent) == 1, what
        assert not bench.host.failures, what
        bench.deliver("clock", clock(1))
        ((_, detections),) = bench.deliver("agent/ego/points", scan)
        np.testing.assert_array_equal(detections.body["position"], expected.body["position"], what)


CHECKED = dict(
    type="CheckedDetector",
    detector=dict(type="ClusterDetector"),
    checks=[dict(type="OcclusionCheck"), dict(type="ShadowCheck"), dict(type="TemporalCheck")],
)


def test_checks_judge_strange_scans_without_failing(honest: Run) -> None:
    bench = Bench(resolved(detector=CHECKED), NODE)
    for frame, (what, body) in enumerate(strange_scans(scans(honest)[1]).items()):
        bench.deliver("clock", clock(frame))
        header = scans(honest)[1].header._replace(frame=frame, time_ns=frame * PERIOD_NS, seq=frame)
        try:
            sent = bench.deliver("agent/ego/points", codec.conform(header, body))
        except MessageError:
            continue
        assert len(sent) == 1, what
        assert not bench.host.failures, what


ATTACKS = [name for name, cls in registry.known_types(PointAttack).items() if cls.__module__.startswith("mast_zenoh.")]


@pytest.mark.parametrize("attack", ATTACKS)
def test_a_spoofer_passes_strange_scans_on_and_bad_ones_cost_one_message_each(attack: str, honest: Run) -> None:
    bench = Bench(resolved(attack=dict(type=attack, start_s=0.0, place=None)), SPOOFER)
    scan, frame = scans(honest)[1], -1

    def pose(frame: int) -> Message:
        seen = honest.decoded("agent/ego/pose", "pose")[0]
        return codec.conform(seen.header._replace(frame=frame, time_ns=frame * PERIOD_NS, seq=frame), seen.body)

    for frame, (what, body) in enumerate(strange_scans(scan).items()):
        bench.deliver("clock", clock(frame))
        bench.deliver("agent/ego/pose", pose(frame))
        header = scan.header._replace(frame=frame, time_ns=frame * PERIOD_NS, seq=frame)
        try:
            sent = bench.deliver(BEFORE, codec.conform(header, body))
        except MessageError:
            continue
        assert [key for key, _ in sent].count("agent/ego/points") == 1, what
        assert not bench.host.failures, what
    for what, payload in bad_scans(scan).items():
        bench.host.deliver(BEFORE, payload, frame, counted=False)
        assert not bench.host.failures, what
    assert sum(bench.host.rejected.values()) == len(bad_scans(scan))
