"""A message with an implausible time costs only itself, and is counted."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from test_host import CLOCK, OUTPUTS, TRACKS, Listener, clock, tracks, tracks_payload
from tiny_world import PERIOD_NS, Bench, Run, states, tiny

from mast_zenoh import scenario
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.errors import MessageError
from mast_zenoh.evaluation.effects.passages import RESTAMPED
from mast_zenoh.links import ClockSkew
from mast_zenoh.mesh.host import Host
from mast_zenoh.messages import codec
from mast_zenoh.messages.limits import Timespan
from mast_zenoh.messages.schemas import Header, text
from mast_zenoh.wiring.model import Ports
from mast_zenoh.wiring.received import Overheard

FRAMES, WRONG = 30, 20
SECOND = 10**9

RESTAMPER = '''
from mast_zenoh.node import Node


class Restamper(Node):
    """Puts the times of the batches wrong from one frame on, for so many frames."""

    role = "tap"
    inputs = {"collated": "collated"}
    outputs = {"collated_out": "collated"}

    def __init__(self, at: int, frames: int, by_ns: int, declared_s: float = 0.0) -> None:
        self.at, self.frames, self.by_ns, self.declared_s = at, frames, by_ns, declared_s

    def restamps_s(self, duration_s):
        return self.declared_s

    def on_collated(self, received, context):
        wrong = self.at <= received.frame < self.at + self.frames
        context.relay("collated_out", received, time_ns=max(0, received.time_ns + self.by_ns) if wrong else None)
'''


def restamped(folder: Path, **config: object) -> Resolved:
    """A scenario with changed times of some batches to the command centre."""
    file = folder / "restamper.py"
    file.write_text(RESTAMPER)
    path, content = scenario.load("baseline", ["n_infrastructure=2"])
    content["nodes"] = {"restamper": dict(role="tap", file=str(file), at=WRONG, **config)}
    insert = dict(wire="cc/collated", role="tap", input="collated", output="collated_out")
    content["keyexpr"] = {"rewrites": [{"insert": [insert]}]}
    return scenario.resolve(path, content, frames=FRAMES, seed=0)


def pictured(run: Run) -> list[int]:
    return [message.header.frame for message in run.decoded("cc/picture", "picture")]


@pytest.mark.parametrize(
    ("frames", "by_ns", "lost", "reason"),
    [
        *((1, by_ns, [WRONG], "time") for by_ns in (30 * SECOND, -3 * SECOND // 2)),
        (3, -SECOND // 2, [WRONG, WRONG + 1, WRONG + 2], "old"),
        (1, SECOND // 2, [*range(WRONG + 1, WRONG + 5)], "old"),
    ],
    ids=["in the future", "in the past", "older than the newest", "ahead within the leeway"],
)
def test_a_batch_with_an_implausible_time_costs_only_pictures(tmp_path, frames, by_ns, lost, reason) -> None:
    run = Run(restamped(tmp_path, frames=frames, by_ns=by_ns))
    assert pictured(run) == [frame for frame in range(FRAMES) if frame not in lost]
    assert run.rejected["command_center"] == {("cc/collated", reason): len(lost)}
    assert not run.failures
    meter = next(m for m in run.nodes["evaluator"].data.meter.meters if m.passage.node == "restamper")
    effects = [(e.effect, e.frame) for e in meter.effects.messages]
    assert effects == [(RESTAMPED, frame) for frame in range(WRONG, WRONG + frames)]


def test_the_declared_time_error_of_a_node_is_allowed(tmp_path: Path) -> None:
    wrong = dict(frames=FRAMES, by_ns=30 * SECOND)
    assert pictured(Run(restamped(tmp_path, **wrong))) == list(range(WRONG))
    run = Run(restamped(tmp_path, **wrong, declared_s=30.0))
    assert pictured(run) == list(range(FRAMES))
    assert not run.rejected


def test_a_scenario_with_a_faulty_clock_widens_the_tolerance() -> None:
    def skewed(content: dict[str, object]) -> None:
        skew = dict(type="ClockSkew", offset_s=-20.0)
        content["links"] = {"infra_1": dict(up=[skew]), "*": dict(up=[])}

    plain, faulty = tiny(), tiny(edit=skewed)
    assert plain.timespan.leeway_ns == SECOND
    assert faulty.timespan.leeway_ns == 21 * SECOND
    assert Resolved.from_json(faulty.to_json(), faulty.wiring).timespan == faulty.timespan
    assert not Run(faulty).rejected


@pytest.mark.parametrize("encode", [True, False])
def test_no_pipeline_gets_a_batch_older_than_the_previous_one(encode: bool) -> None:
    centre = Bench(tiny(), "command_center", encode=encode)
    body = states((0.0, 0.0)).columns() | {
        "agent": np.zeros(1, np.int64),
        "agents": text(["a"]),
        "age_ns": np.zeros(1, np.int64),
    }
    key = centre.key("collated")
    for frame, time_ns in ((0, 0), (1, 4 * PERIOD_NS), (2, 2 * PERIOD_NS), (3, 4 * PERIOD_NS)):
        centre.clock(frame)
        centre.deliver(key, centre.message(key, body, frame, time_ns=time_ns))
    assert [message.header.frame for message in centre.heard("cc/picture")] == [0, 1, 3]
    assert centre.host.rejected == {(key, "old"): 1}
    assert centre.host.first_rejected[key][1].startswith("old: collated: time_ns")
    assert not centre.host.failures


# -- on arrival --------------------------------------------------------------------------------------------------------

SPAN = Timespan(frames=200, period_ns=PERIOD_NS, leeway_ns=SECOND)
KEY = "agent/a/tracks"


def hosting(*, now=None) -> Host:
    ports = Ports(CLOCK | TRACKS, OUTPUTS)
    return Host("listener", Listener(), ports, 7, encode=True, emit=[].append, now=now, timespan=SPAN)


def stamped(frame: int, time_ns: int, source: str = "a") -> bytes:
    return codec.encode(codec.conform(Header("tracks", source, frame, time_ns, 0), tracks()))


def header(frame: int, time_ns: int) -> Header:
    return Header("tracks", "a", frame, time_ns, 0)


@pytest.mark.parametrize(
    ("frame", "time_ns", "step", "kind"),
    [
        (50, 10**18, 50, "time"),  # far in the future
        (50, 7 * SECOND, 50, "time"),
        (50, 3 * SECOND, 50, "time"),  # restamped into the past
        (70, 7 * SECOND, 50, "frame"),  # a frame that has not begun
        (10**9, 10**9 * PERIOD_NS, 50, "frame"),
        (50, 5 * SECOND, 52, "step"),  # from a frame that cannot have begun
        (50, 5 * SECOND, 10**9, "step"),
    ],
)
def test_times_and_frames_outside_the_run_are_rejected_on_arrival(frame, time_ns, step, kind) -> None:
    host = hosting()
    host.deliver("clock", clock(50), 50)
    host.deliver(KEY, stamped(frame, time_ns), step)
    assert host.node.got == [("clock", 50)]
    assert host.waiting == 0
    assert host.rejected == {(KEY, kind): 1}
    assert host.handled[KEY] == 1, "lock-step does not wait for it"


@pytest.mark.parametrize(
    ("frame", "time_ns"),
    [
        (50, 5 * SECOND),
        (0, 0),  # delayed since the scene began
        (50, 5 * SECOND + SECOND),  # within the tolerance: a wrong clock, or an adversary
        (50, 5 * SECOND - SECOND),
        (20, 5 * SECOND),  # about an earlier frame, with the current time
        (60, 6 * SECOND),  # ahead of the newest clock by the tolerance
    ],
)
def test_messages_with_possible_delays_and_clock_errors_are_accepted(frame: int, time_ns: int) -> None:
    host = hosting()
    host.deliver("clock", clock(50), 50)
    host.deliver(KEY, stamped(frame, time_ns), 50)
    assert host.node.got[1:] == [("a", frame)]
    assert not host.rejected


def test_a_message_from_outside_is_checked_against_the_newest_clock() -> None:
    host = hosting()
    host.deliver("clock", clock(50), 50)
    host.deliver(KEY, stamped(150, 15 * SECOND), -1, counted=False)
    assert host.rejected == {(KEY, "frame"): 1}


def test_a_clock_beyond_the_end_of_the_scene_is_rejected() -> None:
    host = hosting()
    host.deliver("clock", clock(10**6), 100)
    assert host.rejected == {("clock", "frame"): 1}
    assert host.frame == -1


def test_a_node_that_starts_later_waits_for_its_first_clock_of_any_frame() -> None:
    host = hosting()
    host.deliver(KEY, tracks_payload("a", 120), 120)
    host.deliver("clock", clock(120), 120)
    assert host.node.got == [("clock", 120), ("a", 120)]


def test_in_real_time_a_node_may_lag_by_more_than_a_frame() -> None:
    host = hosting(now=lambda: 0)
    host.deliver("clock", clock(50), 50)
    host.deliver(KEY, tracks_payload("a", 53), 53)
    host.deliver("clock", clock(53), 53)
    assert host.node.got[-1] == ("a", 53)


@given(st.integers(0, 199), st.integers(0, 199), st.integers(-SECOND, SECOND))
def test_every_message_about_a_frame_that_has_begun_is_accepted(frame: int, later: int, wrong_ns: int) -> None:
    step = min(199, frame + later)
    assert SPAN.refusal(header(frame, max(0, frame * PERIOD_NS + wrong_ns)), step) == ""


@given(st.integers(0, 1 << 61), st.integers(0, 1 << 61), st.integers(-1, 1 << 61))
def test_no_accepted_message_advances_a_node_beyond_the_leeway(frame: int, time_ns: int, step: int) -> None:
    if not SPAN.refusal(header(frame, time_ns), step):
        assert time_ns <= (step if step >= 0 else 199) * PERIOD_NS + 2 * SECOND
        assert frame <= 199 + SECOND // PERIOD_NS


def test_an_overhearer_can_read_a_message_that_would_be_rejected() -> None:
    overheard = Overheard(KEY, TRACKS[KEY], stamped(50, 10**18), 50, "", SPAN)
    assert overheard.header.time_ns == 10**18
    assert len(overheard.body["id"]) == 1, "the meter compares it"
    for check in (overheard.check, overheard.check_time):
        with pytest.raises(MessageError, match="time: tracks: time_ns"):
            check()


def test_a_faulty_clock_declares_its_error() -> None:
    skew = ClockSkew(offset_s=-5.0, drift=0.1)
    assert skew.restamps_s(20.0) == pytest.approx(7.0)
    times = np.arange(0, 20 * SECOND, PERIOD_NS)
    assert abs(-5.0 * SECOND + 0.1 * times).max() <= skew.restamps_s(20.0) * SECOND
