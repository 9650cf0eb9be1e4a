"""KITTI tracking: labels, calibration, positions and results, for the main agent's camera.

Geiger, Lenz, Urtasun: Are we ready for autonomous driving? The KITTI vision benchmark suite, CVPR 2012.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TextIO

import numpy as np

from mast_zenoh.arrays.geometry import box_corners, to_local, to_world, wrap_angle
from mast_zenoh.arrays.states import Bools, Floats, Ints, ObjectStates
from mast_zenoh.metrics.record import Series
from mast_zenoh.runs.frame import AgentPose, Frame
from mast_zenoh.runs.recorded import frames_of
from mast_zenoh.runs.routes import TRUTH
from mast_zenoh.runs.run import Run
from mast_zenoh.runs.scans import LidarScan, scans_in
from mast_zenoh.scenes.recording import SEEN_RETURNS
from mast_zenoh.sensing import Camera, LidarSensor
from mast_zenoh.show.export.columns import AXES, cameras, class_names, stem

SEQUENCE = "0000"
_TYPES = {"car": "Car", "truck": "Truck", "bicycle": "Cyclist", "pedestrian": "Pedestrian"}
_EARTH_RADIUS_M = 6378137.0
_NEAR_M = 0.1
#: Occlusion of a label: visible, largely occluded. Truncation: whole, partly outside of the image.
_VISIBLE, _OCCLUDED = 0, 2
_WHOLE, _TRUNCATED = 0, 1
#: The corners at the ends of the edges of a box, in the order of `box_corners`.
_EDGES = np.array([[k, k // 4 * 4 + (k + 1) % 4] for k in range(8)] + [[k, k + 4] for k in range(4)])


def write(run: Run, path: Path) -> None:
    """Write label_02, calib and oxts of one sequence, and trackers/ESTIMATE/data, with what the camera sees.

    Scans of the main agent's lidar, if they were recorded, are in velodyne. The camera is the main agent's; it sees a
    box if a part of it is in the image. A frame without a pose of that agent has neither labels nor a scan.
    """
    for name in ("label_02", "calib", "oxts"):
        (path / name).mkdir(parents=True)
    files = {series: path / "trackers" / stem(series) / "data" / f"{SEQUENCE}.txt" for series in run.topics}
    files[TRUTH] = path / "label_02" / f"{SEQUENCE}.txt"
    for file in files.values():
        file.parent.mkdir(parents=True, exist_ok=True)
    main = run.agents[0]
    camera, lidar = cameras(run)[main], _lidar(run)
    poses: dict[int, AgentPose] = {}
    without_pose = 0
    with ExitStack() as stack:
        opened = {series: stack.enter_context(file.open("w", encoding="ascii")) for series, file in files.items()}
        for frame in frames_of(run):
            if run.agents[0] not in frame.poses:
                without_pose += 1
                continue
            poses[frame.index] = frame.poses[run.agents[0]]
            if (scan := scans_in(frame).get(main)) is not None:
                lidar = replace(lidar, mount_position=scan.position, mount_rotation=scan.rotation)
                _write_scan(path / "velodyne" / SEQUENCE / f"{frame.index:06d}.bin", scan)
            for series, states in frame.objects.items():
                _write_objects(opened[series], run, frame, series, states, camera)
    (path / "calib" / f"{SEQUENCE}.txt").write_text(_calibration(camera, lidar), encoding="ascii")
    if without_pose:
        run.files.note(f"messages.mcap: frames without a pose of {main}, and therefore without labels: {without_pose}")
    (path / "oxts" / f"{SEQUENCE}.txt").write_text("".join(_positions(poses, run.origin)), encoding="ascii")
    last = max(poses, default=-1)
    (path / "evaluate_tracking.seqmap.training").write_text(f"{SEQUENCE} empty 000000 {last + 1:06d}\n", "ascii")


def _write_scan(path: Path, scan: LidarScan) -> None:
    """Write x y z, m, in the lidar's frame, and the intensity of each point: float32."""
    path.parent.mkdir(parents=True, exist_ok=True)
    np.column_stack([scan.points.position, scan.points.intensity]).astype("<f4").tofile(path)


def _lidar(run: Run) -> LidarSensor:
    """The lidar of the main agent; the default one if the scene is not known."""
    known = {agent.name: agent.sensor for agent in run.files.scene.agents} if run.files.scene is not None else {}
    return known.get(run.agents[0], LidarSensor())


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


def _positions(poses: dict[int, AgentPose], origin: Floats) -> Iterator[str]:
    """A line for each frame up to the last: latitude, longitude, altitude, roll, pitch, yaw, and zeros.

    The origin (3,) m is at latitude and longitude 0, in the Mercator projection of KITTI's development kit, which
    stretches with the latitude. A frame without a pose repeats the one before.
    """
    pose = next(iter(poses.values())) if poses else None
    for index in range(max(poses, default=-1) + 1):
        pose = poses.get(index, pose)
        assert pose is not None
        x, y, z = (pose.position - origin) / np.array([_EARTH_RADIUS_M, _EARTH_RADIUS_M, 1.0])
        latitude, longitude = np.degrees(2.0 * np.arctan(np.exp(y)) - np.pi / 2), np.degrees(x)
        r = pose.rotation
        angles = np.arctan2(r[2, 1], r[2, 2]), np.arcsin(-r[2, 0].clip(-1.0, 1.0)), np.arctan2(r[1, 0], r[0, 0])
        values = (latitude, longitude, z, *angles)
        yield " ".join([*(f"{value:.15g}" for value in values), *["0"] * 24]) + "\n"


def _write_objects(file: TextIO, run: Run, frame: Frame, series: Series, states: ObjectStates, camera: Camera) -> None:
    """Write the objects of a series; the main agent's own object is not labelled, as in the benchmark."""
    occluded = np.full(len(states), -1)
    if series == TRUTH:
        seen = frame.points[:, run.agents.index(run.agents[0])] >= SEEN_RETURNS
        kept = states.id != frame.own.get(run.agents[0], -1)
        states, occluded = states.select(kept), np.where(seen, _VISIBLE, _OCCLUDED)[kept]
    for words in _labels(frame, states, frame.poses[run.agents[0]], camera, occluded):
        file.write(" ".join(words[:-1] if series == TRUTH else words) + "\n")


def _labels(frame: Frame, states: ObjectStates, pose: AgentPose, camera: Camera, occluded: Ints) -> Iterator[list[str]]:
    """The words of the line of each object in the image, the last one its score."""
    rectangles, inside, truncated = _rectangles(states, pose, camera)
    position, turn = _in_camera(states, pose, camera)
    bottom = position + np.stack([0 * turn, states.size[:, 2] / 2, 0 * turn], axis=1)
    alpha = wrap_angle(turn - np.arctan2(bottom[:, 0], bottom[:, 2]))
    kinds = class_names(states)
    for k in np.flatnonzero(inside).tolist():
        length, width, height = states.size[k]
        numbers = (alpha[k], *rectangles[k], height, width, length, *bottom[k], turn[k], states.score[k])
        cut = _TRUNCATED if truncated[k] else _WHOLE
        words = [str(frame.index), str(states.id[k]), _TYPES.get(kinds[k], "Misc"), str(cut), str(occluded[k])]
        yield [*words, *(f"{number:.6f}" for number in numbers)]


def _in_camera(states: ObjectStates, pose: AgentPose, camera: Camera) -> tuple[Floats, Floats]:
    """Centres (n, 3) m in the axes of the camera, and the turn (n,) rad about its downward axis, 0 to the right."""
    rotation = pose.rotation @ camera.mount_rotation
    ahead = np.stack([np.cos(states.yaw), np.sin(states.yaw), 0 * states.yaw], axis=1) @ rotation @ AXES.T
    return _in_camera_axes(states.position, pose, camera), -np.arctan2(ahead[:, 2], ahead[:, 0])


def _in_camera_axes(points: Floats, pose: AgentPose, camera: Camera) -> Floats:
    """(n, 3) m, x right, y down, z ahead of the camera, of points (n, 3) m of the world."""
    mount = to_world(camera.mount_position[None], pose.position, pose.rotation)[0]
    return np.asarray(to_local(points, mount, pose.rotation @ camera.mount_rotation) @ AXES.T)


def _rectangles(states: ObjectStates, pose: AgentPose, camera: Camera) -> tuple[Floats, Bools, Bools]:
    """left, top, right, bottom (n, 4), px, of the part of each box in the image; and (n,) which have one, and are cut.

    Of a box that is partly behind the camera it is the part ahead. One around the camera, its own, is not seen.
    """
    corners = _in_camera_axes(box_corners(states.position, states.size, states.yaw).reshape(-1, 3), pose, camera)
    first, last = (corners.reshape(-1, 8, 3)[:, ends] for ends in _EDGES.T)
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing = first + ((_NEAR_M - first[..., 2]) / (last[..., 2] - first[..., 2]))[..., None] * (last - first)
    # The ends of each edge, moved to the near plane where they are behind it; of edges entirely behind it, none counts.
    points = np.concatenate([np.where(end[..., 2:] < _NEAR_M, crossing, end) for end in (first, last)], axis=1)
    ahead = np.tile(np.maximum(first[..., 2], last[..., 2]) >= _NEAR_M, 2)[..., None]
    centre, limits = np.array([camera.width, camera.height]) / 2, np.array([camera.width - 1.0, camera.height - 1.0])
    pixels = centre + camera.focal * np.where(ahead, points[..., :2] / np.where(ahead, points[..., 2:], 1.0), 0.0)
    low = np.where(ahead, pixels, np.inf).min(axis=1)
    high = np.where(ahead, pixels, -np.inf).max(axis=1)
    rectangles = np.concatenate([low.clip(0.0, limits), high.clip(0.0, limits)], axis=1)
    inside = np.asarray((rectangles[:, 2:] > rectangles[:, :2]).all(axis=1)) & ~_is_around(states, pose, camera)
    cut = np.asarray((low < 0.0).any(axis=1) | (high > limits).any(axis=1) | ~ahead.all(axis=(1, 2)))
    return rectangles, inside, cut


def _is_around(states: ObjectStates, pose: AgentPose, camera: Camera) -> Bools:
    """Which boxes (n,) a camera is in, or above."""
    mount = to_world(camera.mount_position[None], pose.position, pose.rotation)[0]
    x, y = (mount - states.position)[:, :2].T
    c, s = np.cos(states.yaw), np.sin(states.yaw)
    offset = np.abs(np.stack([c * x + s * y, c * y - s * x], axis=1))
    return np.asarray((offset <= states.size[:, :2] / 2).all(axis=1))
