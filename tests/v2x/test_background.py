"""Stations in the background load a channel as stations of the scene would."""

import numpy as np
import pytest

from mast_zenoh.streams import stream
from mast_zenoh.v2x import (
    AdaptiveDcc,
    BackgroundStations,
    CongestionControl,
    NoCongestionControl,
    OfdmTiming,
    RadioChannel,
    Transmissions,
)

FRAME_NS = 100_000_000
CENTRE = np.array([1000.0, -500.0])


def begun(congestion: CongestionControl, stations: int = 150) -> BackgroundStations:
    """Stations that begin at time 0."""
    background = BackgroundStations(stations=stations, radius_m=100.0, congestion=congestion)
    background.begin(0, FRAME_NS, CENTRE, stream(1, "background"))
    return background


def frames_of(background: BackgroundStations, frames: int) -> tuple[list[Transmissions], list[float]]:
    """What they send in each frame, and the mean busy ratio of each."""
    sent, busy = [], []
    for time_ns in range(0, frames * FRAME_NS, FRAME_NS):
        sent.append(background.transmit(time_ns, OfdmTiming()))
        ratio = RadioChannel().busy_ratio(background.position, sent[-1], time_ns + FRAME_NS)
        background.measure(time_ns + FRAME_NS, ratio)
        busy.append(float(ratio.mean()))
    return sent, busy


def test_they_stand_around_the_centre() -> None:
    position = begun(NoCongestionControl(), 1000).position
    distance = np.hypot(*(position - CENTRE).T)
    assert distance.max() < 100.0
    assert np.median(distance) == pytest.approx(100.0 / np.sqrt(2.0), abs=5.0), "as many on each square metre"


def test_they_are_switched_on_within_a_second_and_then_send_in_every_frame() -> None:
    sent, busy = frames_of(begun(NoCongestionControl()), 20)
    counts = [len(frame.sender) for frame in sent]
    assert counts == sorted(counts), "one after the other"
    assert counts[0] == 0 < counts[5] < 150 == counts[10] == counts[19]
    assert busy[19] == 1.0, "150 stations, each for 0.712 ms of 100"
    assert set(sent[19].airtime_ns.tolist()) == {712_000}


def test_under_adaptive_control_they_share_a_channel_that_is_nearly_as_busy_as_the_target() -> None:
    control = AdaptiveDcc()
    _, busy = frames_of(begun(control), 300)
    fixed_point = 150 * control.beta * control.target / (control.alpha + 150 * control.beta)
    assert np.mean(busy[100:]) == pytest.approx(fixed_point, abs=0.02)
    assert fixed_point > 0.6


def test_none_are_no_load() -> None:
    background = BackgroundStations(stations=0)
    background.measure(0, np.zeros(0))
    assert len(background.transmit(0, OfdmTiming()).sender) == len(background.position) == 0
