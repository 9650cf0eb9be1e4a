"""Which sensors would see an object that is not there."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.geometry import wrap_angle
from mast_zenoh.arrays.states import Floats, Ints, ObjectStates
from mast_zenoh.sensing.lidar import LidarSensor
from mast_zenoh.sensing.raycast import Walls, lidar_points


class PlacedSensor(NamedTuple):
    """A lidar at one time.

    position: (3,) m, rotation: (3, 3) active: of the lidar in the world (`sensing.sensor_pose`)
    own: id of the object that carries it, which occludes nothing; -1: none
    """

    lidar: LidarSensor
    position: Floats
    rotation: Floats
    own: int = -1


def observable(
    position: Floats,
    size: Floats,
    yaw: Floats,
    sensors: Sequence[PlacedSensor],
    walls: Walls | None,
    occluders: ObjectStates,
) -> NDArray[np.int32]:
    """(n, a) lidar returns that each of a sensors would have from each of n objects, if it were real.

    position: (n, 3) m, centre, size: (n, 3) m, yaw: (n,) rad, of the objects, world frame; they do not hide each other
    walls: None: none;  occluders: the real objects of that time

    An observer that has none where it should have some knows that the object is not there.
    """
    returns = np.zeros((len(position), len(sensors)), np.int32)
    for column, sensor in enumerate(sensors):
        others = occluders.select(occluders.id != sensor.own) if sensor.own >= 0 else occluders
        for row in range(len(position)):
            before = _in_the_way(sensor.position, position[row], size[row], others)
            boxes = (
                np.concatenate([position[None, row], others.position[before]]),
                np.concatenate([size[None, row], others.size[before]]),
                np.concatenate([yaw[None, row], others.yaw[before]]),
            )
            returns[row, column] = lidar_points(sensor.lidar, sensor.position, sensor.rotation, *boxes, walls)[0]
    return returns


def _in_the_way(origin: Floats, position: Floats, size: Floats, others: ObjectStates) -> Ints:
    """Rows of `others` that may hide an object from a sensor at `origin`."""
    offset = others.position[:, :2] - origin[:2]
    distance, target = np.hypot(*offset.T), position[:2] - origin[:2]
    far, radius = float(np.hypot(*target)), float(np.hypot(*size[:2])) / 2
    radii = np.hypot(*others.size[:, :2].T) / 2
    apart = np.abs(wrap_angle(np.arctan2(offset[:, 1], offset[:, 0]) - np.arctan2(target[1], target[0])))
    width = _half_angle(radii, distance) + _half_angle(np.array(radius), np.array(far))
    return np.flatnonzero((apart <= width) & (distance - radii <= far + radius))


def _half_angle(radius: Floats, distance: Floats) -> Floats:
    """rad, half the angle under which circles are seen; pi from inside."""
    ratio = np.divide(radius, distance, out=np.full(np.shape(distance), 2.0), where=distance > 0.0)
    return np.where(ratio < 1.0, np.arcsin(np.minimum(ratio, 1.0)), np.pi)
