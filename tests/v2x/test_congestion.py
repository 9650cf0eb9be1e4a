"""Congestion control: how often stations may send, given how busy the channel is."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mast_zenoh.config.registry import build
from mast_zenoh.v2x.congestion import AdaptiveDcc, CongestionControl, ReactiveDcc

SLOT_NS = 100_000_000
AIRTIME_NS = np.array([1_200_000])
KINDS = ("NoCongestionControl", "ReactiveDcc", "AdaptiveDcc")


def measure(control: CongestionControl, busy: float, seconds: float, start_s: float = 0.0, stations: int = 1) -> float:
    """Measure a constant busy ratio in each slot of a time; returns the end, s."""
    first, count = round(start_s * 10), round(seconds * 10)
    for slot in range(first, first + count):
        control.measure(slot * SLOT_NS, np.full(stations, busy))
    return (first + count) / 10


@pytest.mark.parametrize("kind", KINDS)
def test_the_first_message_may_always_be_sent(kind: str) -> None:
    control = build(dict(type=kind), CongestionControl, "congestion")
    assert control.may_send(0).all()


@pytest.mark.parametrize("kind", KINDS)
def test_stations_can_start_at_different_times(kind: str) -> None:
    control = build(dict(type=kind), CongestionControl, "congestion")
    control.reset(2, start_ns=np.array([0, 150_000_000]))
    for time_ns, ready in ((0, False), (149_000_000, False), (150_000_000, True)):
        assert control.may_send(time_ns)[1] == ready


def test_a_station_measures_nothing_before_its_start() -> None:
    control = ReactiveDcc()
    control.reset(2, start_ns=np.array([0, 500_000_000]))
    measure(control, 0.9, 1.0, stations=2)
    assert control.state.tolist() == [6, 0]


@pytest.mark.parametrize(
    ("period_ns", "frames"), [(0, [0, 2, 4, 6, 8, 10, 12]), (SLOT_NS, [0, 2, 3, 4, 5, 6, 8, 9, 10, 11, 12])]
)
def test_waits_are_not_rounded_up_to_frames_if_their_period_is_known(period_ns: int, frames: list[int]) -> None:
    """With waits of 120 ms, ten messages take 1.2 s."""
    control = ReactiveDcc(intervals_s=(0.12,) * 7)
    control.reset(1, period_ns=period_ns)
    sent = []
    for frame in range(13):
        if control.may_send(frame * SLOT_NS)[0]:
            control.note_sent(frame * SLOT_NS, AIRTIME_NS, np.ones(1, bool))
            sent.append(frame)
    assert sent == frames


@pytest.mark.parametrize(
    ("busy", "interval_ms"), [(0.1, 60), (0.19, 100), (0.3, 180), (0.55, 420), (0.59, 460), (1, 460)]
)
def test_reactive_control_has_an_interval_for_each_busy_ratio(busy: float, interval_ms: int) -> None:
    control = ReactiveDcc()
    measure(control, busy, 5.0)
    assert control.interval_ns(AIRTIME_NS).tolist() == [interval_ms * 1_000_000]


def test_reactive_control_slows_down_after_one_second_and_recovers_after_five() -> None:
    control = ReactiveDcc()
    now = measure(control, 0.9, 0.9)
    assert control.state.tolist() == [0]
    now = measure(control, 0.9, 0.1, now)
    assert control.state.tolist() == [6]
    now = measure(control, 0.0, 4.9, now)
    assert control.state.tolist() == [6]
    measure(control, 0.0, 0.1, now)
    assert control.state.tolist() == [0]


def test_a_short_burst_or_pause_does_not_change_the_state() -> None:
    control = ReactiveDcc()
    now = measure(control, 0.3, 6.0)
    for busy in (0.9, 0.3, 0.0, 0.3):
        now = measure(control, busy, 0.5, now)
        assert control.state.tolist() == [2]


def test_a_gate_stays_closed_for_the_interval_after_a_transmission() -> None:
    control = ReactiveDcc()
    measure(control, 0.3, 2.0)
    control.note_sent(2_000_000_000, AIRTIME_NS, np.ones(1, bool))
    assert not control.may_send(2_000_000_000 + 179_999_999).any()
    assert control.may_send(2_000_000_000 + 180_000_000).all()


def test_stations_are_independent() -> None:
    control = ReactiveDcc()
    control.reset(3)
    for slot in range(10):
        control.measure(slot * SLOT_NS, np.array([0.0, 0.3, 0.9]))
    assert control.state.tolist() == [0, 2, 6]
    control.note_sent(10 * SLOT_NS, np.full(3, 1_000_000), np.array([True, False, True]))
    assert control.may_send(10 * SLOT_NS).tolist() == [False, True, False]


@pytest.mark.parametrize("kind", ["ReactiveDcc", "AdaptiveDcc"])
@pytest.mark.parametrize("period_ns", [50_000_000, 500_000_000])
def test_control_does_not_depend_on_the_frame_rate(kind: str, period_ns: int) -> None:
    fine, other = (build(dict(type=kind), CongestionControl, "congestion") for _ in range(2))
    measure(fine, 0.4, 10.0)
    for time_ns in range(0, 10_000_000_000, period_ns):
        other.measure(time_ns, np.array([0.4]))
    other.measure(9_900_000_000, np.array([0.4]))
    assert other.interval_ns(AIRTIME_NS) == pytest.approx(fine.interval_ns(AIRTIME_NS))


def fair_share(control: AdaptiveDcc, stations: int) -> float:
    """The duty cycle at which n stations that hear each other stay.

    With busy = n delta, delta = (1 - alpha) delta + beta (target - n delta) gives
    delta (alpha + n beta) = beta target. The limits of a step do not act where nothing changes: there
    beta (target - n delta) = alpha delta <= 0.016 * 0.03 = 0.00048, which is less than 0.0005.
    """
    share = control.beta * control.target / (control.alpha + stations * control.beta)
    return min(max(share, control.least), control.most)


@pytest.mark.parametrize("stations", [1, 56, 1000])
@pytest.mark.parametrize("start", [0.0006, 0.03])
def test_adaptive_stations_converge_to_the_fair_share_below_the_target(stations: int, start: float) -> None:
    control = AdaptiveDcc()
    control.reset(stations)
    control._delta[:] = start
    for slot in range(3000):
        busy = min(float(control.delta.sum()), 1.0)
        control.measure(slot * SLOT_NS, np.full(stations, busy))
    assert control.delta == pytest.approx(np.full(stations, fair_share(control, stations)), rel=1e-3)
    assert control.delta.sum() < control.target


def test_adaptive_stations_that_start_unequal_become_equal() -> None:
    control = AdaptiveDcc()
    control.reset(50)
    control._delta[:] = np.linspace(0.0006, 0.03, 50)
    for slot in range(3000):
        control.measure(slot * SLOT_NS, np.full(50, min(float(control.delta.sum()), 1.0)))
    assert np.ptp(control.delta) < 1e-5


@given(busy=st.lists(st.floats(0.0, 1.0), max_size=40))
def test_the_duty_cycle_stays_within_its_limits(busy: list[float]) -> None:
    control = AdaptiveDcc()
    for slot, ratio in enumerate(busy):
        control.measure(slot * SLOT_NS, np.array([ratio]))
        assert control.least <= control.delta[0] <= control.most
        assert 25_000_000 <= control.interval_ns(AIRTIME_NS)[0] <= 1_000_000_000


def test_an_adaptive_station_waits_longer_after_a_longer_message() -> None:
    control = AdaptiveDcc()
    interval = [control.interval_ns(np.array([airtime]))[0] for airtime in (600_000, 1_200_000)]
    assert interval[1] == pytest.approx(2 * interval[0], abs=2)
    assert 600_000 / interval[0] == pytest.approx(control.delta[0])


def test_a_wait_changes_with_the_duty_cycle() -> None:
    control = AdaptiveDcc()
    control.note_sent(0, AIRTIME_NS, np.ones(1, bool))
    before = control.interval_ns(AIRTIME_NS)[0]  # 78 ms
    control.measure(40_000_000, np.ones(1))
    left = (before - 40_000_000) / before
    expected = AIRTIME_NS[0] / control.delta[0] * left + 40_000_000
    assert not control.may_send(int(expected) - 1000).any()
    assert control.may_send(int(expected) + 1000).all()


def test_reset_forgets_the_channel_and_the_transmissions() -> None:
    for control in (ReactiveDcc(), AdaptiveDcc()):
        fresh = control.interval_ns(AIRTIME_NS)
        measure(control, 1.0, 10.0)
        control.note_sent(10_000_000_000, AIRTIME_NS, np.ones(1, bool))
        control.reset()
        assert control.interval_ns(AIRTIME_NS).tolist() == fresh.tolist()
        assert control.may_send(0).all()
