"""Lidar returns of objects that a data set lists as seen, without their number."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.states import Bools
from mast_zenoh.scenes.making.assembly import AgentPath
from mast_zenoh.scenes.making.boxes import Boxes
from mast_zenoh.scenes.recording import SEEN_RETURNS
from mast_zenoh.sensing import lidar_points, sensor_pose


def listed_returns(
    boxes: Boxes, path: AgentPath, listed: Bools, unknown: Bools | bool = False, frames: int | None = None
) -> NDArray[np.int32]:
    """Lidar returns (N,) of each box at an agent, which never sees itself.

    listed:  (N,) boxes known to be seen: what ray casting gives, but at least SEEN_RETURNS
    unknown: (N,) boxes about which nothing is known: what ray casting gives
    frames:  how many to compute, the first ones; None: all

    All other boxes have no returns.
    """
    points = np.zeros(len(boxes), np.int32)
    sensor = path.agent.sensor
    for frame, rows in enumerate(boxes.rows_by_frame(len(path.position))[:frames]):
        own = np.flatnonzero(boxes.id[rows] == path.agent.object_id) if path.agent.object_id >= 0 else rows[:0]
        pose = sensor_pose(path.position[frame], path.rotation[frame], sensor.mount_position, sensor.mount_rotation)
        shapes = boxes.position[rows], boxes.size[rows], boxes.yaw[rows]
        points[rows] = lidar_points(sensor, *pose, *shapes, None, int(own[0]) if len(own) else -1)
    seen = np.where(listed, np.maximum(points, SEEN_RETURNS), np.where(unknown, points, 0))
    seen[boxes.id == path.agent.object_id] = 0
    return seen.astype(np.int32)
