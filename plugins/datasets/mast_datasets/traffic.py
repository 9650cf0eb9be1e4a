"""Boxes, agents and visibility of recorded traffic."""

from __future__ import annotations

import itertools
import math
import os
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.geometry import heading
from mast_zenoh.arrays.states import CLASS_INDEX, Bools, Floats, Ints
from mast_zenoh.errors import ConfigurationError, SceneError
from mast_zenoh.scenes.base import Scene
from mast_zenoh.scenes.making.assembly import MAX_POLES, AgentPath, SceneBoxes, poles, vehicle, vehicles_throughout
from mast_zenoh.scenes.recording import SEEN_RETURNS
from mast_zenoh.scenes.recording_file import check_counts
from mast_zenoh.sensing import DetectionModel, Detector, lidar_points, sensor_pose

#: Limit on the boxes of one scene.
MAX_BOXES = 5_000_000


def classes_of(**types: str) -> dict[str, int]:
    """The class, an index into CLASSES, by the name of a data set's type.

    types: by class, the names of its types with spaces between them
    """
    return {name: CLASS_INDEX[label] for label, names in types.items() for name in names.split()}


def check_times(place: object, names: Sequence[object], times_ns: Ints, max_gap_s: float, parameter: str = "") -> None:
    """Raise SceneError if frames are not in the order of their times, or if some are missing between two.

    place: of the times, for the message; names: (F,) of the frames; times_ns: (F,); parameter: that sets `max_gap_s`
    """
    for step, before, after in zip((np.diff(times_ns) / 1e9).tolist(), names[:-1], names[1:], strict=True):
        if step <= 0:
            raise SceneError(f"{place}: frame {after}: time is not later than that of frame {before} before it")
        if step > max_gap_s:
            raise SceneError(
                f"{place}: frame {after}: found a gap of {step:.3f} s after frame {before}, "
                f"expected at most {max_gap_s:g} s{parameter and f' ({parameter})'}"
            )


def check_steps(place: object, numbers: Sequence[int], hint: str = "") -> None:
    """Raise SceneError unless numbers of frames are the same step apart. place: of the frames; hint: what to do"""
    step = min(np.diff(numbers), default=1)
    for before, after in itertools.pairwise(numbers):
        if after - before != step:
            raise SceneError(f"{place}: frame {before} is followed by {after}, expected {before + step}{hint}")


def choose_frames(place: object, numbers: Sequence[int], first: int | None, last: int | None) -> list[int]:
    """The rows of the numbers from `first_frame` to `last_frame`; None: without that limit. place: of the frames

    Raises ConfigurationError if there are none.
    """
    chosen = [row for row, n in enumerate(numbers) if (first is None or n >= first) and (last is None or n <= last)]
    if not chosen:
        raise ConfigurationError(
            f"{place}: first_frame is {first}, last_frame is {last}: found no frame, expected some of "
            f"{min(numbers)} to {max(numbers)}"
        )
    return chosen


def ground_below(boxes: SceneBoxes, own: int, position: Floats) -> tuple[Floats, SceneBoxes]:
    """The place (3,) m on the ground below a path (F, 3) in the first frame, and the boxes with this as the origin.

    own: id of the object whose underside is on the ground
    """
    row = boxes.rows_of(own)[0]
    origin = np.append(position[0, :2], boxes.position[row, 2] - boxes.size[row, 2] / 2)
    return origin, replace(boxes, position=boxes.position - origin)


#: Of a number: any above 0.
ABOVE_0 = (5e-324, math.inf)
_DETECTOR = DetectionModel()
T = TypeVar("T")


@dataclass(kw_only=True, eq=False)
class DataSetScene(Scene):
    """A scene in the files of a data set.

    path:             of its files
    n_infrastructure: poles to use, the first ones; None: all
    n_mobile:         cars besides the ego to use, the first ones; None: all
    detector:         the model that generates detections from lidar visibility
    """

    path: str
    n_infrastructure: int | None = None
    n_mobile: int | None = None
    detector: Detector = _DETECTOR

    @property
    def root(self) -> Path:
        """The path."""
        return Path(self.path)

    def inputs(self) -> Sequence[Path]:
        """The file or folder at the path."""
        return (self.root,)

    def chosen(self, marker: str, *parameters: str) -> tuple[Path, list[str | None]]:
        """The folder of the data set, and the values of parameters as text, which may follow the folder in the path.

        marker: path in the folder of something that is there; parameters: in the order of the path

        Raises ConfigurationError for a value that is another one than in the path.
        """
        root, values = self.root, [getattr(self, name) for name in parameters]
        texts = [None if value is None else str(value) for value in values]
        for count, above in enumerate(self.root.parents[: len(parameters)], start=1):
            if os.path.exists(self.root) or not os.path.exists(above / marker):
                continue
            root, named = above, self.root.parts[-count:]
            for row, name in enumerate(named):
                if texts[row] not in (None, name):
                    found = f"{parameters[row]} is {texts[row]!r}"
                    raise ConfigurationError(f"{self.path}: {found}, expected {name!r} as in the path")
                texts[row] = name
        return root, texts

    def check(self, **limits: tuple[float, float]) -> None:
        """Raise ConfigurationError for a parameter that is no number within its limits, nor None if that is usual."""
        for name, (low, high) in limits.items():
            value = getattr(self, name)
            if value is None and getattr(type(self), name) is None:
                continue
            is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
            if not is_number or not low <= value <= high or not math.isfinite(value):
                expected = f"{low:g} or more" if math.isinf(high) else f"{low:g} to {high:g}"
                expected = "a number above 0" if (low, high) == ABOVE_0 else expected
                raise ConfigurationError(f"{type(self).__name__}: {name} is {value!r}, expected {expected}")

    def playing(self, cars: Sequence[T], poles: Sequence[T], pole: str = "poles") -> tuple[list[T], list[T]]:
        """The cars, the ego first, and the poles that are agents. pole: what those are called, for the message

        Raises ConfigurationError if there are fewer than requested.
        """
        kinds = "cars besides the ego", pole
        check_counts(self.path, (self.n_mobile, len(cars) - 1), (self.n_infrastructure, len(poles)), kinds)
        kept = len(cars) if self.n_mobile is None else 1 + self.n_mobile
        return list(cars[:kept]), list(poles[: self.n_infrastructure])


@dataclass(kw_only=True, eq=False)
class TrafficScene(DataSetScene):
    """Traffic in the files of a data set, to which virtual agents are added.

    n_infrastructure: virtual poles along the ego's path, 15 m above the ground, looking 30 degrees down, 0 to 16;
                      None: 4
    n_mobile:         vehicles of the traffic that get a lidar on the roof, besides the ego, the ones nearest to it that
                      have a box in every frame; None: 0
    """

    def __post_init__(self) -> None:
        self.check(n_infrastructure=(0, MAX_POLES), n_mobile=(0, math.inf))

    def agents(self, boxes: SceneBoxes, ego: AgentPath, path: Path) -> list[AgentPath]:
        """The ego, the vehicles nearest to it, and poles beside its path. path: of the data, for the message

        Raises ConfigurationError if there are not enough vehicles.
        """
        frames, count = len(ego.position), self.n_mobile or 0
        others = vehicles_throughout(boxes, frames)
        others = others[others != ego.agent.object_id]
        if count > (most := len(others)):
            expected = f"0 to {most}: {most} vehicles besides the ego have a box in all {frames} frames"
            raise ConfigurationError(f"{path}: n_mobile is {count}, expected {expected}")
        own = boxes.position[boxes.rows_of(ego.agent.object_id)]
        distance = [np.linalg.norm(boxes.position[boxes.rows_of(number)] - own, axis=1).mean() for number in others]
        nearest = others[np.argsort(distance, kind="stable")][:count]
        n_poles = _DEFAULT_POLES if self.n_infrastructure is None else self.n_infrastructure
        return [
            ego,
            *(vehicle(f"mobile_{k}", boxes, int(number)) for k, number in enumerate(nearest, start=1)),
            *poles(boxes, ego.position[:, :2], heading(ego.rotation), n_poles),
        ]


def boxes_of(rows: Sequence[tuple[Any, ...]]) -> SceneBoxes:
    """Boxes of rows: frame, id, position (3,) m, size (3,) m, yaw rad, class, and perhaps velocity (3,) m/s."""
    kinds = (np.int64, np.int64, np.float64, np.float64, np.float64, np.uint8, np.float64)
    shapes = (-1, -1, (-1, 3), (-1, 3), -1, -1, (-1, 3))
    columns = zip(zip(*rows, strict=True) if rows else [()] * 6, kinds, shapes, strict=False)
    return SceneBoxes(*(np.array(values, kind).reshape(shape) for values, kind, shape in columns))


class Labels:
    """Boxes in the world frame, of tracks that the data set names by text.

    path: of the file or folder that they are from, for messages; tracks: name of that of each box
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self.tracks: list[str] = []
        self._rows: list[tuple[int, str, Floats, Floats, float, int]] = []

    def add(self, frame: int, track: str, position: Floats, size: Floats, yaw: float, class_id: int) -> None:
        """Add a box. Raises SceneError if there are too many.

        frame: row of the scene's frames; position: (3,) m, middle of the box; size: (3,) m l w h; yaw: rad
        """
        if len(self.tracks) >= MAX_BOXES:
            raise SceneError(f"{self._path}: found more than {MAX_BOXES} boxes, expected at most that many")
        self.tracks.append(track)
        self._rows.append((frame, track, position, size, yaw, class_id))

    def boxes(self, others: Iterable[str] = ()) -> tuple[SceneBoxes, dict[str, int]]:
        """All boxes, and the id of each track. others: tracks without boxes that need an id, too

        If all names are whole numbers, these are the ids; otherwise tracks are numbered from 1, in the order of their
        names.
        """
        names = sorted({*self.tracks, *others})
        numbers = [int(name) for name in names if len(name) <= 15 and name.isascii() and name.isdigit()]
        keep = len(numbers) == len(names) == len(set(numbers))
        ids = dict(zip(names, numbers if keep else range(1, len(names) + 1), strict=True))
        return boxes_of([(frame, ids[track], *row) for frame, track, *row in self._rows]), ids


#: Heights m of data without any, by class: the defaults of SUMO's vehicle classes; unknown objects as cars.
HEIGHT_OF_CLASS = np.array([1.5, 1.5, 2.4, 3.4, 1.5, 1.7, 1.719])
_DEFAULT_POLES = 4
_NEAR_M = 50.0  # an ego has others this near,
_MOVING = 1 / 3  # and moves at least this part of the way of the vehicle that moves farthest


def busiest_vehicle(boxes: SceneBoxes, frames: int, path: Path) -> int:
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
    company, places = np.zeros(len(candidates), np.int64), []
    for rows in boxes.rows_by_frame(frames):
        places.append(boxes.position[rows[np.searchsorted(boxes.id[rows], candidates)]])
        company += cKDTree(boxes.position[rows]).query_ball_point(places[-1], _NEAR_M, return_length=True)
    travelled = np.linalg.norm(np.diff(places, axis=0), axis=2).sum(axis=0)
    company[travelled < _MOVING * travelled.max()] = 0
    return int(candidates[company.argmax()])


def near_route(boxes: SceneBoxes, route: Floats, radius: float) -> Bools:
    """(N,) whether each box is within `radius` m of any position of a route (F, 2) m."""
    from scipy.spatial import cKDTree

    return np.isfinite(cKDTree(route).query(boxes.position[:, :2], distance_upper_bound=radius)[0])


def ego_in_traffic(
    boxes: SceneBoxes, ego: int, frames: int, path: Path, name_of: Callable[[int], str] = str
) -> AgentPath:
    """The vehicle that is the ego, with a lidar on the roof.

    ego: id of its object; path: of the data; name_of: an object's name in the data; the last two for the message

    Raises ConfigurationError unless it is a vehicle with a box in each of the frames.
    """
    if ego not in vehicles_throughout(boxes, frames):
        raise ConfigurationError(
            f"{path}: ego is {name_of(ego)}, expected a car, truck or bus with a box in all {frames} frames"
        )
    return vehicle("ego", boxes, ego)


def listed_returns(
    boxes: SceneBoxes, path: AgentPath, listed: Bools, unknown: Bools | bool = False, frames: int | None = None
) -> NDArray[np.int32]:
    """Lidar returns (N,) of each box at an agent, which never sees itself.

    listed:  (N,) boxes known to be seen: what ray casting gives, but at least SEEN_RETURNS
    unknown: (N,) boxes about which nothing is known: what ray casting gives
    frames:  how many to compute, the first ones; None: all

    All other boxes have no returns.
    """
    points, sensor = np.zeros(len(boxes), np.int32), path.agent.sensor
    for frame, rows in enumerate(boxes.rows_by_frame(len(path.position))[:frames]):
        own = np.flatnonzero((boxes.id[rows] == path.agent.object_id) & (path.agent.object_id >= 0))
        pose = sensor_pose(path.position[frame], path.rotation[frame], sensor.mount_position, sensor.mount_rotation)
        shapes = boxes.position[rows], boxes.size[rows], boxes.yaw[rows]
        points[rows] = lidar_points(sensor, *pose, *shapes, None, int(own[0]) if len(own) else -1)
    seen = np.where(listed, np.maximum(points, SEEN_RETURNS), np.where(unknown, points, 0))
    seen[boxes.id == path.agent.object_id] = 0
    return seen.astype(np.int32)
