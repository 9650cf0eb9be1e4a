"""Chooses the agents of recorded or simulated traffic, in which no vehicle is one by itself."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from mast_zenoh.arrays.geometry import heading
from mast_zenoh.arrays.states import Bools, Floats
from mast_zenoh.errors import ConfigurationError, SceneError
from mast_zenoh.scenes.making.assembly import AgentPath
from mast_zenoh.scenes.making.boxes import Boxes
from mast_zenoh.scenes.making.virtual_agents import MAX_POLES, poles, vehicle, vehicles_throughout

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
    from scipy.spatial import cKDTree  # takes 0.2 s, and every run imports this module

    candidates = vehicles_throughout(boxes, frames)
    if not len(candidates):
        raise SceneError(
            f"{path}: found no car, truck or bus with a box in all {frames} frames, expected one for the ego; "
            "choose another start_s or a shorter duration_s"
        )
    company = np.zeros(len(candidates), np.int64)
    travelled = np.zeros(len(candidates))
    previous: Floats | None = None
    for rows in boxes.rows_by_frame(frames):
        tree = cKDTree(boxes.position[rows])
        own = rows[np.searchsorted(boxes.id[rows], candidates)]
        position = boxes.position[own]
        company += tree.query_ball_point(position, _NEAR_M, return_length=True)
        if previous is not None:
            travelled += np.linalg.norm(position - previous, axis=1)
        previous = position
    company[travelled < _MOVING * travelled.max()] = 0
    return int(candidates[company.argmax()])


def near_route(boxes: Boxes, route: Floats, radius: float) -> Bools:
    """(N,) whether each box is within `radius` m of any position of a route (F, 2) m."""
    from scipy.spatial import cKDTree

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
    if ego not in vehicles_throughout(boxes, frames):
        raise ConfigurationError(
            f"{path}: ego is {name_of(ego)}, expected a car, truck or bus with a box in all {frames} frames"
        )
    n_infrastructure, n_mobile = counts
    first = vehicle("ego", boxes, ego)
    route = first.position[:, :2]
    return [
        first,
        *nearest_vehicles(boxes, ego, frames, n_mobile, path),
        *poles(boxes, route, heading(first.rotation), n_infrastructure),
    ]


def nearest_vehicles(boxes: Boxes, ego: int, frames: int, count: int, path: Path) -> list[AgentPath]:
    """The vehicles nearest to the ego as agents "mobile_1", "mobile_2", …; each has a box in all frames.

    ego: id of its object, which has one, too. Raises ConfigurationError if there are fewer than `count`; path: of the
    data, for the message.
    """
    others = vehicles_throughout(boxes, frames)
    others = others[others != ego]
    if count > len(others):
        raise ConfigurationError(
            f"{path}: n_mobile is {count}, expected 0 to {len(others)}: {len(others)} vehicles besides the ego "
            f"have a box in all {frames} frames"
        )
    own = boxes.position[boxes.rows_of(ego)]
    distance = [np.linalg.norm(boxes.position[boxes.rows_of(number)] - own, axis=1).mean() for number in others]
    nearest = others[np.argsort(distance, kind="stable")][:count]
    return [vehicle(f"mobile_{k}", boxes, int(number)) for k, number in enumerate(nearest, start=1)]
