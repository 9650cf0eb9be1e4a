"""Schedules are checked when they are made, and against the world that they disturb."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mast_zenoh import testing
from mast_zenoh.errors import ConfigurationError
from mast_zenoh.testing.simulation import Disturbance, Schedule, World, play, random_schedule, small_worlds


@pytest.mark.parametrize(
    ("disturbance", "message"),
    [
        (Disturbance(0.1, "kil", "a"), r"disturbances\[0\]: unknown kind 'kil'; did you mean 'kill'\?"),
        (Disturbance(-0.1, "kill", "a"), r"disturbances\[0\]: found -0.1 s .*expected finite times"),
        (Disturbance(0.1, "suspend", "a", math.nan), r"disturbances\[0\]: .*nan s, expected finite times"),
        (Disturbance(0.1, "kill", "aa"), r"disturbances\[0\]: kill: unknown node 'aa'; did you mean 'a'\?"),
        (Disturbance(0.1, "kill"), r"disturbances\[0\]: kill: unknown node ''; known: a, b, hub"),
        (Disturbance(0.1, "intercept", "a"), r"disturbances\[0\]: intercept: unknown node 'a'; known: relay"),
        (Disturbance(0.1, "interrupt", "a"), r"disturbances\[0\]: interrupt: found the node 'a', expected none"),
    ],
)
def test_a_schedule_that_cannot_be_played_is_refused(
    worlds: dict[str, World], disturbance: Disturbance, message: str
) -> None:
    with pytest.raises(ConfigurationError, match=message):
        play(worlds["lockstep"], Schedule(0, (disturbance,)))


def test_an_impossible_share_of_losses_is_refused() -> None:
    with pytest.raises(ConfigurationError, match=r"loss: found 2\.0, expected 0 to 0\.5"):
        Schedule(0, loss=2.0)


@pytest.mark.parametrize("number", ["many", -1, 0.5])
def test_an_impossible_number_of_schedules_is_refused(number: object) -> None:
    with pytest.raises(ConfigurationError, match="schedules: found"):
        testing.check_scenario("baseline", frames=2, schedules=number)  # type: ignore[arg-type]


@given(seed=st.integers(), name=st.sampled_from(["lockstep", "realtime"]))
def test_a_random_schedule_fits_its_world_and_its_text_is_python(seed: int, name: str) -> None:
    world = small_worlds()[name]
    schedule = random_schedule(seed, world)
    schedule.check(world)
    assert eval(repr(schedule), {"Schedule": Schedule, "Disturbance": Disturbance}) == schedule


def test_processes_that_stop_for_longer_than_the_driver_waits_may_stall_a_run() -> None:
    short, long = (Schedule(0, (Disturbance(0.1, "suspend", "a", lasts_s),)) for lasts_s in (8.0, 40.0))
    assert (short.harmless, long.harmless) == (True, False)
