"""Lidar returns of objects that a data set lists as seen, without their number."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.states import Bools, Ints
from mast_zenoh.scenes.making.assembly import AgentPath
from mast_zenoh.scenes.making.boxes import Boxes
from mast_zenoh.scenes.making.observe import World, lidar_visibility
from mast_zenoh.scenes.recording import truth_states

_MIN_SEEN_POINTS = 5  # returns of an object that counts as seen


def returns(boxes: Boxes, path: AgentPath, times_ns: Ints, listed: Bools, unlisted: Bools) -> NDArray[np.int32]:
    """Lidar returns (N,) of each box at an agent.

    listed:   (N,) boxes known to be seen: what ray casting gives, but at least 5
    unlisted: (N,) boxes about which nothing is known: what ray casting gives

    All other boxes have no returns.
    """
    order = np.lexsort((boxes.id, boxes.frame))
    ordered = boxes.select(order)
    names = ("id", "position", "size", "yaw", "class_id")
    columns = {name: getattr(ordered, name) for name in names} | {"velocity": np.zeros_like(ordered.position)}
    world = World(
        name="",
        agents=(path.agent,),
        period_ns=1,
        times_ns=times_ns,
        truth=truth_states(columns),
        truth_start=np.searchsorted(ordered.frame, np.arange(len(times_ns) + 1)).astype(np.int64),
        agent_position=path.position[:, None],
        agent_rotation=path.rotation[:, None],
        agent_velocity=np.zeros((len(times_ns), 1, 3)),
    )
    cast = np.zeros(len(boxes), np.int32)
    cast[order] = lidar_visibility(world)[:, 0]
    seen = np.where(listed, np.maximum(cast, _MIN_SEEN_POINTS), np.where(unlisted, cast, 0))
    return seen.astype(np.int32)
