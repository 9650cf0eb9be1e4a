"""Regions in which a selection places false objects, with their speeds; and the ego's path ahead."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.geometry import distance_along, rotation_from_quaternion
from mast_zenoh.arrays.states import CLASS_INDEX, Bools, Floats, ObjectStates, concatenate
from mast_zenoh.attacks.surroundings import Coverage, touching

#: m, range of distances ahead of the ego on its path.
PATH_AHEAD_M = (10.0, 60.0)


@dataclass(frozen=True, slots=True)
class Path:
    """A polyline from the ego's position.

    corners: (k, 2) m; along: (k,) m from the ego; speed: m/s, of the ego now
    """

    corners: Floats
    along: Floats
    speed: float
    _samples: Floats = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_samples", self.at(np.arange(0.0, self.along[-1], 1.0))[0])

    def at(self, distance: Floats) -> tuple[Floats, Floats]:
        """Positions (n, 2) m and headings (n,) rad at `distance` (n,) m along the path."""
        position = np.column_stack([np.interp(distance, self.along, self.corners[:, axis]) for axis in (0, 1)])
        segment = np.clip(np.searchsorted(self.along, distance, side="right") - 1, 0, len(self.along) - 2)
        step = self.corners[segment + 1] - self.corners[segment]
        return position, np.arctan2(step[:, 1], step[:, 0])

    def offset(self, position: Floats) -> Floats:
        """Distance (n,) m of positions (n, >= 2) from the path, sampled every metre."""
        offset = position[:, None, :2] - self._samples
        nearest: Floats = np.sqrt((offset * offset).sum(axis=2).min(axis=1))
        return nearest

    def coordinates(self, position: Floats) -> tuple[Floats, Floats]:
        """How far along the path positions (n, >= 2) m are, and how far to the left of it, both (n,) m."""
        offset = position[:, None, :2] - self._samples
        along = (offset * offset).sum(axis=2).argmin(axis=1).astype(np.float64)
        point, heading = self.at(along)
        offset, cos, sin = position[:, :2] - point, np.cos(heading), np.sin(heading)
        return along + cos * offset[:, 0] + sin * offset[:, 1], cos * offset[:, 1] - sin * offset[:, 0]

    def nearest_points(self, position: Floats) -> Floats:
        """(n, 2) m, the samples of the path, every metre, that are nearest to positions (n, >= 2) m."""
        offset = position[:, None, :2] - self._samples
        nearest: Floats = self._samples[(offset * offset).sum(axis=2).argmin(axis=1)]
        return nearest


def path_ahead(coverage: Coverage) -> Path | None:
    """The ego's path on its route and straight on beyond its end; None if unknown."""
    ego = coverage.surroundings.ego_sensor
    if ego is None:
        return None
    route = ego.route
    position_now, _ = route.at(coverage.time_s)
    position_in_1s, _ = route.at(coverage.time_s + 1.0)
    waypoints = route.position[route.time_s > coverage.time_s + 1e-9]
    corners = [position_now[:2]]
    for waypoint in waypoints[:, :2]:
        if np.hypot(*(waypoint - corners[-1])) > 0.5:
            corners.append(waypoint)
    heading = rotation_from_quaternion(route.rotation[-1])[:2, 0]
    corners.append(corners[-1] + 2.0 * PATH_AHEAD_M[1] * heading / np.hypot(*heading))
    table = np.array(corners)
    return Path(table, distance_along(table), float(np.hypot(*(position_in_1s - position_now)[:2])))


#: Candidate positions for each false object; it is left out if none is allowed.
CANDIDATES = 128
#: s, for which the path of a false object should be free, and number of positions checked along it.
FREE_PATH_S, PATH_SAMPLES = 10.0, 8
#: A candidate is accepted at once if its free path allows this fraction of the drawn speed.
ACCEPTED_SPEED_FRACTION = 0.7
#: m/s, least speed of a false object: its velocity gives its heading.
SLOWEST_MPS = 1e-3
#: m, σ of the lateral offset from the ego's path.
LATERAL_STD_M = 0.3
#: m, half the width of a lane: maximum distance from the ego's path.
LANE_M = 1.75
#: Maximum speed of an object on the ego's path as a fraction of the ego's speed, so that the ego closes in.
MAX_SPEED_FRACTION = 0.5
#: m/s^2, limit of braking and accelerating; comfortable in traffic (Bae et al., 2019: 2 to 3).
MAX_ACCELERATION_MPS2 = 3.0
#: m, minimum length of a vehicle; vehicles have the heading of their lane.
VEHICLE_M = 2.5


@dataclass(frozen=True, slots=True)
class Shape:
    """False objects: σ of position (m, per axis) and velocity (m/s), and l w h (m).

    max_distance_m: m from the agent, for the region "paper";  class_id: index into CLASSES
    """

    position_std_m: float
    velocity_std_mps: float
    box: Floats
    max_distance_m: float = np.inf
    class_id: int = CLASS_INDEX["car"]


@dataclass(slots=True)
class _Candidates:
    """CANDIDATES poses (t, 3) m, (t,) rad of a false object, and its desired m/s."""

    position: Floats
    yaw: Floats
    speed: float


class Region(ABC):
    """Base class of regions for false objects."""

    #: Name of the region in a scenario.
    name: ClassVar[str]

    @abstractmethod
    def place(
        self, count: int, shape: Shape, real: ObjectStates, ground: float, coverage: Coverage, rng: np.random.Generator
    ) -> tuple[Floats, Floats]:
        """Position (k, 3) m and velocity (k, 3) m/s of k <= `count` objects.

        All are in the world frame. real: the objects that the victims see, in canonical order; ground: m, its z
        """

    def objects(
        self, count: int, shape: Shape, real: ObjectStates, ground: float, coverage: Coverage, rng: np.random.Generator
    ) -> ObjectStates:
        """The false objects at the places and with the velocities of `place`, which give their headings."""
        position, velocity = self.place(count, shape, real, ground, coverage, rng)
        return ObjectStates.of(
            position,
            velocity=velocity,
            size=np.tile(shape.box, (len(position), 1)),
            yaw=np.arctan2(velocity[:, 1], velocity[:, 0]),
            class_id=np.full(len(position), shape.class_id, np.uint8),
        )


class Paper(Region):
    """The paper's distribution: Gaussian about a victim, within a maximum distance.

    Coordinated: about any agent that the coordinator knows.
    """

    name = "paper"

    def place(
        self, count: int, shape: Shape, real: ObjectStates, ground: float, coverage: Coverage, rng: np.random.Generator
    ) -> tuple[Floats, Floats]:
        position = np.zeros((count, 3))
        velocity = np.zeros((count, 3))
        position[:, :2] = rng.normal(0.0, shape.position_std_m, (count, 2))
        velocity[:, :2] = rng.normal(0.0, shape.velocity_std_mps, (count, 2))
        if count:
            victims = np.array([view.position[:2] for view in coverage.victims])
            agents = victims if coverage.agents is None else coverage.agents[:, :2]
            chosen = agents[rng.integers(len(agents), size=count)]
            position[:, :2] = chosen + _within(position[:, :2], shape.position_std_m, shape.max_distance_m, rng)
        position[:, 2] = ground + shape.box[2] / 2.0
        return position, velocity


def _within(offset: Floats, std_m: float, max_m: float, rng: np.random.Generator) -> Floats:
    """Gaussian offsets (k, 2) m, those longer than `max_m` drawn again."""
    for _ in range(CANDIDATES):
        far = np.flatnonzero(np.hypot(offset[:, 0], offset[:, 1]) > max_m)
        if len(far) == 0:
            return offset
        offset[far] = rng.normal(0.0, std_m, (len(far), 2))
    length = np.maximum(np.hypot(offset[:, 0], offset[:, 1]), 1e-9)
    return offset * np.minimum(1.0, max_m / length)[:, None]


class _Checked(Region):
    """Places each object at the first allowed candidate pose with a free path."""

    def place(
        self, count: int, shape: Shape, real: ObjectStates, ground: float, coverage: Coverage, rng: np.random.Generator
    ) -> tuple[Floats, Floats]:
        placed, velocities = ObjectStates.empty(), list[Floats]()
        for stream in rng.spawn(count):
            candidates = self._candidates(shape, real, ground, coverage, stream)
            if candidates is None:
                continue
            boxes = _objects(candidates.position, candidates.yaw, shape.box)
            allowed = self._allowed(boxes, real, coverage) & ~touching(boxes, placed)
            chosen = self._choose(candidates, allowed.nonzero()[0], shape, coverage)
            if chosen is not None:
                row, speed = chosen
                velocity = speed * np.array([np.cos(candidates.yaw[row]), np.sin(candidates.yaw[row]), 0.0])
                velocities.append(velocity)
                heading = np.array([np.arctan2(velocity[1], velocity[0])])
                placed = concatenate([placed, _objects(candidates.position[row : row + 1], heading, shape.box)])
        return placed.position, np.array(velocities).reshape(-1, 3)

    @abstractmethod
    def _candidates(
        self, shape: Shape, real: ObjectStates, ground: float, coverage: Coverage, rng: np.random.Generator
    ) -> _Candidates | None:
        """Candidate poses for one object; None if there are none."""

    @abstractmethod
    def _allowed(self, boxes: ObjectStates, real: ObjectStates, coverage: Coverage) -> Bools:
        """(k,) whether boxes are in the region; `real` objects occlude what is behind them."""

    def _choose(
        self, candidates: _Candidates, allowed: np.ndarray, shape: Shape, coverage: Coverage
    ) -> tuple[int, float] | None:
        """Row and speed of the first allowed pose with the longest free path, or None."""
        rows = allowed[:16]
        if len(rows) == 0:
            return None
        stop = candidates.speed * FREE_PATH_S + candidates.speed**2 / (2.0 * MAX_ACCELERATION_MPS2)
        # First the distance of an object at SLOWEST_MPS, which every accepted pose must have ahead of it.
        steps = np.append(SLOWEST_MPS * FREE_PATH_S, stop * np.arange(1, PATH_SAMPLES + 1) / PATH_SAMPLES)
        yaw = np.repeat(candidates.yaw[rows], len(steps))
        offset = np.column_stack([np.cos(yaw), np.sin(yaw), np.zeros(len(yaw))]) * np.tile(steps, len(rows))[:, None]
        path = _objects(np.repeat(candidates.position[rows], len(steps), axis=0) + offset, yaw, shape.box)
        free = self._allowed(path, ObjectStates.empty(), coverage).reshape(len(rows), len(steps))
        rows, free = rows[free[:, 0]], free[free[:, 0], 1:]
        if len(rows) == 0:
            return None
        free_distance = np.where(free.all(axis=1), PATH_SAMPLES, np.argmin(free, axis=1)) * (stop / PATH_SAMPLES)
        speed = np.minimum(candidates.speed, max_speed_within(free_distance))
        accepted = (speed >= ACCEPTED_SPEED_FRACTION * candidates.speed).nonzero()[0]
        best = int(accepted[0]) if len(accepted) else int(np.argmax(speed))
        return int(rows[best]), max(float(speed[best]), SLOWEST_MPS)


class InView(_Checked):
    """In a victim's view, with the headings of nearby traffic.

    Outside buildings and other objects.

    The paper's distribution about the victim, restricted to its field of view.
    """

    name = "in_view"

    def _candidates(
        self, shape: Shape, real: ObjectStates, ground: float, coverage: Coverage, rng: np.random.Generator
    ) -> _Candidates | None:
        if not coverage.victims:
            return None
        victim = coverage.victims[int(rng.integers(len(coverage.victims)))].position
        position = np.full((CANDIDATES, 3), ground + shape.box[2] / 2.0)
        position[:, :2] = victim[:2] + rng.normal(0.0, shape.position_std_m, (CANDIDATES, 2))
        speed = float(np.hypot(*rng.normal(0.0, shape.velocity_std_mps, 2)))
        yaw = rng.uniform(-np.pi, np.pi, CANDIDATES)
        vehicles = (real.size[:, 0] >= VEHICLE_M).nonzero()[0]
        if len(vehicles):
            offset = position[:, None, :2] - real.position[None, vehicles, :2]
            nearest = vehicles[np.argmin((offset * offset).sum(axis=2), axis=1)]
            moving = np.hypot(real.velocity[nearest, 0], real.velocity[nearest, 1]) > 1.0
            yaw = np.where(moving, np.arctan2(real.velocity[nearest, 1], real.velocity[nearest, 0]), real.yaw[nearest])
        return _Candidates(position, yaw, speed)

    def _allowed(self, boxes: ObjectStates, real: ObjectStates, coverage: Coverage) -> Bools:
        visible = np.zeros(len(boxes), bool)
        for view in coverage.victims:
            visible |= coverage.visible_outside_objects(boxes, real, view)
        return visible


class VictimOnly(InView):
    """As InView, but outside the view of agents that could contradict the victim."""

    name = "victim_only"

    def _allowed(self, boxes: ObjectStates, real: ObjectStates, coverage: Coverage) -> Bools:
        visible = super()._allowed(boxes, real, coverage)
        rows = visible.nonzero()[0]
        table = np.concatenate([boxes.position, boxes.size], axis=1)
        for view in coverage.other_views():
            if len(rows) == 0:
                break
            rows = rows[~coverage.visible(view, table[rows])]
        result = np.zeros(len(boxes), bool)
        result[rows] = True
        return result


class Outnumbered(InView):
    """As InView, but where more victims than honest agents look: all of them together outvote those that could object.

    With a single victim this is where no honest agent looks.
    """

    name = "outnumbered"

    def _allowed(self, boxes: ObjectStates, real: ObjectStates, coverage: Coverage) -> Bools:
        victims = np.zeros(len(boxes), np.int64)
        for view in coverage.victims:
            victims += coverage.visible_outside_objects(boxes, real, view)
        return victims > coverage.honest_viewers(boxes, victims > 0)


class FewWitnesses(InView):
    """As InView, but where at most `most` honest agents look: with one, it is one agent's word against another's.

    most: number of honest agents, 0 or more
    """

    name = "few_witnesses"

    def __init__(self, most: int = 1) -> None:
        check("0 or more", most=most)
        self._most = most

    def _allowed(self, boxes: ObjectStates, real: ObjectStates, coverage: Coverage) -> Bools:
        visible = super()._allowed(boxes, real, coverage)
        return visible & (coverage.honest_viewers(boxes, visible) <= self._most)


class ManyWitnesses(InView):
    """As InView, but where at least `least` honest agents look: a lie that most viewers can contradict.

    least: number of honest agents, 1 or more
    """

    name = "many_witnesses"

    def __init__(self, least: int = 2) -> None:
        check("1 or more", least=least)
        self._least = least

    def _allowed(self, boxes: ObjectStates, real: ObjectStates, coverage: Coverage) -> Bools:
        visible = super()._allowed(boxes, real, coverage)
        return visible & (coverage.honest_viewers(boxes, visible) >= self._least)


class UnseenByEgo(InView):
    """As InView, but where the ego cannot see: out of its range or field of view, or behind buildings.

    In a picture (`Coverage.fused`), false objects need not be in a victim's view. An agent whose sensor is unknown
    has no blind area. What real objects hide is no part of it: they drive on.

    agent: name of the agent whose blind area it is; None: the ego
    """

    name = "unseen_by_ego"

    def __init__(self, agent: str | None = None) -> None:
        self._agent = agent

    def _allowed(self, boxes: ObjectStates, real: ObjectStates, coverage: Coverage) -> Bools:
        known = coverage.surroundings
        observer = known.ego_sensor if self._agent is None else known.sensors.get(self._agent)
        allowed = np.zeros(len(boxes), bool)
        if observer is None:
            return allowed
        for view in coverage.victims:
            allowed |= coverage.plausible(boxes, real, view)
        rows = allowed.nonzero()[0]
        allowed[rows[coverage.in_sight(observer, boxes.select(rows), ObjectStates.empty())]] = False
        return allowed


class EgoPath(_Checked):
    """In the ego's lane, ahead of it and slower, in a victim's view.

    Beyond the end of the known route the path continues straight.
    """

    name = "ego_path"

    def _candidates(
        self, shape: Shape, real: ObjectStates, ground: float, coverage: Coverage, rng: np.random.Generator
    ) -> _Candidates | None:
        path = path_ahead(coverage)
        if path is None:
            return None
        distance = rng.uniform(*PATH_AHEAD_M, CANDIDATES)
        lateral = rng.normal(0.0, LATERAL_STD_M, CANDIDATES)
        speed = float(np.hypot(*rng.normal(0.0, shape.velocity_std_mps, 2)))
        centre, yaw = path.at(distance)
        position = np.column_stack(
            [
                centre[:, 0] - lateral * np.sin(yaw),
                centre[:, 1] + lateral * np.cos(yaw),
                np.full(CANDIDATES, ground + shape.box[2] / 2.0),
            ]
        )
        return _Candidates(position, yaw, min(speed, MAX_SPEED_FRACTION * path.speed))

    def _allowed(self, boxes: ObjectStates, real: ObjectStates, coverage: Coverage) -> Bools:
        path = path_ahead(coverage)
        if path is None or not coverage.victims:
            return np.zeros(len(boxes), bool)
        visible = np.zeros(len(boxes), bool)
        for view in coverage.victims:
            visible |= coverage.plausible(boxes, real, view)
        return visible & (path.offset(boxes.position) <= LANE_M)


#: The regions by name.
REGIONS: dict[str, Region] = {
    region.name: region
    for region in (
        Paper(),
        InView(),
        EgoPath(),
        VictimOnly(),
        Outnumbered(),
        FewWitnesses(),
        ManyWitnesses(),
        UnseenByEgo(),
    )
}


def max_speed_within(distance: Floats) -> Floats:
    """Highest speeds (n,) m/s that allow FREE_PATH_S of driving and then braking.

    distance: (n,) m, available for both
    """
    b = MAX_ACCELERATION_MPS2
    speed: Floats = b * (np.sqrt(FREE_PATH_S**2 + 2.0 * distance / b) - FREE_PATH_S)
    return speed


def _objects(position: Floats, yaw: Floats, box: Floats) -> ObjectStates:
    return ObjectStates.of(position, yaw=yaw, size=np.tile(box, (len(position), 1)))
