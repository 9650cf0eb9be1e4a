"""Recorded scenes: logs of the Argoverse 2 sensor data set."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from mast_zenoh.arrays.geometry import heading, rotation_from_yaw_pitch
from mast_zenoh.arrays.states import CLASS_INDEX, Floats
from mast_zenoh.errors import ConfigurationError
from mast_zenoh.scenes.av2_files import Boxes, find_log, read_boxes, read_poses
from mast_zenoh.scenes.base import Scene
from mast_zenoh.scenes.observe import World, detect, lidar_visibility, make_recording
from mast_zenoh.scenes.recording import Recording, SceneAgent, truth_states
from mast_zenoh.scenes.velocities import fill_velocity
from mast_zenoh.sensing import Camera, DetectionModel, Detector, LidarSensor

#: The recording car. The origin of its frame is the rear axle; the ego's box encloses the body.
_EGO_ID = 0
_EGO_SIZE = np.array([4.877, 2.0, 1.473])
_AXLE_HEIGHT_M = 0.33
_EGO_CENTRE = np.array([1.42, 0.0, _EGO_SIZE[2] / 2 - _AXLE_HEIGHT_M])
#: Its two roof lidars, 32 channels each, modelled as one.
_EGO_LIDAR = LidarSensor(
    mount_position=np.array([1.35, 0.0, 1.64]), elevation_min_deg=-25.0, elevation_max_deg=15.0, max_range_m=200.0
)
_EGO_CAMERA = Camera(mount_position=np.array([1.6, 0.0, 1.4]))

_POLES, _MAX_POLES = 4, 16
_POLE_HEIGHT_M = 15.0
_POLE_PITCH_DEG = 30.0
_POLE_OFFSET_M = 16.0  # from the ego's path
_PATH_EXTENSION_M = 20.0  # by which the path is extended at both ends
_GROUND_RADIUS_M = 25.0  # the ground's height is estimated from the boxes within this distance,
_MIN_GROUND_BOXES = 20  # and from at least this many
_DETECTOR = DetectionModel()


class AV2Log(Scene):
    """An Argoverse 2 sensor log: a real car in real traffic, to which poles are added.

    path:             the folder of a log, with annotations*.feather and city_SE3_egovehicle.feather
    n_infrastructure: virtual poles along the ego's path, 15 m above the ground there, looking 30 degrees down, 0 to 16;
                      None: 4
    n_mobile:         other mobile agents: always 0, since a log has the sensors of one car; None: 0
    detector:         the model that generates detections from lidar visibility

    The world's origin is on the ground below the ego's first position. The ego's visibility is the number of lidar
    returns in the data set; the poles' comes from ray casting against the other boxes (the data has no
    buildings). Traffic signs, cones and similar objects are left out (`av2_files.LEFT_OUT`).
    """

    def __init__(
        self,
        *,
        path: str,
        n_infrastructure: int | None = None,
        n_mobile: int | None = None,
        detector: Detector = _DETECTOR,
    ) -> None:
        n_infrastructure = _POLES if n_infrastructure is None else n_infrastructure
        if n_mobile:
            raise ConfigurationError(f"AV2Log: n_mobile is {n_mobile}, expected 0: a log has no other car with sensors")
        if not 0 <= n_infrastructure <= _MAX_POLES:
            raise ConfigurationError(f"AV2Log: n_infrastructure is {n_infrastructure}, expected 0 to {_MAX_POLES}")
        self.path = Path(path)
        self.n_infrastructure = n_infrastructure
        self.detector = detector

    def inputs(self) -> Sequence[Path]:
        """The log's folder."""
        return (self.path,)

    def record(self, seed: int, frames: int | None) -> Recording:
        annotations, poses = find_log(self.path)
        boxes = read_boxes(annotations)
        count = len(boxes.times_ns) if frames is None else frames
        if not 1 <= count <= len(boxes.times_ns):
            raise ConfigurationError(f"{self.path}: {count} frames requested, the log has {len(boxes.times_ns)}")
        city, rotation = read_poses(poses, boxes.times_ns)
        ego = city - city[0] + [0.0, 0.0, _AXLE_HEIGHT_M]
        world, returns = _world(annotations.parent.name, boxes, ego, rotation)
        poles = _poles(world, ego, heading(rotation), self.n_infrastructure)
        world, ground = _with_agents(world, ego, rotation, poles)
        world = _truncate(world, count)
        points = lidar_visibility(world, range(1, len(world.agents)))
        points[:, 0] = returns[: len(points)]
        return make_recording(world, points, *detect(world, points, self.detector, seed, ground[:count]))


def _world(name: str, boxes: Boxes, ego: Floats, rotation: Floats) -> tuple[World, Floats]:
    """The traffic including the ego, without agents; and the ego's lidar returns.

    The lidar returns are (N,), one count for each object.
    """
    frames = len(boxes.times_ns)
    frame = np.concatenate([np.arange(frames), boxes.frame])
    track = np.concatenate([np.full(frames, _EGO_ID), boxes.track])
    box_position = np.einsum("nij,nj->ni", rotation[boxes.frame], boxes.position) + ego[boxes.frame]
    position = np.concatenate([ego + rotation @ _EGO_CENTRE, box_position])
    # The ego has id 0, so it is the first row of its frame.
    order = np.lexsort((track, frame))
    columns = {
        "id": track,
        "position": position,
        "velocity": np.full_like(position, np.nan),
        "size": np.concatenate([np.tile(_EGO_SIZE, (frames, 1)), boxes.size]),
        "yaw": np.concatenate([heading(rotation), heading(rotation[boxes.frame] @ boxes.rotation)]),
        "class_id": np.concatenate([np.full(frames, CLASS_INDEX["car"], np.uint8), boxes.class_id]),
    }
    columns = {key: values[order] for key, values in columns.items()}
    columns["velocity"] = fill_velocity(
        columns["id"], columns["position"], columns["velocity"], boxes.times_ns[frame[order]]
    )
    world = World(
        name=name,
        agents=(),
        period_ns=int(np.median(np.diff(boxes.times_ns))) if frames > 1 else 100_000_000,
        times_ns=boxes.times_ns - boxes.times_ns[0],
        truth=truth_states(columns),
        truth_start=np.searchsorted(frame[order], np.arange(frames + 1)).astype(np.int64),
        agent_position=np.zeros((frames, 0, 3)),
        agent_rotation=np.zeros((frames, 0, 3, 3)),
        agent_velocity=np.zeros((frames, 0, 3)),
    )
    return world, np.concatenate([np.zeros(frames, np.int64), boxes.points])[order]


def _poles(world: World, ego: Floats, yaw: Floats, count: int) -> list[tuple[Floats, float, float]]:
    """Position (3,) m, heading rad and ground m of poles along the ego's path.

    Poles are on both sides of the path and face its middle.
    The k-th pole does not depend on the number of poles.
    """
    extension = np.stack([np.cos(yaw), np.sin(yaw)], axis=1) * _PATH_EXTENSION_M
    path = np.concatenate([[ego[0, :2] - extension[0]], ego[:, :2], [ego[-1, :2] + extension[-1]]])
    step = np.hypot(*np.diff(path, axis=0).T)
    distance = np.concatenate([[0.0], np.cumsum(step)])
    bottoms = world.truth.position - world.truth.size * [0.0, 0.0, 0.5]

    def at(fraction: float) -> Floats:
        return np.array([np.interp(fraction * distance[-1], distance, path[:, k]) for k in (0, 1)])

    poles = []
    for k in range(count):
        fraction = 0.1 + 0.8 * _van_der_corput(k)
        direction = at(fraction + 0.02) - at(fraction - 0.02)
        offset = np.array([-direction[1], direction[0]]) / np.hypot(*direction) * _POLE_OFFSET_M
        position = at(fraction) + (offset if k % 2 == 0 else -offset)
        ground = _ground(bottoms, position)
        facing = at(0.5) - position
        poles.append((np.array([*position, ground + _POLE_HEIGHT_M]), float(np.arctan2(facing[1], facing[0])), ground))
    return poles


def _van_der_corput(k: int) -> float:
    """The k-th term of 0, 1, 1/2, 1/4, 3/4, …: a sequence that fills 0 to 1 evenly."""
    if k < 2:
        return float(k)
    level = 1 << ((k - 1).bit_length() - 1)
    return (2 * (k - 1 - level) + 1) / (2 * level)


def _ground(bottoms: Floats, position: Floats) -> float:
    """Ground height m at `position` (2,): median of the bottoms of nearby boxes.

    If there are too few, the nearest boxes are used.
    """
    distance = np.hypot(*(bottoms[:, :2] - position).T)
    nearest = np.sort(distance)[:_MIN_GROUND_BOXES][-1]
    return float(np.median(bottoms[distance <= max(_GROUND_RADIUS_M, nearest), 2]))


def _with_agents(
    world: World, ego: Floats, rotation: Floats, poles: list[tuple[Floats, float, float]]
) -> tuple[World, Floats]:
    """The scene with its agents, and the ground height (F, A) m at each agent."""
    frames = len(ego)
    agents = [SceneAgent("ego", "mobile", _EGO_ID, _EGO_LIDAR, _EGO_CAMERA)]
    for k in range(len(poles)):
        pole = Camera(mount_position=np.zeros(3))
        agents.append(SceneAgent(f"infra_{k + 1}", "static", -1, LidarSensor.infrastructure(), pole))
    pole_rotation = [rotation_from_yaw_pitch(yaw, np.radians(_POLE_PITCH_DEG)) for _, yaw, _ in poles]
    agent_position = np.stack([ego, *(np.tile(pole_position, (frames, 1)) for pole_position, _, _ in poles)], axis=1)
    agent_velocity = np.zeros_like(agent_position)
    agent_velocity[:, 0] = world.truth.velocity[world.truth.id == _EGO_ID]
    complete = replace(
        world,
        agents=tuple(agents),
        agent_position=agent_position,
        agent_rotation=np.stack([rotation, *(np.tile(matrix, (frames, 1, 1)) for matrix in pole_rotation)], axis=1),
        agent_velocity=agent_velocity,
    )
    ground = np.stack([ego[:, 2] - _AXLE_HEIGHT_M, *(np.full(frames, level) for _, _, level in poles)], axis=1)
    return complete, ground


def _truncate(world: World, count: int) -> World:
    """The first `count` frames."""
    return replace(
        world,
        times_ns=world.times_ns[:count],
        truth=world.truth.select(slice(int(world.truth_start[count]))),
        truth_start=world.truth_start[: count + 1],
        agent_position=world.agent_position[:count],
        agent_rotation=world.agent_rotation[:count],
        agent_velocity=world.agent_velocity[:count],
    )
