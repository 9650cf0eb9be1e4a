"""Which commands a car carries out: the newest; without one it goes on for a while, then it brakes."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mast_zenoh.driving import Actuation, CarLimits, Command

HOLD, BRAKING = 3, 3.0
GAS, TURN = Command(1.0, 0.02), Command(-2.0, -0.01)


def car() -> Actuation:
    return Actuation(CarLimits(), HOLD, BRAKING)


def test_a_command_of_a_frame_acts_in_the_next_one() -> None:
    actuation = car()
    for frame, command in enumerate([GAS, TURN, GAS]):
        assert actuation.receive(frame, frame, command) == ""
        assert actuation.act(frame + 1) == command
    assert dict(actuation.counts) == dict(commanded=3, held=0, braked=0, refused=0)


def test_a_car_without_commands_goes_on_then_brakes_along_its_last_curvature() -> None:
    actuation = car()
    actuation.receive(0, 0, GAS)
    done = [actuation.act(frame) for frame in range(1, 8)]
    assert done == [GAS] * (1 + HOLD) + [Command(-BRAKING, GAS.curvature)] * 3
    assert dict(actuation.counts) == dict(commanded=1, held=HOLD, braked=3, refused=0)


def test_a_late_command_acts_when_it_arrives_if_it_may_still_be_held() -> None:
    actuation = car()
    actuation.receive(0, 0, GAS)
    actuation.receive(2, 4, TURN)
    assert actuation.act(5) == TURN
    assert actuation.act(2 + HOLD + 2) == Command(-BRAKING, TURN.curvature)


@pytest.mark.parametrize(
    ("frame", "command", "reason"),
    [
        (6, GAS, "early: command of"),
        (4, TURN, "old: command of"),
        (3, TURN, "old: command of"),
        (5, Command(-9.1, 0.0), "absurd: acceleration is"),
        (5, Command(4.1, 0.0), "absurd: acceleration is"),
        (5, Command(0.0, 0.3), "absurd: curvature is"),
        (5, Command(math.nan, 0.0), "absurd: acceleration is"),
        (5, Command(0.0, math.inf), "absurd: curvature is"),
    ],
)
def test_a_refused_command_is_counted_and_changes_nothing(frame: int, command: Command, reason: str) -> None:
    actuation = car()
    actuation.receive(4, 4, GAS)
    assert actuation.receive(frame, 5, command).startswith(reason)
    assert actuation.counts["refused"] == 1
    assert actuation.act(6) == GAS
    assert actuation.counts["held"] == 1


events = st.tuples(st.integers(-2, 3), st.floats(allow_nan=True), st.floats(allow_nan=True))


@given(st.lists(st.lists(events, max_size=3), min_size=1, max_size=30))
def test_whatever_arrives_a_car_only_does_what_it_can_and_every_frame_is_counted(frames):
    actuation, limits = car(), CarLimits()
    for frame, arriving in enumerate(frames):
        for late, acceleration, curvature in arriving:
            actuation.receive(frame - late, frame, Command(acceleration, curvature))
        assert limits.refusal(actuation.act(frame + 1)) == ""
    counts = actuation.counts
    assert counts["commanded"] + counts["held"] + counts["braked"] == len(frames)
    assert counts["refused"] <= sum(map(len, frames))
