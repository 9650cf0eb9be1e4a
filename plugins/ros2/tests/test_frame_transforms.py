"""Frames of reference that are told of from outside are placed in the world, within limits."""

import numpy as np
import pytest
from mast_ros2 import received_poses
from mast_ros2.received_poses import FrameTransforms, Placement, between
from scipy.spatial.transform import Rotation, Slerp

from mast_zenoh.errors import MessageError

S = 10**9


def at(x: float, yaw: float = 0.0) -> Placement:
    return Placement(np.array([x, 0.0, 0.0]), np.array([np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)]))


def rotation_of(placement: Placement) -> Rotation:
    w, *xyz = placement.rotation
    return Rotation.from_quat([*xyz, w])


def test_the_world_is_where_it_is_and_a_chain_of_frames_is_composed() -> None:
    frames = FrameTransforms("map")
    frames.add("map", "base", 0, at(10.0, np.pi / 2), static=True)
    frames.add("base", "lidar", 5, at(2.0), static=True)
    world = frames.place("map", 7, 7)
    assert (world.position.tolist(), world.rotation.tolist()) == ([0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0])
    lidar = frames.place("lidar", 9 * S, 9 * S)
    np.testing.assert_allclose(lidar.position, [10.0, 2.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(rotation_of(lidar).as_euler("zyx"), [np.pi / 2, 0.0, 0.0], atol=1e-12)


def test_a_moving_frame_is_interpolated_at_the_stamp_in_any_order_of_arrival() -> None:
    for order in ([0, 1, 2], [2, 0, 1]):
        frames = FrameTransforms("map")
        for second in order:
            frames.add("map", "car", second * S, at(10.0 * second, 0.4 * second), static=False)
        place = frames.place("car", 3 * S // 4, 0)
        np.testing.assert_allclose(place.position, [7.5, 0.0, 0.0])
        np.testing.assert_allclose(rotation_of(place).as_euler("zyx")[0], 0.3)
        assert frames.place("car", 2 * S, 0).position.tolist() == [20.0, 0.0, 0.0]


def test_rotations_between_two_are_on_the_shortest_arc() -> None:
    random = np.random.default_rng(3)
    for _ in range(50):
        one, other = (Placement(np.zeros(3), rotation) for rotation in random.normal(size=(2, 4)))
        expected = Slerp([0.0, 1.0], Rotation.concatenate([rotation_of(one), rotation_of(other)]))(0.3)
        assert (rotation_of(between(one, other, 0.3)) * expected.inv()).magnitude() < 1e-7


def test_a_transform_is_used_half_a_second_beyond_the_newest_and_no_longer() -> None:
    frames = FrameTransforms("map")
    frames.add("map", "car", 10 * S, at(1.0), static=False)
    for stamp_ns in (9_500_000_000, 10_500_000_000):
        assert frames.place("car", stamp_ns, 0).position[0] == 1.0
    for stamp_ns in (9_499_999_999, 10_500_000_001):
        with pytest.raises(MessageError, match=r"no transform: none within 0.5 s"):
            frames.place("car", stamp_ns, 0)


def test_between_transforms_that_are_far_apart_only_the_nearest_is_used() -> None:
    frames = FrameTransforms("map")
    for second in (10, 11, 50):
        frames.add("map", "car", second * S, at(float(second)), static=False)
    for stamp_s, expected in ((10.25, 10.25), (11.0, 11.0), (11.5, 11.0), (49.5, 50.0)):
        assert frames.place("car", round(stamp_s * S), 0).position[0] == expected
    for stamp_s in (11.6, 30.0, 49.4):
        with pytest.raises(MessageError, match=r"no transform: none within 0.5 s"):
            frames.place("car", round(stamp_s * S), 0)


def test_transforms_of_another_clock_do_not_displace_those_that_come_later() -> None:
    frames = FrameTransforms("map")
    for number in range(2 * received_poses.KEPT):
        frames.add("map", "car", 1_700_000_000 * S + number, at(99.0), static=False)
    frames.add("map", "car", 7 * S, at(1.0), static=False)
    assert frames.place("car", 7 * S, 0).position[0] == 1.0


def test_the_frame_of_an_agent_is_placed_by_the_run_alone() -> None:
    frames = FrameTransforms("map", ["ego"])
    with pytest.raises(MessageError, match="no transform: none yet"):
        frames.place("ego", 0, 0)
    frames.place_own("ego", 0, at(1.0))
    frames.place_own("ego", S, at(3.0))
    for child in ("ego", "map"):
        with pytest.raises(MessageError, match="own frame"):
            frames.add("base", child, 0, at(9.0), static=True)
    frames.add("ego", "lidar", 0, at(0.5), static=True)
    assert frames.place("lidar", 99 * S, S // 2).position[0] == 2.5, "by the scene's time, not by the stamp"


def test_unknown_frames_and_loops_are_refused() -> None:
    frames = FrameTransforms("map")
    with pytest.raises(MessageError, match="unknown frame: found 'odom', expected 'map'"):
        frames.place("odom", 0, 0)
    frames.add("a", "b", 0, at(1.0), static=True)
    frames.add("b", "a", 0, at(1.0), static=True)
    with pytest.raises(MessageError, match="loop of frames"):
        frames.place("a", 0, 0)


def test_memory_is_limited_and_a_frame_can_get_another_parent() -> None:
    frames = FrameTransforms("map")
    for number in range(received_poses.MOST_FRAMES):
        frames.add("map", f"frame_{number}", 0, at(1.0), static=True)
    with pytest.raises(MessageError, match="too many frames"):
        frames.add("map", "one_more", 0, at(1.0), static=True)
    for number in range(10 * received_poses.KEPT):
        frames.add("map", "frame_0", number, at(float(number)), static=False)
    assert len(frames._frames["frame_0"]._times) == received_poses.KEPT
    frames.add("frame_1", "frame_0", 0, at(2.0), static=False)
    assert frames.place("frame_0", 0, 0).position[0] == 3.0
