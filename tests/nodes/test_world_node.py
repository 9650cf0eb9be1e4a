"""The world obeys the commands that it gets, and publishes in every frame what the simulator does, and routes."""

from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from driven import driven
from tiny_world import Bench

from mast_zenoh.config.resolved import Resolved

COMMAND = "agent/ego/command"
TAKEN_OVER = 4


@cache
def resolved() -> Resolved:
    return driven(frames=16)


@pytest.fixture
def world() -> Bench:
    return Bench(resolved(), "simulator")


def advance(bench: Bench) -> dict:
    assert bench.node.advance(bench.host)
    return dict(bench._collect())


def command(acceleration: float, curvature: float = 0.0) -> dict[str, np.ndarray]:
    return {"acceleration": np.array([acceleration]), "curvature": np.array([curvature])}


def speeds(bench: Bench, frames: int, acceleration: float | None) -> list[float]:
    """The ego's speed by frame; with a command in every frame, or none."""
    found = []
    for frame in range(frames):
        velocity = advance(bench)["agent/ego/pose"].body["velocity"]
        found.append(float(np.hypot(*velocity[:2])))
        if acceleration is not None:
            bench.send("command", command(acceleration), frame)
    return found


def test_a_frame_is_a_clock_a_route_the_truth_and_what_every_agent_senses(world: Bench) -> None:
    for frame in range(3):
        published = advance(world)
        assert next(iter(published)) == "clock"
        assert set(published) == {
            *("clock", "scene/truth", "driver/driver_ego/route"),
            *(f"agent/{agent}/{what}" for agent in ("ego", "infra_1") for what in ("pose", "detections")),
        }
        assert {message.header.frame for message in published.values()} == {frame}
        assert {message.header.time_ns for message in published.values()} == {frame * 100_000_000}


def test_before_the_driver_takes_over_it_is_the_prepared_scene(world: Bench) -> None:
    recording = resolved().recording
    assert recording is not None
    for frame in range(TAKEN_OVER + 1):
        published = advance(world)
        truth = published["scene/truth"].body
        assert np.array_equal(truth["position"], recording.truth_at(frame).position)
        assert np.array_equal(truth["points"], recording.points_at(frame))
        for row, agent in enumerate(recording.agent_names):
            sensed = published[f"agent/{agent}/detections"].body
            for name, column in recording.detections_at(frame, row).columns().items():
                assert np.array_equal(sensed[name], column), (frame, agent, name)
        world.send("command", command(-9.0), frame)


def test_a_command_of_a_frame_acts_in_the_next_one(world: Bench) -> None:
    found = speeds(world, 12, acceleration=2.0)
    for before, after in pairwise(found[TAKEN_OVER:]):
        assert after == pytest.approx(before + 0.2, abs=1e-9)
    assert world.node.finish(world.host)["commands"]["ego"]["commanded"] == 12 - 1 - TAKEN_OVER


def test_without_commands_the_car_brakes_and_it_is_told_once(world: Bench, caplog: pytest.LogCaptureFixture) -> None:
    found = speeds(world, 12, acceleration=None)
    for before, after in pairwise(found[TAKEN_OVER:]):
        assert after == pytest.approx(max(before - 0.3, 0.0), abs=1e-9)
    assert world.node.finish(world.host)["commands"]["ego"]["braked"] == 12 - 1 - TAKEN_OVER
    assert len([record for record in caplog.records if "no new command" in record.getMessage()]) == 1


def test_commands_that_no_driver_can_mean_are_rejected_and_the_car_goes_on(world: Bench) -> None:
    invalid = [command(-20.0), command(0.0, curvature=5.0), command(np.nan), command(np.inf)]
    found = []
    for frame in range(9):
        found.append(float(np.hypot(*advance(world)["agent/ego/pose"].body["velocity"][:2])))
        for body in invalid if frame >= 6 else [command(1.0)]:
            world.send("command", body, frame)
    for before, after in pairwise(found[TAKEN_OVER:]):
        assert after == pytest.approx(before + 0.1, abs=1e-9), "held"
    rejected = dict(world.host.rejected)
    assert {key for key, _ in rejected} == {COMMAND}
    assert sum(rejected.values()) == 3 * len(invalid)
    assert rejected[COMMAND, "absurd"] == 3 * 2


def test_it_ends_with_its_frames(world: Bench) -> None:
    speeds(world, 16, acceleration=None)
    assert not world.node.advance(world.host)
