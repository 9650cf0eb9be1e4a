"""What attackers know of the scene: buildings, sensors and routes, and what the agents cover.

None of it comes from the truth of a run: an attacker can survey buildings and sensors, and can follow the vehicles of a
fleet on their usual routes. docs/explanation-threat-model.md lists what it knows and what it does not.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mast_zenoh.arrays.geometry import rotation_from_quaternion
from mast_zenoh.arrays.matching import neighbours
from mast_zenoh.arrays.states import Bools, Floats, Ints, ObjectStates
from mast_zenoh.kernels import kernel
from mast_zenoh.sensing.raycast import Walls
from mast_zenoh.sensing.sensors import sensor_pose
from mast_zenoh.tracking.tracks import overlap
from mast_zenoh.tracking.view import SensorView

#: m; range of an unknown sensor.
UNKNOWN_RANGE_M = 70.0


@dataclass(frozen=True, slots=True, eq=False)
class Route:
    """An agent's pose over time; a single row for a stationary agent.

    time_s:   (k,) s since the start of the scene, ascending
    position: (k, 3) m, world frame
    rotation: (k, 4) active quaternions w x y z, agent to world
    """

    time_s: Floats
    position: Floats
    rotation: Floats

    @classmethod
    def of_rows(cls, rows: Sequence[Sequence[float]]) -> Route:
        """The route of k rows [time, x, y, z, w, x, y, z]."""
        table = np.asarray(rows, np.float64).reshape(-1, 8)
        return cls(table[:, 0], table[:, 1:4], table[:, 4:])

    def at(self, time_s: float) -> tuple[Floats, Floats]:
        """Position (3,) m and rotation (3, 3) at a time.

        The position is interpolated linearly, the rotation comes from the last row up to `time_s`.
        """
        row = max(0, int(self.time_s.searchsorted(time_s + 1e-9, side="right")) - 1)
        return self.position_at(time_s), rotation_from_quaternion(self.rotation[row])

    def position_at(self, time_s: float) -> Floats:
        """Position (3,) m at `time_s`, interpolated linearly."""
        if len(self.time_s) == 1:
            return np.array(self.position[0])
        return np.array([np.interp(time_s, self.time_s, self.position[:, axis]) for axis in range(3)])

    def time_near(self, position: Floats) -> float:
        """s, to 0.1 s the first time at which the route is nearest to a position (>= 2,) m in the bird's-eye view."""
        times = np.arange(self.time_s[0], self.time_s[-1] + 1e-9, 0.1)
        offset = [np.interp(times, self.time_s, self.position[:, axis]) - position[axis] for axis in (0, 1)]
        return float(times[np.hypot(*offset).argmin()])


@dataclass(frozen=True, slots=True, eq=False)
class AgentSensor:
    """One agent's sensor: field of view, mount and the agent's route.

    azimuth, elevation: (2,) rad, lowest and highest, in the sensor frame
    max_range_m:        m
    mount_position:     (3,) m, of the sensor in the agent's frame
    mount_rotation:     (3, 3), active, sensor to agent
    """

    azimuth: tuple[float, float]
    elevation: tuple[float, float]
    max_range_m: float
    mount_position: Floats
    mount_rotation: Floats
    route: Route

    @classmethod
    def of_json(cls, data: Mapping[str, Any]) -> AgentSensor:
        """The sensor of one entry of `Surroundings.agents`."""
        low, high, down, up = np.radians(data["limits_deg"]).tolist()
        return cls(
            (low, high),
            (down, up),
            float(data["max_range_m"]),
            np.asarray(data["mount_position"], np.float64),
            np.asarray(data["mount_rotation"], np.float64).reshape(3, 3),
            Route.of_rows(data["route"]),
        )

    def view(self, agent_position: Floats, agent_rotation: Floats) -> SensorView:
        """The field of view for an agent's pose: (3,) m, (3, 3)."""
        position, rotation = sensor_pose(agent_position, agent_rotation, self.mount_position, self.mount_rotation)
        return SensorView(position, rotation, *self.azimuth, *self.elevation, self.max_range_m)


class Surroundings:
    """An attacker's prior knowledge of the scene, shared by all adversaries.

    Immutable.

    scene:           name of the scene; part of the random streams, so that two scenes with the same seed differ
    agents:          by name, {"limits_deg": [azimuth from, to, elevation from, to], "max_range_m", "mount_position",
                     "mount_rotation", "route": rows [s, x, y, z, w, x, y, z]}; the ego first. "further", by name:
                     the first four of each of its other sensors
    victims:         names of the compromised agents
    buildings:       outlines, each (k, 2) m, world frame, closed without repeating the first corner
    building_height: z of each building's top, m

    Without buildings (most data sets) there is no occlusion by walls. Without agents, a victim's sensor is assumed to
    cover a full circle of UNKNOWN_RANGE_M.
    """

    def __init__(
        self,
        *,
        scene: str = "",
        agents: Mapping[str, Any] | None = None,
        victims: tuple[str, ...] = (),
        buildings: list[Any] | None = None,
        building_height: list[Any] | None = None,
    ) -> None:
        self.scene = scene
        self.victims = victims
        self.sensors = {name: AgentSensor.of_json(data) for name, data in (agents or {}).items()}
        outlines = tuple(np.asarray(outline, np.float64) for outline in buildings or ())
        if len(outlines) != len(building_height or ()):
            raise ValueError(f"building_height: found {len(building_height or ())} values, expected {len(outlines)}")
        self._further = {
            f"{name}/{sensor}": AgentSensor.of_json({**data, **more})
            for name, data in (agents or {}).items()
            for sensor, more in data.get("further", {}).items()
        }
        self.walls = Walls.of_buildings(outlines, np.asarray(building_height or (), np.float64))
        self._first_wall = np.cumsum([0, *map(len, outlines)])[:-1].astype(np.int64)

    @property
    def ego_sensor(self) -> AgentSensor | None:
        """The sensor and route of the ego, the first agent; None without agents."""
        return next(iter(self.sensors.values()), None)

    def view(self, agent: str, position: Floats, rotation: Floats) -> SensorView:
        """The field of view of an agent with this pose: (3,) m, (3, 3). agent: its name, or agent/sensor"""
        sensor = self._further.get(agent) or self.sensors.get(agent)
        return unlimited(position) if sensor is None else sensor.view(position, rotation)

    def other_views(self, time_s: float) -> list[SensorView]:
        """Fields of view of all agents that are not compromised, at their route positions."""
        return [
            sensor.view(*sensor.route.at(time_s)) for name, sensor in self.sensors.items() if name not in self.victims
        ]

    def other_positions(self, time_s: float) -> Floats:
        """(k, 3) m route positions of all agents that are not compromised."""
        others = [sensor.route.position_at(time_s) for name, sensor in self.sensors.items() if name not in self.victims]
        return np.array(others).reshape(-1, 3)

    def nearest_agent(self, names: Iterable[str], position: Floats, time_s: float) -> str | None:
        """The agent, of these names, whose route is nearest to a position (>= 2,) m at a time; None: none is known."""
        routes = {name: self.sensors[name].route for name in names if name in self.sensors}
        distance = [float(np.hypot(*(route.position_at(time_s) - position)[:2])) for route in routes.values()]
        return list(routes)[int(np.argmin(distance))] if distance else None

    def inside_buildings(self, positions: Floats) -> Bools:
        """(n,) whether positions (n, >= 2) m are inside a building in the bird's-eye view."""
        return inside_outlines(positions, self.walls.start, self.walls.end, self._first_wall)

    def behind_walls(self, origin: Floats, positions: Floats) -> Bools:
        """(n,) whether a wall is between `origin` (3,) m and positions (n, >= 3) m."""
        return occluded_by_walls(origin, positions, self.walls.start, self.walls.end, self.walls.top)


@kernel
def inside_outlines(positions: Floats, start: Floats, end: Floats, first: Ints) -> Bools:
    """Positions (n, >= 2) m inside one of o outlines.

    start, end: (w, 2) m, sides of the outlines; first: (o,) first side of each
    """
    if len(first) == 0:
        return np.zeros(len(positions), bool)
    x, y = positions[:, 0, None], positions[:, 1, None]
    (x0, y0), (x1, y1) = start.T, end.T
    rise = np.where(y1 == y0, 1.0, y1 - y0)
    crosses = ((y0 > y) != (y1 > y)) & (x < x0 + (x1 - x0) * (y - y0) / rise)
    odd = np.add.reduceat(crosses.astype(np.int64), first, axis=1) % 2
    return np.asarray(odd.any(axis=1))


@kernel
def occluded_by_walls(origin: Floats, positions: Floats, start: Floats, end: Floats, top: Floats) -> Bools:
    """(n,) whether a wall is between `origin` (3,) and positions (n, >= 3).

    start, end: (w, 2) m, of walls; top: (w,) m, z of their upper edges
    """
    offset, span = start - origin[:2], end - start
    sight = positions[:, :2] - origin[:2]
    cross = sight[:, 0, None] * span[:, 1] - sight[:, 1, None] * span[:, 0]
    cross[cross == 0.0] = np.nan  # parallel: never crosses
    along_sight = (offset[:, 0] * span[:, 1] - offset[:, 1] * span[:, 0]) / cross
    along_wall = (offset[:, 0] * sight[:, 1, None] - offset[:, 1] * sight[:, 0, None]) / cross
    height = origin[2] + along_sight * (positions[:, 2, None] - origin[2])
    hides = (along_sight > 0.0) & (along_sight < 1.0) & (along_wall >= 0.0) & (along_wall <= 1.0)
    return np.asarray((hides & (height <= top)).any(axis=1))


#: The default, without any knowledge.
UNKNOWN = Surroundings()


def unlimited(position: Floats) -> SensorView:
    """A view of a full circle of UNKNOWN_RANGE_M around `position` (3,) m."""
    return SensorView(position, np.eye(3), -np.pi, np.pi, -np.pi / 2, np.pi / 2, UNKNOWN_RANGE_M)


#: Least visible fraction of a box in view, see `SensorView.visible_fraction`.
IN_VIEW = 0.5
#: m; road users whose centres are farther apart do not overlap.
TOUCH_M = 20.0
_NO_OCCLUDERS = np.zeros((0, 6))


@dataclass(frozen=True, slots=True, eq=False)
class Coverage:
    """Fields of view of the agents at one time.

    surroundings: the attacker's prior knowledge
    victims:      fields of view of the compromised agents
    time_s:       s since the start of the scene
    fused:        the objects on the wire come from several agents (a picture) and need not be in a victim's view
    ego_tracks:   the ego's own tracks, world frame, if an adversary intercepts them; None: unknown
    agents:       (k, 3) m, all agents that the attacker knows, compromised or not; None: the victims' sensors
    """

    surroundings: Surroundings
    victims: tuple[SensorView, ...]
    time_s: float
    fused: bool = False
    ego_tracks: ObjectStates | None = None
    agents: Floats | None = None

    def visible(self, view: SensorView, boxes: Floats, occluders: Floats = _NO_OCCLUDERS) -> Bools:
        """Boxes (k, 6) x y z l w h in a view, not occluded by walls or objects (n, 6)."""
        visible = view.visible_fraction(boxes, occluders) >= IN_VIEW
        if visible.any():
            rows = visible.nonzero()[0]
            visible[rows] = ~self.surroundings.behind_walls(view.position, boxes[rows, :3])
        return np.asarray(visible)

    def visible_outside_objects(
        self, false_objects: ObjectStates, real_objects: ObjectStates, view: SensorView
    ) -> Bools:
        """(k,) whether false objects are visible, outside buildings and real objects."""
        boxes = boxes_of(false_objects)
        return self.visible(view, boxes, boxes_of(real_objects)) & self._free(boxes, false_objects, real_objects)

    def plausible(self, false_objects: ObjectStates, real_objects: ObjectStates, view: SensorView) -> Bools:
        """(k,) whether false objects are plausible for the victim; see `fused`."""
        return (
            self._free(boxes_of(false_objects), false_objects, real_objects)
            if self.fused
            else self.visible_outside_objects(false_objects, real_objects, view)
        )

    def other_views(self) -> list[SensorView]:
        """Fields of view of the agents that are known and not compromised."""
        return self.surroundings.other_views(self.time_s)

    def honest_viewers(
        self, objects: ObjectStates, wanted: Bools | None = None, occluders: Floats = _NO_OCCLUDERS
    ) -> Ints:
        """(k,) number of agents that are not compromised and look at each object, past walls and occluders (n, 6).

        wanted: (k,) for which objects, the others count as seen by nobody
        """
        rows = np.arange(len(objects)) if wanted is None else wanted.nonzero()[0]
        boxes, counts = boxes_of(objects)[rows], np.zeros(len(objects), np.int64)
        for view in self.other_views():
            counts[rows] += self.visible(view, boxes, occluders)
        return counts

    def in_sight(self, observer: AgentSensor, objects: ObjectStates, occluders: ObjectStates) -> Bools:
        """(k,) whether an agent on its route sees objects, past walls and other objects.

        observer: its sensor; occluders: n objects, which may be among the k
        """
        view = observer.view(*observer.route.at(self.time_s))
        return self.visible(view, boxes_of(objects), boxes_of(occluders))

    def _free(self, boxes: Floats, false_objects: ObjectStates, real_objects: ObjectStates) -> Bools:
        return np.asarray(~self.surroundings.inside_buildings(boxes) & ~touching(false_objects, real_objects))


def boxes_of(states: ObjectStates) -> Floats:
    """Boxes (n, 6) x y z l w h, m."""
    return np.concatenate([states.position, states.size], axis=1)


def touching(false_objects: ObjectStates, real_objects: ObjectStates) -> Bools:
    """(k,) whether each of k objects overlaps one of n others in the bird's-eye view."""
    touches = np.zeros(len(false_objects), bool)
    i, j, dx, dy = neighbours(false_objects.position, real_objects.position, np.full(len(false_objects), TOUCH_M))
    if len(i):
        offset = np.column_stack([dx, dy])
        overlapping = overlap(
            offset,
            false_objects.size.take(i, 0),
            false_objects.yaw.take(i),
            real_objects.size.take(j, 0),
            real_objects.yaw.take(j),
            1.0,
        )
        touches[i[overlapping]] = True
    return touches
