"""Boxes, agents and visibility of recorded traffic."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mast_datasets.files import MAX_COORDINATE_M, Element
from mast_zenoh.arrays.geometry import heading
from mast_zenoh.arrays.states import Bools, Floats
from mast_zenoh.errors import ConfigurationError, SceneError
from mast_zenoh.scenes.making.assembly import AgentPath, Boxes
from mast_zenoh.scenes.making.virtual_agents import MAX_POLES, poles, vehicle, vehicles_throughout
from mast_zenoh.scenes.recording import SEEN_RETURNS
from mast_zenoh.sensing import lidar_points, sensor_pose

#: Limits on one scene: a single object, and all of its boxes.
MAX_SIZE_M = 200.0
MAX_BOXES = 5_000_000


def read_point(element: Element) -> Floats:
    """(3,) m, of a list of coordinates."""
    return np.array([value.number(-MAX_COORDINATE_M, MAX_COORDINATE_M) for value in element.elements(3)])


def read_size(element: Element) -> Floats:
    """(3,) m, of a list of length, width and height."""
    size = element.size()
    if size.max() > MAX_SIZE_M:
        element.fail(f"3 numbers above 0, at most {MAX_SIZE_M:g}")
    return size


class Labels:
    """Boxes in the world frame, of tracks that the data set names by text.

    path: of the file or folder that they are from, for messages
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._tracks: list[str] = []
        self._frames: list[int] = []
        self._positions: list[Floats] = []
        self._sizes: list[Floats] = []
        self._yaws: list[float] = []
        self._classes: list[int] = []

    def add(self, frame: int, track: str, position: Floats, size: Floats, yaw: float, class_id: int) -> None:
        """Add a box. Raises SceneError if there are too many.

        frame: row of the scene's frames; position: (3,) m, middle of the box; size: (3,) m l w h; yaw: rad
        """
        if len(self._tracks) >= MAX_BOXES:
            raise SceneError(f"{self._path}: found more than {MAX_BOXES} boxes, expected at most that many")
        self._tracks.append(track)
        self._frames.append(frame)
        self._positions.append(position)
        self._sizes.append(size)
        self._yaws.append(yaw)
        self._classes.append(class_id)

    def boxes(self, others: Iterable[str] = ()) -> tuple[Boxes, dict[str, int]]:
        """All boxes, and the id of each track. others: tracks without boxes that need an id, too

        If all names are whole numbers, these are the ids; otherwise tracks are numbered from 1, in the order of their
        names.
        """
        names = sorted({*self._tracks, *others})
        numbers = [int(name) for name in names if len(name) <= 15 and name.isascii() and name.isdigit()]
        keep = len(numbers) == len(names) == len(set(numbers))
        ids = dict(zip(names, numbers if keep else range(1, len(names) + 1), strict=True))
        n = len(self._tracks)
        return Boxes(
            frame=np.array(self._frames, np.int64),
            id=np.array([ids[track] for track in self._tracks], np.int64),
            position=np.array(self._positions).reshape(n, 3),
            size=np.array(self._sizes).reshape(n, 3),
            yaw=np.array(self._yaws, np.float64),
            class_id=np.array(self._classes, np.uint8),
            velocity=np.full((n, 3), np.nan),
        ), ids


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
