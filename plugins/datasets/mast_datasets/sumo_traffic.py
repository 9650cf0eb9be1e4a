"""Traffic that SUMO simulates while the scene is played: cars of it can be driven, and all others react to them."""

from __future__ import annotations

import importlib.util
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mast_datasets.sumo_files import read_buildings, type_of_class
from mast_datasets.sumo_inputs import SumoInputs, read_configuration
from mast_datasets.sumo_simulation import Present, SumoSimulation
from mast_datasets.sumo_world import SumoWorld, Surroundings, Ways
from mast_datasets.traffic import DataSetScene
from mast_zenoh.arrays.states import CLASS_INDEX, Floats
from mast_zenoh.errors import ConfigurationError, SceneError
from mast_zenoh.scenes.making.assembly import Boxes
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

    Agents are cars that have far enough to go. The seed decides about SUMO's random numbers and the detections. The
    world is flat: heights of the network are left out. `record` makes 150 frames by default at 10 Hz. Raises
    ConfigurationError if SUMO is not installed.
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
        self.check(
            start_s=(0.0, 1e7),
            radius_m=(20.0, 2000.0),
            building_height_m=(0.1, 1000.0),
            rate_hz=(1.0, 20.0),
            scale=(0.0, 100.0),
            n_infrastructure=(0, MAX_POLES),
            n_mobile=(0, 10_000),
        )
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
        world = self._world(seed, frames)
        try:
            moments = [world.moment()]
            for _ in range(frames - 1):
                world.step({})
                moments.append(world.moment())
        finally:
            world.close()
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
        if not self.root.exists():
            raise SceneError(f"{self.root}: no such file or folder")
        if self.root.is_file():
            return self.root
        found = sorted(file for file in self.root.iterdir() if file.name.endswith(SUFFIXES))
        if len(found) != 1:
            names = ", ".join(file.name for file in found[:10]) or "none"
            raise SceneError(f"{self.root}: found {len(found)} configurations of SUMO ({names}), expected one")
        return found[0]

    def _world(self, seed: int, frames: int) -> SumoWorld:
        inputs = read_configuration(self._configuration())
        if self.scale is not None:
            inputs = replace(inputs, options={**inputs.options, "scale": f"{self.scale:g}"})
        steps, step_s = self._steps()
        number = int(stream(seed, "sumo").integers(2**31 - 1))
        simulation = SumoSimulation(inputs, number, round(step_s * 1000))
        try:
            start_s = inputs.begin_s + _WARM_UP_S if self.start_s is None else self.start_s
            if start_s < inputs.begin_s:
                raise ConfigurationError(
                    f"{inputs.path}: start_s is {start_s:g}, expected {inputs.begin_s:g} or more: SUMO begins then"
                )
            if start_s > inputs.begin_s:
                simulation.advance(start_s)
            present = simulation.step(0)
            duration_s = max(_WINDOW_S, frames / self.rate_hz)
            cars = self._choose(simulation, present, duration_s, f"{inputs.path}: at {start_s:g} s")
            surroundings = self._surroundings(inputs, simulation, present, cars["ego"])
            return SumoWorld(
                simulation, present, cars, surroundings, steps=steps, step_s=step_s, detector=self.detector
            )
        except BaseException:
            simulation.close()
            raise

    def _choose(self, simulation: SumoSimulation, present: Present, duration_s: float, place: str) -> dict[str, str]:
        """The vehicles that are agents, by name of the agent: the ego, then those nearest to it."""
        cars = [row for row, name in enumerate(present.names) if not present.person[row] and _is_car(simulation, name)]
        names = [present.names[row] for row in cars]
        fit = [row for row, far in zip(cars, _drives_on(simulation, names, duration_s), strict=True) if far]
        moving = [row for row in fit if present.speed[row] > _MOVING_MPS] or fit
        expected = f"expected a car that drives on for {duration_s:g} s"
        if self.ego is not None:
            chosen = [row for row in fit if present.names[row] == str(self.ego)]
            if not chosen:
                some = ", ".join(present.names[row] for row in moving[:10]) or "there is none"
                raise ConfigurationError(f"{place}: ego is {self.ego!r}, {expected}, such as {some}")
            ego = chosen[0]
        elif not moving:
            raise SceneError(f"{place}: found {len(cars)} cars, {expected}; choose another start_s")
        else:
            others_move = present.speed > _MOVING_MPS
            company = [int((others_move & (_distance(present, row) < _NEAR_M)).sum()) for row in moving]
            ego = moving[int(np.argmax(company))]
        others = [row for row in fit if row != ego]
        count = self.n_mobile or 0
        if count > len(others):
            raise ConfigurationError(
                f"{place}: n_mobile is {count}, expected 0 to {len(others)}: so many cars besides the ego drive on for "
                f"{duration_s:g} s"
            )
        distance = _distance(present, ego)
        nearest = sorted(others, key=lambda row: (row not in moving, float(distance[row]), present.names[row]))[:count]
        return {"ego": present.names[ego]} | {
            f"mobile_{k}": present.names[row] for k, row in enumerate(nearest, start=1)
        }

    def _surroundings(self, inputs: SumoInputs, simulation: SumoSimulation, present: Present, ego: str) -> Surroundings:
        """What does not change: poles and buildings along the ego's way."""
        row = present.names.index(ego)
        yaw = np.radians(90.0 - present.angle[row])
        origin = present.front[row] - simulation.shapes[ego].size[0] / 2.0 * np.array([np.cos(yaw), np.sin(yaw)])
        way, front, *_ = Ways(simulation).ride(ego)
        first = min(int(front), len(way.position) - 2)
        route = way.position[first : first + _ROUTE_POINTS] - origin
        direction = np.diff(route, axis=0)
        heading = np.arctan2(direction[:, 1], direction[:, 0])
        count = _POLES if self.n_infrastructure is None else self.n_infrastructure
        placed = poles(_NO_BOXES, route, np.append(heading, heading[-1:]), count)
        beside = route + origin
        outlines, heights = read_buildings(inputs.additional, beside, self.radius_m, self.building_height_m)
        return Surroundings(
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


def _drives_on(simulation: SumoSimulation, names: Sequence[str], duration_s: float) -> list[bool]:
    """Whether the rest of each vehicle's route takes longer than a duration, as fast as it can."""
    cars = simulation.cars(names)
    edges = sorted({edge for _, _, route, row, _, _ in cars for edge in route[row:]})
    known = dict(zip(edges, simulation.edges(edges), strict=True))
    far = []
    for _, at, route, row, factor, fastest in cars:
        parts = [known[edge] for edge in route[row:]]
        speeds = [min(limit * factor, fastest) for _, limit in parts]
        seconds = sum(length / speed for (length, _), speed in zip(parts, speeds, strict=True) if speed > 0.0)
        far.append(bool(speeds) and seconds - at / max(speeds[0], 0.1) > duration_s + 1.0)
    return far


#: For poles: the ground is at 0.
_NO_BOXES = Boxes(
    frame=np.zeros(0, np.int64),
    id=np.zeros(0, np.int64),
    position=np.zeros((0, 3)),
    size=np.zeros((0, 3)),
    yaw=np.zeros(0),
    class_id=np.zeros(0, np.uint8),
)
