"""The driver that simulates proposals: its constants, what it rules out, and how it drives."""

import numpy as np
import pytest
from roads import LENGTH, WIDTH, cars, situation, straight

from mast_zenoh.driving import CarLimits, Command, ProposalDriver, proposals
from mast_zenoh.driving.motion import drive

DRIVER = ProposalDriver()


def simulated(at) -> proposals.Trajectories:
    lane = DRIVER._lane(at)
    return DRIVER._simulate(at, lane, proposals._forecast(at, lane))


def driven(speed: float, objects: list[tuple[float, float, float]], seconds: float, line: float = np.inf):
    """Position (2,) m, speed, hardest braking and nearest gap m of a car after a while on a straight lane."""
    along, offset, turn = 0.0, np.zeros(1), np.zeros(1)
    hardest, nearest = 0.0, np.inf
    for step in range(round(seconds / 0.1)):
        now = [(x + vx * 0.1 * step, y, vx) for x, y, vx in objects]
        at = situation(along, speed, cars(*now), straight(along, 12.0, line - along - LENGTH / 2.0), offset[0], turn[0])
        command = DRIVER.drive(at)
        assert CarLimits().refusal(command) == ""
        hardest = min(hardest, command.acceleration)
        new = max(speed + command.acceleration * 0.1, 0.0)
        motion = drive(offset, turn, np.array([(speed + new) / 2 * 0.1]), np.array([command.curvature]), np.zeros(1))
        along, offset, turn, speed = along + float(motion.along[0]), motion.offset, motion.turn, new
        for x, y, _ in now:
            if abs(y - offset[0]) < WIDTH:
                nearest = min(nearest, abs(x - along) - LENGTH)
    return np.array([along, offset[0]]), speed, hardest, nearest


def test_the_simulation_is_that_of_the_bicycle_model() -> None:
    at = situation(0.0, 8.0, cars(), straight(0.0, 12.0), 0.4, 0.05)
    found = simulated(at)
    for row in (0, 4, 14):
        along, offset, turn = 0.0, np.array([0.4]), np.array([0.05])
        for step in range(40):
            way = 0.05 * (found.speed[row, step] + found.speed[row, step + 1])
            motion = drive(offset, turn, np.array([way]), found.curvature[row, step, None], np.zeros(1))
            along, offset, turn = along + motion.along[0], motion.offset, motion.turn
        assert found.position[row, -1] == pytest.approx([along, offset[0]], abs=0.02)
        assert found.heading[row, -1] == pytest.approx(turn[0], abs=0.005)


def test_proposals_end_beside_the_middle_of_the_lane_and_at_their_speeds_also_in_a_bend() -> None:
    angles = np.arange(81.0) / 40.0
    route = straight(0.0, 8.0)
    route.position[:] = 40.0 * np.column_stack([np.sin(angles), 1.0 - np.cos(angles)])
    found = simulated(situation(0.0, 6.0, cars(), route))
    assert found.offset[:, -1] == pytest.approx(DRIVER.offset, abs=0.35)
    assert (np.diff(found.speed[::3, -1]) < 0.0).all(), "the slower proposals are slower"
    assert np.hypot(found.position[..., 0], found.position[..., 1] - 40.0) == pytest.approx(
        40.0 - found.offset, abs=0.1
    )


def test_on_a_free_lane_it_stays_in_the_middle_and_speeds_up() -> None:
    (_, across), speed, hardest, _ = driven(9.0, [], 6.0)
    assert across == 0.0
    assert speed == pytest.approx(12.0, abs=0.5)
    assert hardest >= 0.0


def test_it_stops_behind_a_standing_car_and_before_a_line() -> None:
    (along, _), speed, hardest, nearest = driven(7.0, [(24.0, 0.0, 0.0)], 10.0)
    assert speed < 0.1
    assert 0.5 < nearest < 2.0
    assert hardest > -4.05
    (along, _), speed, _, _ = driven(7.0, [], 8.0, line=20.0)
    assert speed < 0.1
    assert 0.3 < 20.0 - LENGTH / 2.0 - along < 1.5


def test_it_drives_past_what_reaches_a_little_into_its_lane() -> None:
    (along, across), _, hardest, nearest = driven(8.0, [(40.0, 2.0, 0.0)], 4.0)
    assert nearest > 0.0, "it has not touched it"
    assert hardest > -4.05
    assert along > 20.0
    assert across < -0.2


def test_it_brakes_as_hard_as_it_can_when_slow_and_about_to_hit_something() -> None:
    at = situation(0.0, 4.0, cars((6.0, 0.0, -4.0)), straight(0.0, 12.0))
    assert DRIVER.drive(at).acceleration == -CarLimits().braking


def test_what_comes_from_behind_or_meets_a_standing_car_is_not_its_fault() -> None:
    behind = situation(0.0, 6.0, cars((-8.0, 0.0, 12.0)), straight(0.0, 12.0))
    assert DRIVER.drive(behind).acceleration > 0.0
    standing = situation(0.0, 0.0, cars((5.2, 0.0, -4.0)), straight(0.0, 12.0))
    found = proposals._first_collision(
        standing, simulated(standing), proposals._forecast(standing, DRIVER._lane(standing))
    )
    assert (found > 1.0).all(), "the first contact is after 0.2 s"


def test_a_car_that_crosses_later_makes_it_slower_and_one_that_has_left_does_not() -> None:
    free = DRIVER.drive(situation(0.0, 8.0, cars(), straight(0.0, 12.0))).acceleration

    def crossing(y: float) -> float:
        other = cars((18.0, y, 0.0)).with_(velocity=np.array([[0.0, 5.0, 0.0]]), yaw=np.array([np.pi / 2.0]))
        return DRIVER.drive(situation(0.0, 8.0, other, straight(0.0, 12.0))).acceleration

    assert crossing(-10.0) < free - 1.0
    assert crossing(5.0) == free


def test_what_it_may_not_drive_on_is_left_to_others() -> None:
    narrow = ProposalDriver(drivable_m=WIDTH / 2.0 + 0.2)
    at = situation(0.0, 8.0, cars((28.0, 1.6, 0.0)), straight(0.0, 12.0))
    assert DRIVER.drive(at).curvature < 0.0
    assert narrow.drive(at).curvature == 0.0


def test_the_nearest_of_too_many_objects_count() -> None:
    crowd = [(70.0, 5.0 + 0.01 * k, 0.0) for k in range(2 * proposals.MAX_OBJECTS)]
    alone = DRIVER.drive(situation(0.0, 8.0, cars((20.0, 0.0, 0.0)), straight(0.0, 12.0)))
    assert DRIVER.drive(situation(0.0, 8.0, cars(*crowd, (20.0, 0.0, 0.0)), straight(0.0, 12.0))) == alone
    assert alone != Command(0.0, 0.0)
