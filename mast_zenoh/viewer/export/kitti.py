"""KITTI tracking: labels, calibration, positions and results, for the main agent's camera.

Geiger, Lenz, Urtasun: Are we ready for autonomous driving? The KITTI vision benchmark suite, CVPR 2012.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TextIO

import numpy as np

from mast_zenoh.arrays.geometry import box_corners, to_local, to_world, wrap_angle
from mast_zenoh.arrays.states import Floats, Ints, ObjectStates
from mast_zenoh.metrics.record import Series
from mast_zenoh.scenes.recording import SEEN_RETURNS
from mast_zenoh.sensing import Camera, LidarSensor
from mast_zenoh.viewer.export.columns import AXES, cameras, class_names, stem
from mast_zenoh.viewer.frame import Frame, Pose
from mast_zenoh.viewer.recorded import RecordedRun
from mast_zenoh.viewer.routes import TRUTH

SEQUENCE = "0000"
_TYPES = {"car": "Car", "truck": "Truck", "bicycle": "Cyclist", "pedestrian": "Pedestrian"}
_EARTH_RADIUS_M = 6378137.0
_NEAR_M = 0.1
_NOT_IN_IMAGE = (-1.0, -1.0, -1.0, -1.0)
#: Occlusion of a label: visible, largely occluded.
_VISIBLE, _OCCLUDED = 0, 2


def write(run: RecordedRun, path: Path) -> None:
    """Write label_02, calib and oxts of one sequence, and trackers/ESTIMATE/data with a line for each track.

    A frame without a pose of the main agent has no labels.
    """
    for name in ("label_02", "calib", "oxts"):
        (path / name).mkdir(parents=True)
    files = {series: path / "trackers" / stem(series) / "data" / f"{SEQUENCE}.txt" for series in run.topics}
    files[TRUTH] = path / "label_02" / f"{SEQUENCE}.txt"
    for file in files.values():
        file.parent.mkdir(parents=True, exist_ok=True)
    main = run.main_agent
    camera = cameras(run)[main]
    (path / "calib" / f"{SEQUENCE}.txt").write_text(_calibration(camera, _lidar(run)), encoding="ascii")
    poses: dict[int, Pose] = {}
    without_pose = 0
    with ExitStack() as stack:
        opened = {series: stack.enter_context(file.open("w", encoding="ascii")) for series, file in files.items()}
        for frame in run:
            if run.main_agent not in frame.poses:
                without_pose += 1
                continue
            poses[frame.index] = frame.poses[run.main_agent]
            for series, states in frame.objects.items():
                _write_objects(opened[series], run, frame, series, states, camera)
    if without_pose:
        run.note(f"messages.mcap: frames without a pose of {main}, and therefore without labels: {without_pose}")
    (path / "oxts" / f"{SEQUENCE}.txt").write_text("".join(_positions(poses)), encoding="ascii")
    last = max(poses, default=-1)
    (path / "evaluate_tracking.seqmap.training").write_text(f"{SEQUENCE} empty 000000 {last + 1:06d}\n", "ascii")


def _lidar(run: RecordedRun) -> LidarSensor:
    """The lidar of the main agent; the default one if the scene is not known."""
    known = {agent.name: agent.sensor for agent in run.recording.agents} if run.recording is not None else {}
    return known.get(run.main_agent, LidarSensor())


def _calibration(camera: Camera, lidar: LidarSensor) -> str:
    """The lines of a calibration file; the IMU is at the agent's origin."""
    projection = [camera.focal, 0, camera.width / 2, 0, 0, camera.focal, camera.height / 2, 0, 0, 0, 1, 0]
    to_camera = AXES @ camera.mount_rotation.T
    lidar_to_camera = np.column_stack(
        [to_camera @ lidar.mount_rotation, to_camera @ (lidar.mount_position - camera.mount_position)]
    )
    agent_to_lidar = np.column_stack([lidar.mount_rotation.T, -lidar.mount_rotation.T @ lidar.mount_position])
    rows: dict[str, Iterable[float]] = {f"P{number}:": projection for number in range(4)}
    rows |= {"R_rect": np.eye(3).ravel(), "Tr_velo_cam": lidar_to_camera.ravel(), "Tr_imu_velo": agent_to_lidar.ravel()}
    return "".join(f"{name} {' '.join(f'{value:.12e}' for value in values)}\n" for name, values in rows.items())


def _positions(poses: dict[int, Pose]) -> Iterator[str]:
    """A line for each frame up to the last: latitude, longitude, altitude, roll, pitch, yaw, and zeros.

    The world's origin is at latitude and longitude 0, in the Mercator projection of KITTI's development kit. A frame
    without a pose repeats the one before.
    """
    pose = next(iter(poses.values())) if poses else None
    for index in range(max(poses, default=-1) + 1):
        pose = poses.get(index, pose)
        assert pose is not None
        x, y, z = pose.position / np.array([_EARTH_RADIUS_M, _EARTH_RADIUS_M, 1.0])
        latitude, longitude = np.degrees(2.0 * np.arctan(np.exp(y)) - np.pi / 2), np.degrees(x)
        r = pose.rotation
        angles = np.arctan2(r[2, 1], r[2, 2]), np.arcsin(-r[2, 0].clip(-1.0, 1.0)), np.arctan2(r[1, 0], r[0, 0])
        values = (latitude, longitude, z, *angles)
        yield " ".join([*(f"{value:.15g}" for value in values), *["0"] * 24]) + "\n"


def _write_objects(
    file: TextIO, run: RecordedRun, frame: Frame, series: Series, states: ObjectStates, camera: Camera
) -> None:
    """Write the objects of a series; the main agent's own object is not labelled, as in the benchmark."""
    occluded = np.full(len(states), -1)
    if series == TRUTH:
        seen = frame.points[:, run.agents.index(run.main_agent)] >= SEEN_RETURNS
        kept = states.id != frame.own.get(run.main_agent, -1)
        states, occluded = states.select(kept), np.where(seen, _VISIBLE, _OCCLUDED)[kept]
    for words in _labels(frame, states, frame.poses[run.main_agent], camera, occluded):
        file.write(" ".join(words[:-1] if series == TRUTH else words) + "\n")


def _labels(frame: Frame, states: ObjectStates, pose: Pose, camera: Camera, occluded: Ints) -> Iterator[list[str]]:
    """The words of the line of each object, the last one its score."""
    position, turn = _in_camera(states, pose, camera)
    bottom = position + np.stack([0 * turn, states.size[:, 2] / 2, 0 * turn], axis=1)
    alpha = wrap_angle(turn - np.arctan2(bottom[:, 0], bottom[:, 2]))
    rectangles = _rectangles(states, pose, camera)
    for k, kind in enumerate(class_names(states)):
        length, width, height = states.size[k]
        numbers = (alpha[k], *rectangles[k], height, width, length, *bottom[k], turn[k], states.score[k])
        truncated = min(int(occluded[k]), 0)  # -1: not known, as the occlusion
        words = [str(frame.index), str(states.id[k]), _TYPES.get(kind, "Misc"), str(truncated), str(occluded[k])]
        yield [*words, *(f"{number:.6f}" for number in numbers)]


def _in_camera(states: ObjectStates, pose: Pose, camera: Camera) -> tuple[Floats, Floats]:
    """Centres (n, 3) m in the axes of the camera, and the turn (n,) rad about its downward axis, 0 to the right."""
    mount = to_world(camera.mount_position[None], pose.position, pose.rotation)[0]
    rotation = pose.rotation @ camera.mount_rotation
    ahead = np.stack([np.cos(states.yaw), np.sin(states.yaw), 0 * states.yaw], axis=1) @ rotation @ AXES.T
    return to_local(states.position, mount, rotation) @ AXES.T, -np.arctan2(ahead[:, 2], ahead[:, 0])


def _rectangles(states: ObjectStates, pose: Pose, camera: Camera) -> Sequence[Sequence[float]]:
    """left, top, right, bottom, px, of each box in the image; _NOT_IN_IMAGE where a part of it is behind the camera."""
    corners = box_corners(states.position, states.size, states.yaw)
    pixels, depth = camera.project(corners.reshape(-1, 3), pose.position, pose.rotation)
    pixels = pixels.reshape(-1, 8, 2)
    ahead = depth.reshape(-1, 8).min(axis=1) > _NEAR_M
    limits = np.array([camera.width - 1.0, camera.height - 1.0])
    result: list[Sequence[float]] = []
    for k in range(len(states)):
        low, high = pixels[k].min(axis=0).clip(0.0, limits), pixels[k].max(axis=0).clip(0.0, limits)
        visible = bool(ahead[k]) and bool((high > low).all())
        result.append((*low.tolist(), *high.tolist()) if visible else _NOT_IN_IMAGE)
    return result
