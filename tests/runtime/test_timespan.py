"""Messages with impossible frames or times are rejected on arrival."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from test_host import CLOCK, OUTPUTS, TRACKS, Listener, clock, tracks, tracks_payload

from mast_zenoh.errors import MessageError
from mast_zenoh.links import ClockSkew
from mast_zenoh.messages import codec
from mast_zenoh.messages.limits import Timespan
from mast_zenoh.messages.schemas import Header
from mast_zenoh.runtime.host import Host
from mast_zenoh.wiring.model import Ports
from mast_zenoh.wiring.received import Overheard

PERIOD_NS, SECOND = 10**8, 10**9
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
def test_times_and_frames_outside_the_run_are_rejected_on_arrival(
    frame: int, time_ns: int, step: int, kind: str
) -> None:
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
        with pytest.raises(MessageError, match=r"time: tracks: time_ns is 1000000000000000000, expected 4000000000 to"):
            check()


def test_a_faulty_clock_declares_its_error() -> None:
    skew = ClockSkew(offset_s=-5.0, drift=0.1)
    assert skew.restamps_s(20.0) == pytest.approx(7.0)
    times = np.arange(0, 20 * SECOND, PERIOD_NS)
    assert abs(-5.0 * SECOND + 0.1 * times).max() <= skew.restamps_s(20.0) * SECOND
