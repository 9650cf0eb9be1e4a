"""Where false objects are put, and how fast they go: the regions that a selection can name."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from mast_zenoh.arrays.geometry import rotation_from_quaternion
from mast_zenoh.arrays.states import Bools, Floats, ObjectStates
from mast_zenoh.attacks.coverage import Coverage, touching
from mast_zenoh.attacks.propagation import MAX_ACCELERATION_MPS2

#: Places tried for each false object; one that finds none is left out.
TRIES = 128
#: s, for which a false object should be able to go on, and how many places of its path are looked at.
AHEAD_S, SAMPLES = 10.0, 8
#: A place is taken at once if the object can go at this share of the speed drawn for it.
FAST_ENOUGH = 0.7
#: m, how far ahead of the ego objects are put on its path, and σ of their place across it.
PATH_AHEAD_M, ACROSS_STD_M = (10.0, 60.0), 0.3
#: m; half the width of a lane: what is farther off the ego's path is not on it.
LANE_M = 1.75
#: On its path, an object goes at no more than this share of the ego's speed, so that the ego closes in.
SLOWER_THAN_EGO = 0.5
#: m, length from which an object is a vehicle, whose heading is that of its lane.
VEHICLE_M = 2.5


@dataclass(frozen=True, slots=True)
class Shape:
    """What false objects are like: σ per axis about the victim (m) and of the velocity (m/s), and l, w, h (m)."""

    position_std_m: float
    velocity_std_mps: float
    box: Floats


@dataclass(slots=True)
class _Candidates:
    """TRIES poses of one false object: position (t, 3) m, heading (t,) rad, and the speed wanted, m/s."""

    position: Floats
    yaw: Floats
    speed: float


class Region(ABC):
    """Where false objects may be."""

    #: Name of the region in a scenario.
    name: ClassVar[str]

    @abstractmethod
    def place(
        self, count: int, shape: Shape, real: ObjectStates, ground: float, coverage: Coverage, rng: np.random.Generator
    ) -> tuple[Floats, Floats]:
        """Position (k, 3) m and velocity (k, 3) m/s of k <= `count` false objects, world frame.

        real: what the victims see, in canonical order; ground: m, z of the ground
        """


class Paper(Region):
    """Gaussian about a victim, in any direction, wherever that is: the paper's distribution."""

    name = "paper"

    def place(
        self, count: int, shape: Shape, real: ObjectStates, ground: float, coverage: Coverage, rng: np.random.Generator
    ) -> tuple[Floats, Floats]:
        """See Region."""
        position = np.zeros((count, 3))
        velocity = np.zeros((count, 3))
        position[:, :2] = rng.normal(0.0, shape.position_std_m, (count, 2))
        velocity[:, :2] = rng.normal(0.0, shape.velocity_std_mps, (count, 2))
        if count:
            victims = np.array([view.position[:2] for view in coverage.victims])
            position[:, :2] += victims[rng.integers(len(victims), size=count)]
        position[:, 2] = ground + shape.box[2] / 2.0
        return position, velocity


class _Checked(Region):
    """Of many poses of each object the first that is allowed, and whose path is allowed for some time."""

    def place(
        self, count: int, shape: Shape, real: ObjectStates, ground: float, coverage: Coverage, rng: np.random.Generator
    ) -> tuple[Floats, Floats]:
        """See Region."""
        placed = ObjectStates.empty()
        poses: list[tuple[Floats, Floats]] = []
        for stream in rng.spawn(count):
            candidates = self._candidates(shape, real, ground, coverage, stream)
            if candidates is None:
                continue
            boxes = _objects(candidates.position, candidates.yaw, shape.box)
            allowed = self._allowed(boxes, real, coverage) & ~touching(boxes, placed)
            chosen = self._choose(candidates, allowed.nonzero()[0], shape, coverage)
            if chosen is not None:
                row, speed = chosen
                yaw = candidates.yaw[row]
                poses.append((candidates.position[row], speed * np.array([np.cos(yaw), np.sin(yaw), 0.0])))
                placed = _objects(
                    np.array([position for position, _ in poses]),
                    np.array([np.arctan2(v[1], v[0]) for _, v in poses]),
                    shape.box,
                )
        if not poses:
            return np.zeros((0, 3)), np.zeros((0, 3))
        return np.array([position for position, _ in poses]), np.array([velocity for _, velocity in poses])

    @abstractmethod
    def _candidates(
        self, shape: Shape, real: ObjectStates, ground: float, coverage: Coverage, rng: np.random.Generator
    ) -> _Candidates | None:
        """Poses to try for one object; None where there are none."""

    @abstractmethod
    def _allowed(self, boxes: ObjectStates, real: ObjectStates, coverage: Coverage) -> Bools:
        """(k,) which boxes are in the region; `real` objects hide what is behind them."""

    def _choose(
        self, candidates: _Candidates, allowed: np.ndarray, shape: Shape, coverage: Coverage
    ) -> tuple[int, float] | None:
        """Row and speed of the first allowed pose with a free path, else of the one with the longest; None of none."""
        rows = allowed[:16]
        if len(rows) == 0:
            return None
        stop = candidates.speed * AHEAD_S + candidates.speed**2 / (2.0 * MAX_ACCELERATION_MPS2)
        steps = stop * np.arange(1, SAMPLES + 1) / SAMPLES
        yaw = np.repeat(candidates.yaw[rows], SAMPLES)
        along = np.column_stack([np.cos(yaw), np.sin(yaw), np.zeros(len(yaw))]) * np.tile(steps, len(rows))[:, None]
        path = _objects(np.repeat(candidates.position[rows], SAMPLES, axis=0) + along, yaw, shape.box)
        free = self._allowed(path, ObjectStates.empty(), coverage).reshape(len(rows), SAMPLES)
        clear = np.where(free.all(axis=1), SAMPLES, np.argmin(free, axis=1)) * (stop / SAMPLES)
        speed = np.minimum(candidates.speed, fastest_within(clear))
        good = (speed >= FAST_ENOUGH * candidates.speed).nonzero()[0]
        best = int(good[0]) if len(good) else int(np.argmax(speed))
        return int(rows[best]), float(speed[best])


class InView(_Checked):
    """In the view of a victim's sensor, outside buildings and other objects; headings are those of the traffic there.

    The paper's distribution about the victim, as far as the victim sees it.
    """

    name = "in_view"

    def _candidates(
        self, shape: Shape, real: ObjectStates, ground: float, coverage: Coverage, rng: np.random.Generator
    ) -> _Candidates | None:
        if not coverage.victims:
            return None
        victim = coverage.victims[int(rng.integers(len(coverage.victims)))].position
        position = np.full((TRIES, 3), ground + shape.box[2] / 2.0)
        position[:, :2] = victim[:2] + rng.normal(0.0, shape.position_std_m, (TRIES, 2))
        speed = float(np.hypot(*rng.normal(0.0, shape.velocity_std_mps, 2)))
        yaw = rng.uniform(-np.pi, np.pi, TRIES)
        vehicles = (real.size[:, 0] >= VEHICLE_M).nonzero()[0]
        if len(vehicles):
            offset = position[:, None, :2] - real.position[None, vehicles, :2]
            nearest = vehicles[np.argmin((offset * offset).sum(axis=2), axis=1)]
            moving = np.hypot(real.velocity[nearest, 0], real.velocity[nearest, 1]) > 1.0
            yaw = np.where(moving, np.arctan2(real.velocity[nearest, 1], real.velocity[nearest, 0]), real.yaw[nearest])
        return _Candidates(position, yaw, speed)

    def _allowed(self, boxes: ObjectStates, real: ObjectStates, coverage: Coverage) -> Bools:
        seen = np.zeros(len(boxes), bool)
        for view in coverage.victims:
            seen |= coverage.seen(boxes, real, view)
        return seen


class VictimOnly(InView):
    """As InView, but where no other agent's sensor looks that is known: nobody can contradict the victim."""

    name = "victim_only"

    def _allowed(self, boxes: ObjectStates, real: ObjectStates, coverage: Coverage) -> Bools:
        seen = super()._allowed(boxes, real, coverage)
        rows = seen.nonzero()[0]
        table = np.concatenate([boxes.position, boxes.size], axis=1)
        for view in coverage.others():
            if len(rows) == 0:
                break
            rows = rows[~coverage.visible(view, table[rows])]
        result = np.zeros(len(boxes), bool)
        result[rows] = True
        return result


class EgoPath(_Checked):
    """In the ego's lane, ahead of it on its route, where a victim sees it; slower than the ego.

    Behind the end of the known route the path goes straight on.
    """

    name = "ego_path"

    def _candidates(
        self, shape: Shape, real: ObjectStates, ground: float, coverage: Coverage, rng: np.random.Generator
    ) -> _Candidates | None:
        path = path_ahead(coverage)
        if path is None:
            return None
        distance = rng.uniform(*PATH_AHEAD_M, TRIES)
        across = rng.normal(0.0, ACROSS_STD_M, TRIES)
        speed = float(np.hypot(*rng.normal(0.0, shape.velocity_std_mps, 2)))
        place, yaw = path.at(distance)
        position = np.column_stack(
            [
                place[:, 0] - across * np.sin(yaw),
                place[:, 1] + across * np.cos(yaw),
                np.full(TRIES, ground + shape.box[2] / 2.0),
            ]
        )
        return _Candidates(position, yaw, min(speed, SLOWER_THAN_EGO * path.speed))

    def _allowed(self, boxes: ObjectStates, real: ObjectStates, coverage: Coverage) -> Bools:
        path = path_ahead(coverage)
        if path is None or not coverage.victims:
            return np.zeros(len(boxes), bool)
        seen = np.zeros(len(boxes), bool)
        for view in coverage.victims:
            seen |= coverage.plausible(boxes, real, view)
        return seen & (path.offset(boxes.position) <= LANE_M)


#: The regions by name.
REGIONS: dict[str, Region] = {region.name: region for region in (Paper(), InView(), EgoPath(), VictimOnly())}


@dataclass(frozen=True, slots=True)
class Path:
    """A polyline from where the ego is. corners: (k, 2) m; along: (k,) m from the ego; speed: m/s, of the ego now."""

    corners: Floats
    along: Floats
    speed: float
    _samples: Floats = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_samples", self.at(np.arange(0.0, self.along[-1], 1.0))[0])

    def at(self, distance: Floats) -> tuple[Floats, Floats]:
        """Places (n, 2) m and headings (n,) rad at `distance` (n,) m along the path."""
        place = np.column_stack([np.interp(distance, self.along, self.corners[:, axis]) for axis in (0, 1)])
        leg = np.clip(np.searchsorted(self.along, distance, side="right") - 1, 0, len(self.along) - 2)
        step = self.corners[leg + 1] - self.corners[leg]
        return place, np.arctan2(step[:, 1], step[:, 0])

    def offset(self, position: Floats) -> Floats:
        """(n,) m from the path to positions (n, >= 2), to within half a metre along it."""
        apart = position[:, None, :2] - self._samples
        nearest: Floats = np.sqrt((apart * apart).sum(axis=2).min(axis=1))
        return nearest


def path_ahead(coverage: Coverage) -> Path | None:
    """The ego's path from where its route has it at this time, and straight on behind its end; None if unknown."""
    ego = coverage.surroundings.ego_sensor
    if ego is None:
        return None
    route = ego.route
    here, _ = route.at(coverage.time_s)
    soon, _ = route.at(coverage.time_s + 1.0)
    later = route.position[route.time_s > coverage.time_s + 1e-9]
    corners = [here[:2]]
    for place in later[:, :2]:
        if np.hypot(*(place - corners[-1])) > 0.5:
            corners.append(place)
    heading = rotation_from_quaternion(route.rotation[-1])[:2, 0]
    corners.append(corners[-1] + 2.0 * PATH_AHEAD_M[1] * heading / np.hypot(*heading))
    table = np.array(corners)
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(table, axis=0).T))])
    return Path(table, along, float(np.hypot(*(soon - here)[:2])))


def fastest_within(distance: Floats) -> Floats:
    """(n,) m/s at which an object goes for AHEAD_S and brakes within distances (n,) m."""
    b = MAX_ACCELERATION_MPS2
    speed: Floats = b * (np.sqrt(AHEAD_S**2 + 2.0 * distance / b) - AHEAD_S)
    return speed


def _objects(position: Floats, yaw: Floats, box: Floats) -> ObjectStates:
    return ObjectStates.of(position, yaw=yaw, size=np.tile(box, (len(position), 1)))
