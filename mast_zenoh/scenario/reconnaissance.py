"""Attackers' knowledge of a scene: `surroundings` of adversaries and coordinators."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from mast_zenoh.arrays.geometry import quaternion_from_rotation
from mast_zenoh.arrays.states import Floats, Ints
from mast_zenoh.scenes.recording import Recording
from mast_zenoh.sensing import LidarSensor

#: s, between two rows of a route.
ROUTE_STEP_S = 0.5


def surroundings_of(recording: Recording, victims: Iterable[str]) -> dict[str, Any]:
    """The parameters of `attacks.Surroundings`: buildings, sensors and routes.

    victims: the attackers' agents. Buildings out of every sensor's range are left out.
    """
    times_s = (recording.times_ns - recording.times_ns[0]) * 1e-9
    stride = max(1, round(ROUTE_STEP_S * 1e9 / recording.period_ns))
    rows = np.unique([*range(0, len(times_s), stride), len(times_s) - 1])
    agents: dict[str, Any] = {}
    for index, agent in enumerate(recording.agents):
        agents[agent.name] = {
            **_of_sensor(agent.sensor),
            "route": _route(recording, index, times_s, rows if agent.kind == "mobile" else rows[:1]),
        }
        if further := agent.sensors[1:]:
            agents[agent.name]["further"] = {sensor.name: _of_sensor(sensor.lidar) for sensor in further}
    near = _within_range(recording, rows)
    return {
        "scene": recording.name,
        "agents": agents,
        "victims": list(victims),
        "buildings": [recording.buildings[index].round(3).tolist() for index in near],
        "building_height": [float(recording.building_height[index]) for index in near],
    }


def _of_sensor(lidar: LidarSensor) -> dict[str, Any]:
    """Field of view, range and mount of a sensor."""
    return {
        "limits_deg": [
            *(lidar.azimuth_min_deg, lidar.azimuth_max_deg),
            *(lidar.elevation_min_deg, lidar.elevation_max_deg),
        ],
        "max_range_m": lidar.max_range_m,
        "mount_position": np.asarray(lidar.mount_position).tolist(),
        "mount_rotation": np.asarray(lidar.mount_rotation).tolist(),
    }


def _route(recording: Recording, agent: int, times_s: Floats, rows: Ints) -> list[list[float]]:
    rotation = quaternion_from_rotation(recording.agent_rotation[rows, agent])
    table = np.column_stack([times_s[rows], recording.agent_position[rows, agent], rotation])
    return [[round(float(value), 6) for value in row] for row in table]


def _within_range(recording: Recording, rows: Ints) -> list[int]:
    """Indices of buildings with a corner or wall centre ever in range of a sensor."""
    near: list[int] = []
    max_range_m = np.array([agent.sensor.max_range_m for agent in recording.agents])
    positions = recording.agent_position[rows, :, :2]
    for index, outline in enumerate(recording.buildings):
        points = np.concatenate([outline, 0.5 * (outline + np.roll(outline, -1, axis=0))])
        distance_m = np.linalg.norm(points - positions[..., None, :], axis=-1).min(axis=-1)
        if (distance_m <= max_range_m).any():
            near.append(index)
    return near
