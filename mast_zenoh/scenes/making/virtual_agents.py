"""Agents added to recorded traffic: cars with a lidar on the roof, and poles beside a route."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mast_zenoh.arrays.geometry import rotation_from_yaw, rotation_from_yaw_pitch
from mast_zenoh.arrays.states import CLASS_INDEX, Floats, Ints
from mast_zenoh.scenes.making.assembly import AgentPath, SceneBoxes, ground_level
from mast_zenoh.scenes.recording import SceneAgent
from mast_zenoh.sensing import Camera, LidarSensor

MAX_POLES = 16
POLE_HEIGHT_M = 15.0
POLE_PITCH_DEG = 30.0
_MIN_LIDAR_HEIGHT_M = 1.8  # above the underside of a vehicle,
_ABOVE_ROOF_M = 0.2  # or above its roof, whichever is higher
_POLE_OFFSET_M = 16.0  # from the route
_ROUTE_EXTENSION_M = 20.0  # by which the route is extended at both ends
#: Classes of objects that can be vehicles with a lidar.
VEHICLE_CLASSES = [CLASS_INDEX[name] for name in ("car", "truck", "bus")]


def roof_sensors(height: float) -> tuple[LidarSensor, Camera]:
    """The lidar and the camera of a vehicle of a height m."""
    mount = np.array([0.0, 0.0, max(_MIN_LIDAR_HEIGHT_M, height + _ABOVE_ROOF_M)])
    return LidarSensor(mount_position=mount), Camera(mount_position=mount - [0.0, 0.0, _ABOVE_ROOF_M])


def vehicle(name: str, boxes: SceneBoxes, object_id: int) -> AgentPath:
    """A car of the traffic as an agent; its origin is the middle of its underside.

    object_id: with a box in every frame
    """
    own = boxes.rows_of(object_id)
    height = boxes.size[own, 2]
    lidar, camera = roof_sensors(float(height.max()))
    return AgentPath(
        SceneAgent(name, "mobile", object_id, lidar, camera),
        boxes.position[own] - np.stack([np.zeros(len(own)), np.zeros(len(own)), height / 2], axis=1),
        np.stack([rotation_from_yaw(float(yaw)) for yaw in boxes.yaw[own]]),
    )


def vehicles_throughout(boxes: SceneBoxes, frames: int) -> Ints:
    """Ids of the cars, trucks and buses that have a box in each of the frames, ascending."""
    ids, count = np.unique(boxes.id[np.isin(boxes.class_id, VEHICLE_CLASSES)], return_counts=True)
    throughout: Ints = ids[count == frames]
    return throughout


def poles(boxes: SceneBoxes, route: Floats, yaw: Floats, count: int) -> list[AgentPath]:
    """Poles 15 m above the ground on both sides of a route; they look 30 degrees down to its middle.

    route: (F, 2) m, and yaw: (F,) rad along it. The k-th pole does not depend on the number of poles.
    """
    extension = np.stack([np.cos(yaw), np.sin(yaw)], axis=1) * _ROUTE_EXTENSION_M
    path = np.concatenate([[route[0] - extension[0]], route, [route[-1] + extension[-1]]])
    step = np.hypot(*np.diff(path, axis=0).T)
    distance = np.concatenate([[0.0], np.cumsum(step)])

    def at(fraction: float) -> Floats:
        return np.array([np.interp(fraction * distance[-1], distance, path[:, k]) for k in (0, 1)])

    placed = []
    for k in range(count):
        fraction = 0.1 + 0.8 * _van_der_corput(k)
        direction = at(fraction + 0.02) - at(fraction - 0.02)
        offset = np.array([-direction[1], direction[0]]) / np.hypot(*direction) * _POLE_OFFSET_M
        position = at(fraction) + (offset if k % 2 == 0 else -offset)
        facing = at(0.5) - position
        placed.append(pole(f"infra_{k + 1}", boxes, position, np.arctan2(facing[1], facing[0]), len(route)))
    return placed


def pole(name: str, boxes: SceneBoxes, position: Floats, yaw: float, frames: int) -> AgentPath:
    """A pole at `position` (2,) m, 15 m above the ground; its lidar looks 30 degrees down.

    yaw: rad, where it looks
    """
    ground = ground_level(boxes, position)
    rotation = rotation_from_yaw_pitch(float(yaw), np.radians(POLE_PITCH_DEG))
    place = np.array([*position, ground + POLE_HEIGHT_M])
    path = standing(name, LidarSensor.infrastructure(), place, rotation, frames)
    return replace(path, ground=np.full(frames, ground))


def standing(name: str, sensor: LidarSensor, position: Floats, rotation: Floats, frames: int) -> AgentPath:
    """An agent that never moves, whose origin is its sensor. position: (3,) m; rotation: (3, 3)"""
    return AgentPath(
        SceneAgent(name, "static", -1, sensor, Camera(mount_position=np.zeros(3))),
        np.tile(position, (frames, 1)),
        np.tile(rotation, (frames, 1, 1)),
        velocity=np.zeros((frames, 3)),
    )


def _van_der_corput(k: int) -> float:
    """The k-th term of 0, 1, 1/2, 1/4, 3/4, …: a sequence that fills 0 to 1 evenly."""
    if k < 2:
        return float(k)
    level = 1 << ((k - 1).bit_length() - 1)
    return (2 * (k - 1 - level) + 1) / (2 * level)
