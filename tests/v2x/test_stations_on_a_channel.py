"""Stations that generate messages, control their rate and share a channel: the parts fit together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from mast_zenoh.arrays.states import Floats, ObjectStates
from mast_zenoh.streams import stream
from mast_zenoh.v2x import (
    AdaptiveDcc,
    CongestionControl,
    CpmGeneration,
    EveryFrame,
    GenerationRules,
    NoCongestionControl,
    OfdmTiming,
    Perception,
    RadioChannel,
    ReactiveDcc,
    Transmissions,
    arrivals,
)

FRAME_NS = 100_000_000
STATIONS, OBJECTS = 100, 20


@dataclass
class Outcome:
    """The second half of a simulation.

    busy, peak: mean and greatest busy ratio
    rate: messages per second of a station
    arrived: share of messages that arrive at another station
    """

    busy: float
    peak: float
    rate: float
    arrived: float


def simulated(
    rules: type[GenerationRules],
    control: CongestionControl,
    frames: int,
    speed_mps: float = 15.0,
    staggered: bool = True,
) -> Outcome:
    """Stations within 100 m of each other; each perceives objects that all move on straight lines.

    staggered: whether stations begin within a second, not in one frame
    """
    seed = 1
    rng = stream(seed, "scene")
    position = rng.uniform(0.0, 70.0, (STATIONS, 2))
    start: Floats = rng.uniform(-50.0, 50.0, (STATIONS, OBJECTS, 3))
    heading = rng.uniform(0.0, 2.0 * np.pi, (STATIONS, OBJECTS))
    velocity = speed_mps * np.stack([np.cos(heading), np.sin(heading), np.zeros_like(heading)], axis=2)
    timing, channel = OfdmTiming(), RadioChannel()
    generators = [rules() for _ in range(STATIONS)]
    start_ns = rng.integers(0, 10 * FRAME_NS, STATIONS) if staggered else np.zeros(STATIONS, np.int64)
    control.reset(STATIONS, start_ns, FRAME_NS)
    airtime = timing.airtime_ns(np.full(STATIONS, 683))
    busy, sent, arrived = [], [], []
    for frame in range(frames):
        now = frame * FRAME_NS
        open_gate = control.may_send(now)
        for station in np.flatnonzero(open_gate).tolist():
            states = ObjectStates.of(start[station] + velocity[station] * now / 1e9, velocity=velocity[station])
            generation = generators[station].generate(Perception.of(now, states))
            open_gate[station] = generation.generated
            airtime[station] = timing.airtime_ns(np.array([33 + 32 * len(generation.rows)]))[0]
        senders = np.flatnonzero(open_gate)
        sending = Transmissions(senders, np.full(len(senders), now), airtime[senders])
        control.note_sent(now, airtime, open_gate)
        end = now + FRAME_NS
        measured = channel.busy_ratio(position, sending, end)
        control.measure(end, measured)
        chance = channel.reception(position, sending, end)
        here = arrivals(chance, senders, lambda station, frame=frame: stream(seed, "channel", frame, station))  # type: ignore[misc]
        busy.append(measured.mean())
        sent.append(len(senders))
        arrived.append(here.sum())
    half = frames // 2
    messages = sum(sent[half:])
    rate = messages / STATIONS / (frames - half) * 1e9 / FRAME_NS
    share = sum(arrived[half:]) / (messages * (STATIONS - 1))
    return Outcome(float(np.mean(busy[half:])), float(np.max(busy[half:])), float(rate), float(share))


def test_a_hundred_stations_that_send_everything_saturate_the_channel() -> None:
    outcome = simulated(EveryFrame, NoCongestionControl(), 6, staggered=False)
    assert outcome.busy == 1.0
    assert outcome.rate == pytest.approx(10.0)
    assert outcome.arrived < 0.8


def test_generation_rules_alone_lower_the_load_the_slower_the_traffic() -> None:
    """At 15 m/s, an object moves 4 m in three frames; at 1 m/s it is sent once a second."""
    slow = simulated(CpmGeneration, NoCongestionControl(), 40, speed_mps=1.0)
    fast = simulated(CpmGeneration, NoCongestionControl(), 40, speed_mps=15.0)
    assert slow.busy < 0.2 < fast.busy < 0.6
    assert 0.95 < fast.arrived < slow.arrived


def test_adaptive_control_reaches_the_fair_share_also_where_stations_send_at_frames_only() -> None:
    control = AdaptiveDcc()
    outcome = simulated(EveryFrame, control, 400)
    fixed_point = STATIONS * control.beta * control.target / (control.alpha + STATIONS * control.beta)
    assert outcome.busy == pytest.approx(fixed_point, abs=0.02)


def test_reactive_control_keeps_the_load_low_and_most_messages_arrive() -> None:
    outcome = simulated(EveryFrame, ReactiveDcc(), 200)
    assert 0.2 < outcome.busy < 0.6
    assert outcome.arrived > 0.8


def test_stations_that_start_in_one_frame_collide_although_the_mean_load_is_low() -> None:
    together = simulated(EveryFrame, ReactiveDcc(), 100, staggered=False)
    apart = simulated(EveryFrame, ReactiveDcc(), 100)
    assert together.busy < 0.4
    assert together.arrived < 0.8 < 0.95 < apart.arrived
