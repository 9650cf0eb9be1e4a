"""Chooses the agents of recorded or simulated traffic, in which no vehicle is one by itself."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from mast_zenoh.arrays.states import Bools, Floats
from mast_zenoh.errors import ConfigurationError, SceneError
from mast_zenoh.scenes.assembly import AgentPath
from mast_zenoh.scenes.boxes import Boxes
from mast_zenoh.scenes.virtual_agents import MAX_POLES, poles, vehicle, vehicles_throughout

#: Heights m of data without any, by class: the defaults of SUMO's vehicle classes; unknown objects as cars.
HEIGHT_OF_CLASS = np.array([1.5, 1.5, 2.4, 3.4, 1.5, 1.7, 1.719])
_DEFAULT_POLES = 4
_NEAR_M = 50.0  # an ego has others this near,
_MOVING = 1 / 3  # and moves at least this part of the way of the vehicle that moves farthest


def agent_counts(kind: str, n_infrastructure: int | None, n_mobile: int | None) -> tuple[int, int]:
    """Numbers of poles and of vehicles besides the ego; None means 4 and 0.

    kind: of scene, for the message. Raises ConfigurationError for numbers that cannot be.
    """
    n_infrastructure = _DEFAULT_POLES if n_infrastructure is None else n_infrastructure
    n_mobile = n_mobile or 0
    if not 0 <= n_infrastructure <= MAX_POLES:
        raise ConfigurationError(f"{kind}: n_infrastructure is {n_infrastructure}, expected 0 to {MAX_POLES}")
    if n_mobile < 0:
        raise ConfigurationError(f"{kind}: n_mobile is {n_mobile}, expected 0 or more")
    return n_infrastructure, n_mobile


def busiest_vehicle(boxes: Boxes, frames: int, path: Path) -> int:
    """Id of the vehicle that has the most company among those with a box in each of the frames.

    Company is the number of boxes within 50 m, over all frames. Vehicles that move less than a third of the way of the
    one that moves farthest are not chosen. path: of the data, for the message. Raises SceneError if no vehicle is there
    throughout.
    """
    candidates = vehicles_throughout(boxes, frames)
    if not len(candidates):
        raise SceneError(
            f"{path}: found no car, truck or bus with a box in all {frames} frames, expected one for the ego; "
            "choose another start_s or a shorter duration_s"
        )
    company = np.zeros(len(candidates), np.int64)
    travelled = np.zeros(len(candidates))
    previous: Floats | None = None
    for rows in rows_by_frame(boxes, frames):
        tree = cKDTree(boxes.position[rows])
        own = rows[np.searchsorted(boxes.id[rows], candidates)]
        position = boxes.position[own]
        company += tree.query_ball_point(position, _NEAR_M, return_length=True)
        if previous is not None:
            travelled += np.linalg.norm(position - previous, axis=1)
        previous = position
    company[travelled < _MOVING * travelled.max()] = 0
    return int(candidates[company.argmax()])


def rows_by_frame(boxes: Boxes, frames: int) -> list[np.ndarray]:
    """For each frame the rows of its boxes, by id."""
    order = np.lexsort((boxes.id, boxes.frame))
    return np.split(order, np.searchsorted(boxes.frame[order], np.arange(1, frames)))


def near_route(boxes: Boxes, route: Floats, radius: float) -> Bools:
    """(N,) whether each box is within `radius` m of any position of a route (F, 2) m."""
    distance, _ = cKDTree(route).query(boxes.position[:, :2], distance_upper_bound=radius)
    near: Bools = np.isfinite(distance)
    return near


def with_origin_at(boxes: Boxes, origin: Floats) -> Boxes:
    """The boxes relative to `origin` (3,) m."""
    return replace(boxes, position=boxes.position - origin)


def add_agents(
    boxes: Boxes, ego: int, frames: int, counts: tuple[int, int], path: Path, name_of: Callable[[int], str] = str
) -> list[AgentPath]:
    """The ego, the vehicles nearest to it, and poles beside its route.

    ego: id of its object; counts: of poles, and of vehicles besides the ego; path: of the data; name_of: an object's
    name in the data; the last two for messages

    All vehicles have a lidar on the roof, and need a box in each of the frames. Raises ConfigurationError if there are
    not enough.
    """
    throughout = vehicles_throughout(boxes, frames)
    if ego not in throughout:
        raise ConfigurationError(
            f"{path}: ego is {name_of(ego)}, expected a car, truck or bus with a box in all {frames} frames"
        )
    others = throughout[throughout != ego]
    n_infrastructure, n_mobile = counts
    if n_mobile > len(others):
        raise ConfigurationError(
            f"{path}: n_mobile is {n_mobile}, expected 0 to {len(others)}: {len(others)} vehicles besides the ego "
            f"have a box in all {frames} frames"
        )
    first = vehicle("ego", boxes, ego)
    mobiles = {int(number): vehicle("", boxes, int(number)) for number in others}
    distance = {
        number: np.linalg.norm(path.position - first.position, axis=1).mean() for number, path in mobiles.items()
    }
    nearest = sorted(mobiles, key=lambda number: (distance[number], number))[:n_mobile]
    chosen = [
        replace(mobiles[number], agent=replace(mobiles[number].agent, name=f"mobile_{k}"))
        for k, number in enumerate(nearest, start=1)
    ]
    route = first.position[:, :2]
    yaw = np.arctan2(first.rotation[:, 1, 0], first.rotation[:, 0, 0])
    return [first, *chosen, *poles(boxes, route, yaw, n_infrastructure)]
