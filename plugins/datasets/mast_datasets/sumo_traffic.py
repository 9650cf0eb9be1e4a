"""Traffic that SUMO simulates while the scene is played: cars of it can be driven, and all others react to them."""

from __future__ import annotations

import contextlib
import importlib.util
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mast_datasets.files import find_file
from mast_datasets.sumo_files import read_buildings, type_of_class
from mast_datasets.sumo_simulation import Present, SumoInputs, SumoSimulation, read_configuration
from mast_datasets.sumo_world import Ride, SumoSurroundings, SumoWorld, Ways
from mast_datasets.traffic import DataSetScene
from mast_zenoh.arrays.states import CLASS_INDEX, Floats
from mast_zenoh.errors import ConfigurationError, SceneError
from mast_zenoh.scenes.making.assembly import SceneBoxes
from mast_zenoh.scenes.making.observe import detect, lidar_visibility, make_recording
from mast_zenoh.scenes.making.sensor_types import SensorsByAgent
from mast_zenoh.scenes.making.virtual_agents import MAX_POLES, poles
from mast_zenoh.scenes.recording import Recording
from mast_zenoh.scenes.stepped import SteppedWorld
from mast_zenoh.streams import stream

_WARM_UP_S = 200.0
_WINDOW_S = 15.0
_NEAR_M = 50.0  # an ego has others this near,
_MOVING_MPS = 1.0  # and moves at least as fast
_POLES = 4
_ROUTE_POINTS = 200  # 1 m apart, of the ego's way, along which poles stand
SUFFIXES = (".sumocfg", ".sumo.cfg")


@dataclass(kw_only=True, eq=False)
class SumoTraffic(DataSetScene):
    """Traffic that SUMO simulates, step by step, so that cars of it can be driven. See docs/scenes_sumo.md.

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
        with contextlib.closing(self._world(seed, frames)) as world:
            moments = [world.moment()]
            for _ in range(frames - 1):
                world.step({})
                moments.append(world.moment())
        whole = world.world_of(moments)
        points = lidar_visibility(whole)
        return make_recording(whole, points, *detect(whole, points, self.detector, seed))

    def world(self, seed: int, frames: int | None) -> SteppedWorld:
        return self._world(seed, self._frames(frames))

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

    def _world(self, seed: int, frames: int) -> SumoWorld:
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
                simulation.advance(start_s)
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
    return type_of_class(simulation.shapes[name].vehicle_class).class_id == CLASS_INDEX["car"]


def _distance(present: Present, row: int) -> Floats:
    """(n,) m, of all from the one in a row."""
    return np.asarray(np.hypot(*(present.front - present.front[row]).T))


#: For poles: the ground is at 0.
_NO_BOXES = SceneBoxes.throughout(0, np.zeros((0, 3)), np.ones(3), np.zeros(0), 0)
