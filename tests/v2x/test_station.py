"""A station sends what its rules say, as often as the channel allows."""

import numpy as np
from perceptions import FRAME_NS, objects, sent_ids

from mast_zenoh.v2x import AdaptiveDcc, CamGeneration, CpmGeneration, FrequencyRedundancy, Vehicle
from mast_zenoh.v2x.station import Station

HERE = np.zeros(3)


def frames_with_message(station: Station, busy: float, frames: int = 60) -> list[int]:
    """The frames in which it sends, on a channel that is equally busy all the time."""
    sent, airtime_ns = [], 0
    for frame in range(frames):
        station.measure(frame * FRAME_NS, busy, (frame - 1) * FRAME_NS, airtime_ns)
        generation = station.transmit(frame * FRAME_NS, objects(1, x=5.0 * frame), HERE)
        airtime_ns = 1_200_000 if generation.generated else 0
        sent += [frame] * generation.generated
    return sent


def test_without_rules_and_control_everything_is_sent_in_every_frame() -> None:
    assert frames_with_message(Station(), busy=1.0) == list(range(60))


def test_on_a_busy_channel_it_sends_less() -> None:
    quiet, busy = (frames_with_message(Station(congestion=AdaptiveDcc()), load) for load in (0.1, 0.95))
    assert len(busy) < 0.8 * len(quiet)


def test_stations_that_are_switched_on_at_different_times_send_in_different_frames() -> None:
    first = []
    for share in (0.05, 0.45, 0.85):
        station = Station(congestion=AdaptiveDcc())
        station.switch_on(share)
        first.append(frames_with_message(station, busy=0.5)[0])
    assert first == sorted(set(first))


def test_what_others_report_often_is_left_out_until_they_fall_silent() -> None:
    station = Station(CpmGeneration(redundancy=(FrequencyRedundancy(reports=2),)))
    own = objects(1, 2)
    assert sent_ids(station.transmit(0, own, HERE), own) == [1, 2]
    for frame in range(1, 4):
        station.hear(frame * FRAME_NS, objects(1, x=5.0), HERE)
    moved = objects(1, 2, x=5.0)
    assert sent_ids(station.transmit(4 * FRAME_NS, moved, HERE), moved) == [2], "1 was reported three times"
    later = objects(1, 2, x=10.0)
    assert sent_ids(station.transmit(20 * FRAME_NS, later, HERE), later) == [1, 2]


def test_a_flood_of_reports_does_not_fill_the_memory() -> None:
    station = Station(CpmGeneration(redundancy=(FrequencyRedundancy(),)))
    many = objects(*range(5000))
    for frame in range(40):
        station.hear(frame * FRAME_NS, many, HERE)
    assert sum(map(len, station._reports)) <= 20_000


def test_a_station_says_where_it_is_when_that_is_due_and_the_channel_allows_it() -> None:
    def announced(station: Station, busy: float) -> list[int]:
        frames = []
        for frame in range(60):
            station.measure(frame * FRAME_NS, busy, (frame - 1) * FRAME_NS, 400_000 * (frames[-1:] == [frame - 1]))
            itself = Vehicle().state(np.array([2.5 * frame, 0.0, 0.0]), np.array([25.0, 0.0, 0.0]), 0.0)
            frames += [frame] * station.announce(frame * FRAME_NS, itself)
        return frames

    assert announced(Station(), 0.0) == []
    assert announced(Station(awareness=CamGeneration()), 0.0) == list(range(0, 60, 2)), "5 m, of which 4 are due"
    control = AdaptiveDcc(least=0.0005, most=0.001)
    limited = announced(Station(awareness=CamGeneration(), congestion=control), 0.95)
    assert 5 < len(limited) < 20
