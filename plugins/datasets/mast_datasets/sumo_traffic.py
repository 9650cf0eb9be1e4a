"""Traffic that SUMO simulates while the scene is played: cars of it can be driven, and all others react to them."""

from __future__ import annotations

import contextlib
import hashlib
import importlib.util
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from mast_datasets.files import find_file
from mast_datasets.sumo_files import read_buildings
from mast_datasets.sumo_lanes import HORIZON_M, Priority, StopLine, SumoLane, Way, way_from
from mast_datasets.sumo_simulation import Present, SumoInputs, SumoSimulation, read_configuration
from mast_datasets.traffic import DataSetScene
from mast_zenoh.arrays.geometry import rotation_from_yaw, wrap_angle
from mast_zenoh.arrays.states import CLASS_INDEX, Floats, Ints
from mast_zenoh.driving.motion import Command, RouteAhead, drive
from mast_zenoh.errors import ConfigurationError, SceneError
from mast_zenoh.scenes.base import SteppedWorld
from mast_zenoh.scenes.making.assembly import MAX_POLES, AgentPath, SceneBoxes, poles, roof_sensors
from mast_zenoh.scenes.making.observe import World, detect, lidar_visibility, make_recording
from mast_zenoh.scenes.making.sensor_types import SensorsByAgent, equip
from mast_zenoh.scenes.recording import Recording, SceneAgent, truth_states
from mast_zenoh.sensing import Detector
from mast_zenoh.streams import stream

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
        lane, at, route, row, factor, fastest = self._simulation.ask("car", vehicle)
        if not lane:
            return None
        way = way_from(lane, route[row + 1 :], at + max(_WAY_M, duration_s * min(fastest, _FASTEST)), self._lane)
        lasts = way.duration_s(at, factor, fastest) > duration_s
        return (
            Ride(way, at, factor, fastest) if lasts and self._simulation.ask("keep_lanes", vehicle, way.edges) else None
        )

    def on(self, lane: str) -> Way:
        """The way from a lane on, straight on at forks."""
        return way_from(lane, (), _WAY_M, self._lane)

    def _lane(self, name: str) -> SumoLane:
        if name not in self._lanes:
            shape, limit, links = self._simulation.ask("lane", name)
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
            moves.append((self._vehicles[car], *ride.way.lane_at(ride.front), places))
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
            self._simulation.ask("keep_lanes", self._vehicles[car], way.edges)
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
        class_id = np.array([shape.class_id for shape in shapes], np.uint8)
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


_WARM_UP_S = 200.0
_WINDOW_S = 15.0
_NEAR_M = 50.0  # an ego has others this near,
_MOVING_MPS = 1.0  # and moves at least as fast
_POLES = 4
_ROUTE_POINTS = 200  # 1 m apart, of the ego's way, along which poles stand
SUFFIXES = (".sumocfg", ".sumo.cfg")


@dataclass(kw_only=True, eq=False)
class SumoTraffic(DataSetScene):
    """Traffic that SUMO simulates, step by step, so that cars of it can be driven. See docs/how-to-scenes.md#sumo.

    path:              of SUMO's configuration (.sumocfg), or of a folder with a single one
    start_s:           time of the first frame, of SUMO's clock; None: 200 s after the configuration's beginning
    ego:               name of the vehicle that is the ego; None: the moving car with the most others that move within
                       50 m
    radius_m:          objects are there while they are within this distance of an agent, 20 to 2000
    building_height_m: of the outlines of buildings without a height
    n_infrastructure:  poles along the ego's way, 0 to 16; None: 4
    n_mobile:          cars with a lidar besides the ego, the ones nearest to it, those that move first; None: 0
    rate_hz:           frames per second, 1 to 20, of whole milliseconds
    scale:             factor of the traffic's demand; None: that of the configuration
    sensors:           lists of dict(type=…) by agent or pattern, see `Sensor`; None: a lidar each

    Agents are cars that can follow their lanes for long enough; they never change lanes. The seed decides about SUMO's
    random numbers and the detections. The world is flat: heights of the network are left out. `record` makes 150 frames
    by default at 10 Hz. Raises ConfigurationError if SUMO is not installed.
    """

    files = (("*.sumocfg", "!*fcd*.xml*", "!*fcd*.csv*"), ("*.sumo.cfg", "!*fcd*.xml*", "!*fcd*.csv*"))

    start_s: float | None = None
    ego: str | int | None = None
    radius_m: float = 150.0
    building_height_m: float = 12.0
    rate_hz: float = 10.0
    scale: float | None = None
    sensors: SensorsByAgent | None = None

    def __post_init__(self) -> None:
        self.check(start_s=(0.0, 1e7), radius_m=(20.0, 2000.0), building_height_m=(0.1, 1000.0), rate_hz=(1.0, 20.0))
        self.check(scale=(0.0, 100.0), n_infrastructure=(0, MAX_POLES), n_mobile=(0, 10_000))
        if 1000.0 * self._steps()[1] % 1.0 > 1e-6:
            expected = "expected one whose frames last whole milliseconds, such as 10"
            raise ConfigurationError(f"SumoTraffic: rate_hz is {self.rate_hz}, {expected}")

    @classmethod
    def recognises(cls, path: Path) -> bool:
        return super().recognises(path) or (path.is_file() and path.name.endswith(SUFFIXES))

    def inputs(self) -> Sequence[Path]:
        """The configuration, its files, and SUMO."""
        inputs = read_configuration(self._configuration())
        spec = importlib.util.find_spec("libsumo")
        return (inputs.path, *inputs.files, *([Path(spec.origin)] if spec and spec.origin else []))

    def record(self, seed: int, frames: int | None) -> Recording:
        frames = self._frames(frames)
        with contextlib.closing(self.world(seed, frames)) as world:
            moments = [world.moment()]
            for _ in range(frames - 1):
                world.step({})
                moments.append(world.moment())
        whole = world.world_of(moments)
        points = lidar_visibility(whole)
        return make_recording(whole, points, *detect(whole, points, self.detector, seed))

    def _frames(self, frames: int | None) -> int:
        frames = round(_WINDOW_S * self.rate_hz) if frames is None else frames
        if frames < 1:
            raise ConfigurationError(f"{self.path}: {frames} frames, expected at least 1")
        return frames

    def _steps(self) -> tuple[int, float]:
        """Steps of SUMO in a frame, and the length of one, s."""
        steps = int(np.ceil(10.0 / self.rate_hz - 1e-9))
        return steps, 1.0 / (self.rate_hz * steps)

    def _configuration(self) -> Path:
        return find_file(self.root, "configurations of SUMO", lambda file: file.name.endswith(SUFFIXES))

    def world(self, seed: int, frames: int | None) -> SumoWorld:
        frames = self._frames(frames)
        inputs = read_configuration(self._configuration())
        if self.scale is not None:
            inputs = inputs._replace(options={**inputs.options, "scale": f"{self.scale:g}"})
        steps, step_s = self._steps()
        number = int(stream(seed, "sumo").integers(2**31 - 1))
        simulation = SumoSimulation(inputs, number, round(step_s * 1000))
        try:
            start_s = inputs.begin_s + _WARM_UP_S if self.start_s is None else self.start_s
            if start_s < inputs.begin_s:
                expected = f"expected {inputs.begin_s:g} or more: SUMO begins then"
                raise ConfigurationError(f"{inputs.path}: start_s is {start_s:g}, {expected}")
            if start_s > inputs.begin_s:
                simulation.ask("advance", start_s)
            present = simulation.step(0)
            duration_s = max(_WINDOW_S, frames / self.rate_hz)
            cars, rides = self._choose(simulation, present, duration_s, f"{inputs.path}: at {start_s:g} s")
            around = self._surroundings(inputs, simulation, present, cars["ego"], rides["ego"])
            chosen = simulation, present, cars, rides, around
            return SumoWorld(*chosen, steps=steps, step_s=step_s, detector=self.detector)
        except BaseException:
            simulation.close()
            raise

    def _choose(
        self, simulation: SumoSimulation, present: Present, duration_s: float, place: str
    ) -> tuple[dict[str, str], dict[str, Ride]]:
        """The vehicles that are agents, and where they are going, by name of the agent: the ego, then those near it."""
        ways = Ways(simulation)
        cars = [row for row, name in enumerate(present.names) if not present.person[row] and _is_car(simulation, name)]
        moves = present.speed > _MOVING_MPS
        wanted = [row for row in cars if present.names[row] == str(self.ego)]
        if self.ego is None:
            company = {row: int((moves & (_distance(present, row) < _NEAR_M)).sum()) for row in cars}
            wanted = sorted(cars, key=lambda row: (not moves[row], -company[row], row))
        expected = f"expected a car that drives on for {duration_s:g} s"
        found = ((row, ways.keep_lanes(present.names[row], duration_s)) for row in wanted)
        ego, ride = next(((row, ride) for row, ride in found if ride), (-1, None))
        if ride is None and self.ego is not None:
            some = ", ".join(present.names[row] for row in cars[:10]) or "there is none"
            raise ConfigurationError(f"{place}: ego is {self.ego!r}, {expected}; the cars are {some}")
        if ride is None:
            raise SceneError(f"{place}: found {len(cars)} cars, {expected}; choose another start_s")
        names, rides = {"ego": present.names[ego]}, {"ego": ride}
        distance, count = _distance(present, ego), self.n_mobile or 0
        for row in sorted(cars, key=lambda row: (not moves[row], float(distance[row]), row)):
            name = f"mobile_{len(names)}"
            if len(names) <= count and row != ego and (ride := ways.keep_lanes(present.names[row], duration_s)):
                names[name], rides[name] = present.names[row], ride
        if len(names) <= count:
            most = f"{len(names) - 1}: so many cars besides the ego drive on for {duration_s:g} s"
            raise ConfigurationError(f"{place}: n_mobile is {count}, expected 0 to {most}")
        return names, rides

    def _surroundings(
        self, inputs: SumoInputs, simulation: SumoSimulation, present: Present, ego: str, ride: Ride
    ) -> SumoSurroundings:
        """What does not change: poles and buildings along the ego's way."""
        row = present.names.index(ego)
        yaw = np.radians(90.0 - present.angle[row])
        origin = present.front[row] - simulation.shapes[ego].size[0] / 2.0 * np.array([np.cos(yaw), np.sin(yaw)])
        first = min(int(ride.front), len(ride.way.position) - 2)
        route = ride.way.position[first : first + _ROUTE_POINTS] - origin
        direction = np.diff(route, axis=0)
        heading = np.arctan2(direction[:, 1], direction[:, 0])
        count = _POLES if self.n_infrastructure is None else self.n_infrastructure
        placed = poles(_NO_BOXES, route, np.append(heading, heading[-1:]), count)
        beside = route + origin
        outlines, heights = read_buildings(inputs.additional, beside, self.radius_m, self.building_height_m)
        return SumoSurroundings(
            inputs.path.name.partition(".")[0],
            round(1e9 / self.rate_hz),
            self.radius_m,
            origin,
            placed,
            tuple(outline - origin for outline in outlines),
            np.array(heights, np.float64),
            self.sensors or {},
        )


def _is_car(simulation: SumoSimulation, name: str) -> bool:
    return simulation.shapes[name].class_id == CLASS_INDEX["car"]


def _distance(present: Present, row: int) -> Floats:
    """(n,) m, of all from the one in a row."""
    return np.asarray(np.hypot(*(present.front - present.front[row]).T))


#: For poles: the ground is at 0.
_NO_BOXES = SceneBoxes.throughout(0, np.zeros((0, 3)), np.ones(3), np.zeros(0), 0)
