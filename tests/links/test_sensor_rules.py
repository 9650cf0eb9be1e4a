"""Rules for detections: blind sectors, and ghosts with the detector's noise."""

from typing import Any

import numpy as np
import pytest
from link_bench import build, chain, sensed

from mast_zenoh.arrays.geometry import quaternion_from_rotation, rotation_from_yaw
from mast_zenoh.arrays.states import Detections
from mast_zenoh.errors import ConfigurationError
from mast_zenoh.links import Passage, SenderPose, Sensed
from mast_zenoh.sensing import sensor_pose, to_world

GHOST = dict(type="GhostDetections", places=[[20.0, 5.0, 0.75]], probability=1.0)
BLIND = dict(type="BlindSector", azimuth_min_deg=-10.0, azimuth_max_deg=10.0)
EXACT = dict(position_noise_m=0.0, vertical_noise_m=0.0, size_noise_m=0.0, yaw_noise_deg=0.0)


def passed(rule: dict[str, Any], message: Sensed, time_s: float = 0.0) -> Detections:
    """The detections after a rule."""
    time_ns = round(time_s * 1e9)
    ((passage, _),) = chain([rule]).carry(Passage(time_ns, time_ns, sensed=message)).leaving
    assert passage.sensed is not None
    return passage.sensed.detections


def in_world(detections: Detections, message: Sensed, time_s: float = 0.0) -> Detections:
    """Detections in the world, with the true pose of their agent."""
    assert message.pose is not None
    agent = message.pose.at(round(time_s * 1e9))
    return to_world(detections, *sensor_pose(*agent, message.mount_position, message.mount_rotation))


@pytest.mark.parametrize(
    ("sector", "kept"),
    [((-45, 45), [1, 2, 3]), ((45, 135), [0, 2, 3]), ((135, 225), [0, 1, 3]), ((-225, 46), [1]), ((-180, 180), [])],
)
def test_a_blind_sector_loses_the_detections_in_it(sector: tuple[float, float], kept: list[int]) -> None:
    """Cars ahead, to the left, behind and to the right."""
    message = sensed((10.0, 0.0), (0.0, 10.0), (-10.0, 0.0), (0.0, -10.0))
    rule = dict(type="BlindSector", azimuth_min_deg=sector[0], azimuth_max_deg=sector[1])
    assert np.array_equal(passed(rule, message).position, message.detections.position[kept])


def test_a_ghost_in_the_world_stays_while_its_sensor_moves_and_turns() -> None:
    for x, turn in ((0.0, 0.0), (10.0, 0.5), (-30.0, 3.0)):
        message = sensed(x=x, turn=turn)
        ghost = in_world(passed(GHOST | EXACT, message), message)
        assert ghost.position == pytest.approx(np.array([[20.0, 5.0, 0.75]]))
        assert ghost.yaw == pytest.approx([0.0], abs=1e-12)


def test_a_ghost_in_the_world_stays_for_a_driving_agent_whose_last_known_pose_is_old() -> None:
    message = sensed(mobile=True)
    ghost = in_world(passed(GHOST | EXACT, message, 0.1), message, 0.1)
    assert ghost.position == pytest.approx(np.array([[20.0, 5.0, 0.75]]))


def test_a_ghost_at_the_sensor_moves_with_it_and_stays_on_the_ground() -> None:
    for x, turn in ((0.0, 0.0), (10.0, np.pi / 2)):
        message = sensed(x=x, turn=turn)
        ghost = passed(GHOST | EXACT | dict(frame="sensor"), message)
        assert ghost.position == pytest.approx(np.array([[20.0, 5.0, 0.75 - 2.0]]))
        assert ghost.yaw == pytest.approx([0.0], abs=1e-12)


def test_real_detections_are_kept_before_the_ghosts() -> None:
    message = sensed((10.0, 0.0), (0.0, 10.0))
    after = passed(GHOST | dict(kind="pedestrian", size=[0.6, 0.6, 1.7]), message)
    assert len(after) == 3
    assert np.array_equal(after.position[:2], message.detections.position)
    assert after.class_id[2] != message.detections.class_id[0]


def test_ghosts_have_independent_errors_of_the_stated_size_in_every_frame() -> None:
    """At 20.7 m, errors are sqrt(1 + 0.12 + 0.4) times those at the sensor."""
    places = [[20.0, 5.0, 0.75], [20.0, -5.0, 0.75]]
    link, message = chain([GHOST | dict(places=places, probability=0.8)]), sensed()
    errors, counts = [], []
    for frame in range(2000):
        outcome = link.carry(Passage(frame, frame, sensed=message))
        detections = outcome.leaving[0][0].sensed.detections
        counts.append(len(detections))
        if len(detections) == 2:
            errors.append(in_world(detections, message).position - places)
    measured = np.array(errors)
    growth = np.sqrt(1.0 + (20.7 / 60.0) ** 2 + 0.4)
    assert measured.mean(axis=0) == pytest.approx(np.zeros((2, 3)), abs=0.05)
    assert measured.std(axis=0) == pytest.approx(np.tile([0.28, 0.28, 0.1], (2, 1)) * growth, rel=0.08)
    assert abs(np.corrcoef(measured[:, 0, 0], measured[:, 1, 0])[0, 1]) < 0.1
    assert abs(np.corrcoef(measured[:-1, 0, 0], measured[1:, 0, 0])[0, 1]) < 0.1
    assert np.mean(counts) == pytest.approx(1.6, abs=0.05)


def test_a_rule_without_anything_to_do_leaves_the_message_as_it_is() -> None:
    message = sensed((0.0, 10.0))
    unknown = message._replace(pose=None)
    for rule, carried in ((BLIND, message), (GHOST | dict(probability=0.0), message), (GHOST, None), (GHOST, unknown)):
        outcome = chain([rule]).carry(Passage(0, 0, sensed=carried))
        assert outcome.fates == {}
        assert outcome.leaving[0][0].sensed is carried


def test_the_rate_of_turning_is_taken_from_two_poses() -> None:
    def at(time_ns: int, yaw: float, before: SenderPose | None) -> SenderPose:
        still = np.zeros(3)
        return SenderPose.after(before, time_ns, still, quaternion_from_rotation(rotation_from_yaw(yaw)), still)

    first = at(0, 3.1, None)
    second = at(100_000_000, -3.1, first)
    assert first.turn_rate == 0.0
    assert second.turn_rate == pytest.approx((2 * np.pi - 6.2) / 0.1)
    assert second.at(200_000_000)[1] == pytest.approx(rotation_from_yaw(2 * np.pi - 6.2 - 3.1))


@pytest.mark.parametrize(
    ("rule", "parameters", "reason"),
    [
        (BLIND, dict(azimuth_min_deg=10.0), r"azimuth_max_deg.*10.0.*up"),
        (BLIND, dict(azimuth_min_deg=-200.0, azimuth_max_deg=200.0), "azimuth_max_deg: found 200.0"),
        (BLIND, dict(azimuth_min_deg=-400.0, azimuth_max_deg=0.0), "azimuth_min_deg: found -400.0"),
        (GHOST, dict(places=[]), r"1.*100 places"),
        (GHOST, dict(places=[[1.0, 2.0]]), r"2 values.*3"),
        (GHOST, dict(frame="body"), "frame: found 'body'"),
        (GHOST, dict(kind="cra"), "mean 'car'"),
        (GHOST, dict(size=[1.0, 0.0, 1.0]), "three lengths"),
        (GHOST, dict(probability=1.5), "probability: found 1.5"),
        (GHOST, dict(position_noise_m=-1.0), "noise: found"),
        (GHOST, dict(score=[0.9, 0.1]), "low and high"),
    ],
)
def test_impossible_sectors_and_ghosts_are_refused(rule: dict[str, Any], parameters: Any, reason: str) -> None:
    with pytest.raises(ConfigurationError, match=reason):
        build(**rule | parameters)
