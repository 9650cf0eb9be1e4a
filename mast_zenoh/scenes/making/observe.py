"""Simulates what the agents of a scene see and detect."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.states import DETECTION_COLUMNS, Detections, Floats, Ints, ObjectStates
from mast_zenoh.scenes.recording import Recording, SceneAgent
from mast_zenoh.sensing import Detector, Walls, lidar_points, sensor_pose
from mast_zenoh.streams import stream


@dataclass(frozen=True, eq=False)
class World:
    """A scene without visibility and detections; the fields are the same as in `Recording`.

    The rows of each frame are in the order of their ids.
    """

    name: str
    agents: tuple[SceneAgent, ...]
    period_ns: int
    times_ns: Ints
    truth: ObjectStates
    truth_start: Ints
    agent_position: Floats
    agent_rotation: Floats
    agent_velocity: Floats
    buildings: tuple[Floats, ...] = ()
    building_height: Floats = field(default_factory=lambda: np.zeros(0))

    def rows(self, frame: int) -> slice:
        """The truth rows of a frame."""
        return slice(int(self.truth_start[frame]), int(self.truth_start[frame + 1]))

    def sensor_pose(self, frame: int, agent: int) -> tuple[Floats, Floats]:
        """Position (3,) m and rotation (3, 3) of an agent's lidar in the world.

        agent: row of `agents`
        """
        mount = self.agents[agent].sensor
        return sensor_pose(
            self.agent_position[frame, agent],
            self.agent_rotation[frame, agent],
            mount.mount_position,
            mount.mount_rotation,
        )


def lidar_visibility(world: World, columns: Sequence[int] | None = None) -> NDArray[np.int32]:
    """Lidar returns (N, A) of each truth row at each agent, by ray casting.

    columns: the agents to compute; None: all
    """
    points = np.zeros((len(world.truth), len(world.agents)), np.int32)
    walls = Walls.of_buildings(world.buildings, world.building_height)
    for frame in range(len(world.times_ns)):
        rows = world.rows(frame)
        truth = world.truth.select(rows)
        for column in range(len(world.agents)) if columns is None else columns:
            agent = world.agents[column]
            own = np.flatnonzero((truth.id == agent.object_id) & (truth.id >= 0))
            points[rows, column] = lidar_points(
                agent.sensor,
                *world.sensor_pose(frame, column),
                truth.position,
                truth.size,
                truth.yaw,
                walls,
                int(own[0]) if len(own) else -1,
            )
    return points


def detect(
    world: World, points: NDArray[np.int32], detector: Detector, seed: int, ground: Floats | None = None
) -> tuple[Detections, Ints, Ints]:
    """Detect objects in every frame.

    The result is `detections`, `detection_start` and `detection_truth_id`.
    Each (agent, frame) has its own random stream, so adding an agent does not affect the others.
    ground: (F, A) m, z of the ground at each agent; None: 0.
    """
    period_s = world.period_ns * 1e-9
    detectors = [detector.begin(agent.name, "lidar", period_s) for agent in world.agents]
    batches: list[Detections] = []
    ids: list[Ints] = []
    for frame in range(len(world.times_ns)):
        rows = world.rows(frame)
        truth = world.truth.select(rows)
        for column, agent in enumerate(world.agents):
            detections, truth_id = detectors[column].detect(
                truth,
                points[rows, column],
                agent.sensor,
                *world.sensor_pose(frame, column),
                0.0 if ground is None else float(ground[frame, column]),
                stream(seed, "detector", agent.name, frame),
            )
            batches.append(detections)
            ids.append(truth_id)
    flat = Detections(*(np.concatenate([getattr(part, name) for part in batches]) for name in DETECTION_COLUMNS))
    return flat, np.cumsum([0, *map(len, ids)]), np.concatenate(ids)


def make_recording(
    world: World, points: NDArray[np.int32], detections: Detections, detection_start: Ints, detection_truth_id: Ints
) -> Recording:
    """The finished, validated recording."""
    recording = Recording(
        name=world.name,
        agents=world.agents,
        period_ns=world.period_ns,
        times_ns=world.times_ns,
        truth=world.truth,
        truth_start=world.truth_start,
        points=points,
        agent_position=world.agent_position,
        agent_rotation=world.agent_rotation,
        agent_velocity=world.agent_velocity,
        detections=detections,
        detection_start=detection_start,
        detection_truth_id=detection_truth_id,
        buildings=world.buildings,
        building_height=world.building_height,
    )
    recording.validate()
    return recording
