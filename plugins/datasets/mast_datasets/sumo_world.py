"""The world of SUMO's traffic: what is there in each frame, and how driven cars move in it."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mast_datasets.sumo_files import type_of_class
from mast_datasets.sumo_lanes import HORIZON_M, Priority, StopLine, SumoLane, Way, way_from
from mast_datasets.sumo_simulation import Move, Present, SumoSimulation
from mast_zenoh.arrays.geometry import rotation_from_yaw, wrap_angle
from mast_zenoh.arrays.states import Floats, Ints
from mast_zenoh.driving.motion import Command, RouteAhead, drive
from mast_zenoh.errors import SceneError
from mast_zenoh.scenes.making.assembly import AgentPath, SceneBoxes
from mast_zenoh.scenes.making.observe import World
from mast_zenoh.scenes.making.sensor_types import SensorsByAgent, equip
from mast_zenoh.scenes.making.virtual_agents import roof_sensors
from mast_zenoh.scenes.recording import SceneAgent, truth_states
from mast_zenoh.scenes.stepped import SteppedWorld
from mast_zenoh.sensing import Detector

_WAY_M = 1000.0  # of a way that is planned at once, at least,
_FASTEST = 40.0  # m/s, and more for a car that drives as fast for long
_NAMED = 500_000_000  # ids from here on are of vehicles whose names are no such numbers


class Ride(NamedTuple):
    """Where a vehicle is going.

    way: its lanes;  front: m along them, of its front;  factor: of speed limits;  fastest: m/s, it can go
    """

    way: Way
    front: float
    factor: float
    fastest: float

    @property
    def lines(self) -> list[StopLine]:
        """Where the vehicle may have to stop soon."""
        return self.way.lines_ahead(self.front)


class Ways:
    """The ways of vehicles through the lanes of a network."""

    def __init__(self, simulation: SumoSimulation) -> None:
        self._simulation = simulation
        self._lanes: dict[str, SumoLane] = {}

    def keep_lanes(self, vehicle: str, duration_s: float) -> Ride | None:
        """Where a vehicle is going that does not change lanes from now on; None: not for so long."""
        lane, at, route, row, factor, fastest = self._simulation.car(vehicle)
        if not lane:
            return None
        way = way_from(lane, route[row + 1 :], at + max(_WAY_M, duration_s * min(fastest, _FASTEST)), self._lane)
        lasts = way.duration_s(at, factor, fastest) > duration_s
        return Ride(way, at, factor, fastest) if lasts and self._simulation.keep_lanes(vehicle, way.edges) else None

    def on(self, lane: str) -> Way:
        """The way from a lane on, straight on at forks."""
        return way_from(lane, (), _WAY_M, self._lane)

    def _lane(self, name: str) -> SumoLane:
        if name not in self._lanes:
            shape, limit, links = self._simulation.lane(name)
            self._lanes[name] = SumoLane(np.array(shape, np.float64)[:, :2], limit, [tuple(link) for link in links])
        return self._lanes[name]


class SumoSurroundings(NamedTuple):
    """What does not change while the traffic moves.

    name:    of the scene;  period_ns: ns, between two frames
    radius_m: m, around each agent, in which objects are there
    origin:  (2,) m, of the world, in the axes of the network
    poles:   agents that stand;  buildings, building_height: as in `Recording`; all in the world
    sensors: of agents, by name or pattern
    """

    name: str
    period_ns: int
    radius_m: float
    origin: Floats
    poles: Sequence[AgentPath]
    buildings: tuple[Floats, ...]
    building_height: Floats
    sensors: SensorsByAgent


class TrafficMoment(NamedTuple):
    """The objects of one frame, in the order of their ids, and the rows (c,) of those that are agents."""

    boxes: SceneBoxes
    cars: Ints


@dataclass
class _Driven:
    """A car that obeys commands.

    position: (2,) m, of its middle, in the axes of the network;  heading: rad;  speed: m/s
    """

    position: Floats
    heading: float
    speed: float

    def move(self, command: Command, duration_s: float) -> None:
        """Go on for `duration_s` s along a circle, with a constant acceleration until it stands."""
        end = max(self.speed + command.acceleration * duration_s, 0.0)
        stops = end == 0.0 and self.speed > 0.0
        distance = self.speed**2 / (2.0 * -command.acceleration) if stops else (self.speed + end) / 2.0 * duration_s
        zero = np.zeros(1)
        along, aside, turn = drive(zero, zero, np.array([distance]), np.array([command.curvature]), zero)
        ahead = _direction(self.heading)
        self.position = self.position + along[0] * ahead + aside[0] * np.array([-ahead[1], ahead[0]])
        self.heading = float(wrap_angle(self.heading + turn[0]))
        self.speed = end

    def front(self, length: float) -> Floats:
        """(2,) m, of its front. length: m, of the car"""
        return self.position + length / 2.0 * _direction(self.heading)


class SumoWorld(SteppedWorld):
    """SUMO's traffic, stepped from the first frame of a scene on.

    simulation: at that frame;  present: what is there then
    cars: vehicle of each agent that is one, by name of the agent, the ego first;  rides: where these are going
    steps, step_s: of a frame;  detector: of sensors without one of their own
    """

    def __init__(
        self,
        simulation: SumoSimulation,
        present: Present,
        cars: Mapping[str, str],
        rides: Mapping[str, Ride],
        surroundings: SumoSurroundings,
        *,
        steps: int,
        step_s: float,
        detector: Detector,
    ) -> None:
        self.detector, self.cars = detector, tuple(cars)
        self._simulation, self._ways, self._present = simulation, Ways(simulation), present
        self._vehicles, self._surroundings = dict(cars), surroundings
        self._steps, self._step_s = steps, step_s
        self._rides = dict(rides)
        self._driven: dict[str, _Driven] = {}
        self._priority: dict[str, Priority] = {}  # of cars with a driver
        self._ids: dict[str, int] = {}
        self._names: dict[int, str] = {}
        sensors = {name: roof_sensors(simulation.shapes[name].size[2]) for name in cars.values()}
        driven = [SceneAgent(car, "mobile", self._id(name), *sensors[name]) for car, name in cars.items()]
        self._agents = (*driven, *(pole.agent for pole in surroundings.poles))

    def close(self) -> None:
        self._simulation.close()

    def now(self) -> World:
        return self.world_of([self.moment()])

    def size(self, car: str) -> Floats:
        return np.array(self._simulation.shapes[self._vehicles[car]].size[:2])

    def step(self, commands: Mapping[str, Command]) -> None:
        for car in [car for car in self._driven if car not in commands]:
            del self._driven[car]
        moves, watched = [], {}
        for car, command in commands.items():
            if car not in self._driven:
                self._driven[car] = self._take_over(car)
            driven, places = self._driven[car], []
            length = float(self.size(car)[0])
            for _ in range(self._steps):
                driven.move(command, self._step_s)
                places.append((*driven.front(length).tolist(), 90.0 - float(np.degrees(driven.heading))))
            self._advance(car, driven.front(length), driven.speed)
            ride = self._rides[car]
            moves.append(Move(self._vehicles[car], *ride.way.lane_at(ride.front), places))
            if car in self._priority:
                watched[self._vehicles[car]] = [line.lane for line in ride.lines]
        self._present = self._simulation.step(self._steps, moves, watched)
        for car in self.cars:
            if car not in self._driven:
                row = self._row(car)
                self._advance(car, self._present.front[row], float(self._present.speed[row]))

    def _take_over(self, car: str) -> _Driven:
        """A car as it drives itself now."""
        row = self._row(car)
        heading = float(np.radians(90.0 - self._present.angle[row]))
        middle = self._present.front[row] - self.size(car)[0] / 2.0 * _direction(heading)
        return _Driven(middle, heading, float(self._present.speed[row]))

    def _advance(self, car: str, front: Floats, speed: float) -> None:
        """Go on with the ride of a car to its front (2,) m; near the end of what is planned, plan farther."""
        ride = self._rides[car]
        ride = ride._replace(front=ride.way.along(front, ride.front + speed * self._steps * self._step_s))
        if not ride.way.is_dead_end and ride.way.length - ride.front < 2.0 * HORIZON_M:
            row = ride.way.row_at(ride.front)
            way = self._ways.on(ride.way.lanes[row])
            self._simulation.keep_lanes(self._vehicles[car], way.edges)
            ride = ride._replace(way=way, front=ride.front - float(ride.way.start[row]))
        self._rides[car] = ride

    def route(self, car: str) -> RouteAhead:
        vehicle, length = self._vehicles[car], float(self.size(car)[0])
        driven, ride = self._driven.get(car), self._rides[car]
        speed = float(self._present.speed[self._row(car)]) if driven is None else driven.speed
        lines = ride.lines
        around = self._present.around.get(vehicle)
        foes, signals = around or self._simulation.around(vehicle, [line.lane for line in lines])
        speeds = dict(zip(self._present.names, self._present.speed.tolist(), strict=True))
        stop = self._priority.setdefault(car, Priority(self._steps * self._step_s)).stop(
            [(line, line.at - ride.front, state[line.link]) for line, state in zip(lines, signals, strict=True)],
            speed,
            length,
            [(foe, speeds.get(foe.name, 0.0)) for foe in foes],
        )
        if ride.way.is_dead_end and ride.way.length - ride.front < HORIZON_M:
            stop = min(stop, max(ride.way.length - ride.front, 0.0))
        position, limit = ride.way.ahead(max(ride.front - length / 2.0, 0.0))
        return RouteAhead(
            position - self._surroundings.origin, np.minimum(limit * ride.factor, ride.fastest), float(stop)
        )

    def _row(self, car: str) -> int:
        """The row of a car among what is there now."""
        if self._vehicles[car] not in self._present.names:
            place = f"{self._surroundings.name}: {self._vehicles[car]}, which is the agent {car}"
            raise SceneError(f"{place}, has left the network, expected it to drive on; choose another ego or start_s")
        return self._present.names.index(self._vehicles[car])

    def moment(self) -> TrafficMoment:
        """What is there in the present frame, around the agents."""
        present, surroundings = self._present, self._surroundings
        shapes = [self._simulation.shapes[name] for name in present.names]
        size = np.array([shape.size for shape in shapes])
        yaw, speed = np.radians(90.0 - present.angle), present.speed.copy()
        middle = present.front - np.where(present.person, 0.0, size[:, 0] / 2.0)[:, None] * _direction(yaw)
        rows = {car: self._row(car) for car in self.cars}
        for car, driven in self._driven.items():
            middle[rows[car]], yaw[rows[car]], speed[rows[car]] = driven.position, driven.heading, driven.speed
        middle = middle - surroundings.origin
        own = np.array(list(rows.values()))
        places = [*middle[own], *(pole.position[0, :2] for pole in surroundings.poles)]
        near = np.any([np.hypot(*(middle - place).T) <= surroundings.radius_m for place in places], axis=0)
        people = present.person.tolist()
        named = zip(present.names, people, strict=True)
        ids = np.array([self._id(f"person:{name}" if person else name) for name, person in named], np.int64)
        place = np.column_stack([middle, size[:, 2] / 2.0])
        class_id = np.array([type_of_class(shape.vehicle_class).class_id for shape in shapes], np.uint8)
        velocity = np.column_stack([speed[:, None] * _direction(yaw), np.zeros(len(yaw))])
        boxes = SceneBoxes(np.zeros(len(ids), np.int64), ids, place, size, wrap_angle(yaw), class_id, velocity)
        order = np.flatnonzero(near)
        boxes = boxes.select(order[np.argsort(ids[order])])
        return TrafficMoment(boxes, np.searchsorted(boxes.id, ids[own]))

    def _id(self, name: str) -> int:
        """The id of an object: its name if that is a number, and otherwise a digest of it.

        It does not depend on what happened before, so it is the same in the run without an attack.
        """
        if name not in self._ids:
            if re.fullmatch("0|[1-9][0-9]{0,8}", name):
                number = int(name)
            else:
                digest = hashlib.blake2b(name.encode(errors="surrogatepass"), digest_size=8).digest()
                number = _NAMED + int.from_bytes(digest) % _NAMED
            while number in self._names:
                number += 1
            self._ids[name], self._names[number] = number, name
        return self._ids[name]

    def world_of(self, moments: Sequence[TrafficMoment]) -> World:
        """The world of some frames, one after the other."""
        around, frames = self._surroundings, len(moments)
        columns = ("id", "position", "velocity", "size", "yaw", "class_id")
        truth = {name: np.concatenate([getattr(moment.boxes, name) for moment in moments]) for name in columns}
        cars = [boxes.select(rows) for boxes, rows in moments]
        middle = np.stack([each.position - each.size * np.array([[0.0, 0.0, 0.5]]) for each in cars])
        turns = np.array([[rotation_from_yaw(float(yaw)) for yaw in each.yaw] for each in cars])
        velocity = np.stack([each.velocity for each in cars])
        poles = [(pole.position, pole.rotation, np.zeros((1, 3))) for pole in around.poles]
        position, rotation, velocity = (
            np.concatenate([own, *(np.repeat(part[None, :1], frames, axis=0) for part in parts)], axis=1)
            for own, *parts in zip((middle, turns, velocity), *poles, strict=True)
        )
        times_ns = np.arange(frames, dtype=np.int64) * around.period_ns
        agents, rigs = equip(around.name, self._agents, around.sensors, times_ns, around.period_ns)
        return World(
            around.name,
            agents,
            around.period_ns,
            times_ns,
            truth_states(truth),
            np.cumsum([0, *(len(moment.boxes) for moment in moments)]),
            position,
            rotation,
            velocity,
            buildings=around.buildings,
            building_height=around.building_height,
            rigs=rigs,
        )


def _direction(angle: Floats | float) -> Floats:
    """(…, 2), along an angle rad, counter-clockwise from x."""
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)
