"""A generated scene: a signalised junction with buildings, traffic, an ego and poles.

Cars that are parked in bays between the kerb and the pavement of a generated junction.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from mast_zenoh.arrays.geometry import rotation_from_yaw, rotation_from_yaw_pitch
from mast_zenoh.arrays.states import CLASS_INDEX, Bools, Floats, Ints, ObjectStates
from mast_zenoh.errors import ConfigurationError
from mast_zenoh.scenes.base import Scene, SteppedWorld
from mast_zenoh.scenes.generated.driven import DrivenTraffic, JunctionWorld
from mast_zenoh.scenes.generated.junction import PAVEMENT, PAVEMENT_END, REACH, ROAD, Arm, arms_of, corners, plan
from mast_zenoh.scenes.generated.traffic import LaneNetwork, Motion, Movers, Traffic, road_users, with_differing_drivers
from mast_zenoh.scenes.making.assembly import POLE_HEIGHT_M, POLE_PITCH_DEG, roof_sensors
from mast_zenoh.scenes.making.observe import World, detect, lidar_visibility, make_recording
from mast_zenoh.scenes.making.sensor_types import SensorsByAgent, equip
from mast_zenoh.scenes.recording import Recording, SceneAgent, truth_states
from mast_zenoh.sensing import Camera, DetectionModel, Detector, LidarSensor
from mast_zenoh.streams import stream

_GAP = 3.0  # m, between two buildings


def rows_of_buildings(arms: tuple[Arm, ...], random: np.random.Generator) -> tuple[tuple[Floats, ...], Floats]:
    """Outlines, each (4, 2) m, and heights (B,) m, of rows along every arm.

    The rows have a random density and are on both sides of every arm.
    No building overlaps a road, a pavement or another building.
    """
    occupied = [
        _rectangle(arm, 0.0, REACH + 60.0, -arm.half_width - PAVEMENT, arm.half_width + PAVEMENT) for arm in arms
    ]
    outlines: list[Floats] = []
    heights: list[float] = []
    for a, arm in enumerate(arms):
        for side, mouth in ((1.0, corners(arms, a, PAVEMENT)[0]), (-1.0, corners(arms, a - 1, PAVEMENT)[-1])):
            direction = np.array([np.cos(arm.angle), np.sin(arm.angle)])
            x = float(mouth @ direction) + random.uniform(0.5, 5.0)
            density = random.uniform(0.7, 1.0)  # fraction of this side that is built on
            while x < PAVEMENT_END:
                length, depth = random.uniform(10.0, 26.0), random.uniform(9.0, 18.0)
                front = arm.half_width + PAVEMENT + random.choice([0.5, 0.5, 4.0])
                height, is_built = random.choice([4.5, 7.5, 10.5, 13.5, 19.5]), random.random() < density
                low, high = sorted((side * front, side * (front + depth)))
                outline = _rectangle(arm, x, x + length, low, high)
                if not is_built:
                    x += length
                elif not any(_overlap(outline, other) for other in occupied):
                    occupied.append(_rectangle(arm, x - _GAP, x + length + _GAP, low - _GAP, high + _GAP))
                    outlines.append(outline)
                    heights.append(float(height))
                    x += length + random.choice([_GAP, _GAP, 9.0])
                else:
                    x += 4.0
    return tuple(outlines), np.array(heights)


def _rectangle(arm: Arm, x_low: float, x_high: float, y_low: float, y_high: float) -> Floats:
    return arm.world(np.array([[x_low, y_low], [x_high, y_low], [x_high, y_high], [x_low, y_high]]))


def _overlap(one: Floats, other: Floats) -> bool:
    """Whether two convex outlines overlap: no side of either separates them."""
    for outline in (one, other):
        side = np.roll(outline, -1, axis=0) - outline
        normal = np.stack([-side[:, 1], side[:, 0]])
        first, second = one @ normal, other @ normal
        if np.any((first.max(axis=0) <= second.min(axis=0)) | (second.max(axis=0) <= first.min(axis=0))):
            return False
    return True


_DETECTOR = DetectionModel()
_WARM_UP_S = 60.0  # until queues and gaps have formed
_SEARCH_S = 45.0  # range of start times, searched for one in which the ego crosses the junction
_WINDOW_S = 15.0  # duration considered when choosing the ego
_POLES = 4
_VEHICLES = 21  # at least, so that up to 20 agents besides the ego add none
#: Of a dense junction: vehicles that drive, relative to the usual number, and at least.
_DENSER, _DENSE_VEHICLES = 1.2, 26
#: Parked cars, at least, and fewest and most vehicles with them: a junction with few lanes has more of them.
_PARKED, _WITH_PARKED = 5, (36, 46)
#: Where poles stand at each arm: m behind the stop line, and the side of the road; those of up to 24 poles come first.
_POLE_SITES = (
    *((8.0, 1.0), (24.0, -1.0), (40.0, 1.0), (56.0, -1.0), (72.0, 1.0), (88.0, -1.0)),
    *((8.0, -1.0), (24.0, 1.0), (40.0, -1.0), (56.0, 1.0), (72.0, -1.0), (88.0, 1.0)),
    *((setback, side) for setback in (16.0, 32.0, 48.0, 64.0, 80.0) for side in (1.0, -1.0)),
)
#: Directions of the arms before they are bent, degrees, and by how much they are.
_KINDS = {
    "cross": ((0.0, 90.0, 180.0, 270.0), 9.0),
    "tee": ((0.0, 90.0, 180.0), 8.0),
    "wye": ((0.0, 120.0, 240.0), 10.0),
}


@dataclass(kw_only=True, eq=False)
class Intersection(Scene):
    """A signalised junction of about 200 x 200 m; needs no data.

    scene_index:      which junction (arms, lanes, buildings, traffic density): 0, 1, 2, …
    n_infrastructure: poles with a lidar 15 m up, looking 30 degrees down, up to 22 at each of the 3 or 4 arms; the
                      first stand near the stop lines; None: 4
    n_mobile:         additional agents among the motor vehicles, as many as fit: at the first five junctions up to
                      84, 102, 84, 55 and 100; None: 0
    n_vehicles:       motor vehicles that drive, including the ego; None: depends on the junction, about 30, or as many
                      as n_mobile needs
    n_bicycles, n_pedestrians: None: depends on the junction
    dense:            whether drivers differ, some follow closely and react late, cars are parked beside the roads, and
                      there is more traffic; False: equal drivers, about 20 vehicles
    rate_hz:          frames per second
    detector:         the model that generates detections from lidar visibility
    sensors:          lists of dict(type=…) by agent or pattern, see `Sensor`; None: a lidar each

    `record` makes 150 frames by default at 10 Hz. The seed determines the traffic and the detections, never the
    junction; the number of agents affects neither, except that more than 25 mobile ones besides the ego may need more
    vehicles. Raises ConfigurationError if there is no room for these.
    """

    short_name = "intersection"
    short_argument = "scene_index"

    scene_index: int = 0
    n_infrastructure: int | None = None
    n_mobile: int | None = None
    n_vehicles: int | None = None
    n_bicycles: int | None = None
    n_pedestrians: int | None = None
    dense: bool = True
    rate_hz: float = 10.0
    detector: Detector = _DETECTOR
    sensors: SensorsByAgent | None = None

    def __post_init__(self) -> None:
        if self.n_infrastructure is None:  # scenes with equal recordings are equal
            self.n_infrastructure = _POLES
        self.n_mobile, self.sensors = self.n_mobile or 0, self.sensors or {}
        sites = len(_POLE_SITES) * len(_KINDS[_kind(self.scene_index)][0])
        limits = {"scene_index": None, "n_infrastructure": sites}
        for name, limit in (limits | dict.fromkeys(("n_mobile", "n_bicycles", "n_pedestrians"))).items():
            value = getattr(self, name) or 0
            if value < 0 or (limit is not None and value > limit):
                expected = "0 or more" if limit is None else f"0 to {limit}"
                raise ConfigurationError(f"Intersection: {name} is {value}, expected {expected}")
        least = 1 + (self.n_mobile or 0)
        if self.n_vehicles is not None and self.n_vehicles < least:
            raise ConfigurationError(
                f"Intersection: n_vehicles is {self.n_vehicles}, expected {least} or more: the ego and n_mobile"
            )
        if not 1.0 <= self.rate_hz <= 100.0:
            raise ConfigurationError(f"Intersection: rate_hz is {self.rate_hz}, expected 1 to 100")

    def record(self, seed: int, frames: int | None) -> Recording:
        site = self._site(seed)
        motion, _, motorised = self._drive(site, seed, frames)
        world = self._world(site, motion, motorised)
        points = lidar_visibility(world)
        return make_recording(world, points, *detect(world, points, self.detector, seed))

    def world(self, seed: int, frames: int | None) -> SteppedWorld:
        site = self._site(seed)
        _, start, motorised = self._drive(site, seed, frames)
        traffic = DrivenTraffic(site.junction.network, site.movers, seed, f"intersection/{self.scene_index}")
        traffic.release()
        steps, step_s = _steps(self.rate_hz)
        traffic.run(round(_WARM_UP_S * self.rate_hz) + start, steps, step_s)

        first: World | None = None  # its agents and their sensors are those of all frames

        def snapshot(motion: Motion) -> World:
            nonlocal first
            if first is None:
                first = self._world(site, motion, motorised)
                return first
            return replace(self._unequipped(site, motion, motorised, first.agents), rigs=first.rigs)

        return JunctionWorld(traffic, _names(motorised), snapshot, self.detector, steps=steps, step_s=step_s)

    def _site(self, seed: int) -> _Site:
        """The junction and its road users."""
        junction = _junction(self.scene_index)
        vehicles = junction.vehicles
        usual = (round(_DENSER * vehicles), _DENSE_VEHICLES) if self.dense else (vehicles, _VEHICLES)
        counts = (
            self._count("n_vehicles", max(*usual, 1 + (self.n_mobile or 0))),
            self._count("n_bicycles", junction.bicycles),
            self._count("n_pedestrians", junction.pedestrians),
        )
        return _site(self.scene_index, counts, seed, self.dense)

    def _unequipped(
        self, site: _Site, motion: Motion, motorised: list[int], agents: tuple[SceneAgent, ...] | None = None
    ) -> World:
        """The scene without visibility and detections. agents: None: with the usual sensors"""
        return world_of_motion(
            f"intersection-{self.scene_index}",
            round(1e9 / self.rate_hz),
            np.concatenate([site.movers.size, site.parked.size]),
            [*site.kinds, *["car"] * len(site.parked.yaw)],
            motion.with_standing(site.parked.position, site.parked.yaw),
            motorised,
            _poles(site.junction, _POLES if self.n_infrastructure is None else self.n_infrastructure),
            site.junction.buildings,
            agents,
        )

    def _world(self, site: _Site, motion: Motion, motorised: list[int]) -> World:
        """The scene without visibility and detections, with the sensors of its agents."""
        world = self._unequipped(site, motion, motorised)
        agents, rigs = equip(world.name, world.agents, self.sensors or {}, world.times_ns, world.period_ns)
        return replace(world, agents=agents, rigs=rigs)

    def _count(self, name: str, default: int) -> int:
        configured: int | None = getattr(self, name)
        return default if configured is None else configured

    def _drive(self, site: _Site, seed: int, frames: int | None) -> tuple[Motion, int, list[int]]:
        """The motion in the recorded frames, the first of them after the warm-up, and the agents among the vehicles."""
        frames = round(_WINDOW_S * self.rate_hz) if frames is None else frames
        if frames < 1:
            raise ConfigurationError(f"Intersection: {frames} frames, expected at least 1")
        motion, start, motorised = _motion(site, f"intersection/{self.scene_index}", seed, frames, self.rate_hz)
        return motion, start, motorised[: 1 + (self.n_mobile or 0)]


@dataclass(frozen=True, eq=False)
class _Junction:
    """What no seed changes. buildings: outlines and heights; vehicles, bicycles, pedestrians: usual numbers"""

    arms: tuple[Arm, ...]
    network: LaneNetwork
    buildings: tuple[tuple[Floats, ...], Floats]
    vehicles: int
    bicycles: int
    pedestrians: int


@lru_cache(maxsize=8)
def _junction(scene_index: int) -> _Junction:
    """The junction of a number."""
    layout = stream(scene_index, "intersection")
    arms = _arms(scene_index, layout)
    density = layout.uniform(3.2, 4.8)  # motor vehicles per lane
    network = LaneNetwork.of(plan(arms), green_s=float(layout.uniform(11.0, 16.0)), red_s=2.0)
    buildings = rows_of_buildings(arms, layout)
    vehicles = round(sum(arm.lanes for arm in arms) * density)
    return _Junction(arms, network, buildings, vehicles, int(layout.integers(3, 7)), int(layout.integers(7, 14)))


@dataclass(frozen=True, eq=False)
class _Site:
    """A junction and its road users; kinds: class name of each mover; parked: cars beside the roads."""

    junction: _Junction
    movers: Movers
    kinds: list[str]
    parked: ParkedCars


@lru_cache(maxsize=8)
def _site(scene_index: int, counts: tuple[int, int, int], seed: int, dense: bool) -> _Site:
    """A junction and its road users. counts: vehicles that drive, bicycles, pedestrians"""
    junction = _junction(scene_index)
    random = stream(seed, "intersection", scene_index, "movers")
    movers, kinds = road_users(
        junction.network, dict(zip(("vehicle", "bicycle", "pedestrian"), counts, strict=True)), random
    )
    parked, random = 0, stream(seed, "intersection", scene_index, "parked")
    if dense:
        movers = with_differing_drivers(movers, stream(seed, "intersection", scene_index, "drivers"))
        parked = max(_PARKED, int(random.integers(*_WITH_PARKED, endpoint=True)) - counts[0])
    return _Site(junction, movers, kinds, parked_cars(junction.arms, random, parked))


def _steps(rate_hz: float) -> tuple[int, float]:
    """Steps of the traffic in a frame, and the length of a step, s."""
    steps = int(np.ceil(10.0 / rate_hz - 1e-9))
    return steps, 1.0 / (rate_hz * steps)


@lru_cache(maxsize=8)  # a stepped scene needs it again after it was prepared
def _motion(site: _Site, name: str, seed: int, frames: int, rate_hz: float) -> tuple[Motion, int, list[int]]:
    """The motion in the recorded frames, the first of them after the warm-up, and the vehicles.

    The ego comes first, and the others by their distance from the junction.
    """
    movers, network = site.movers, site.junction.network
    traffic = Traffic(network, movers, seed, name)
    steps, dt = _steps(rate_hz)
    traffic.run(round(_WARM_UP_S * rate_hz), steps, dt)
    window, search = round(_WINDOW_S * rate_hz), round(_SEARCH_S * rate_hz)
    # The choice depends only on the window, so that a shorter recording is the start of a longer one.
    motion = traffic.run(search + max(window, frames), steps, dt)
    motorised = np.flatnonzero(movers.user == ROAD)
    cars = motorised[movers.size_class[motorised] == 0]
    start, ego = _choose_ego(network, motion.frames(slice(search + window)), cars, window)
    motion = motion.frames(slice(start, start + frames))
    distance = np.hypot(*np.moveaxis(motion.position[:window, motorised], -1, 0)).mean(axis=0)
    others = [int(row) for row in motorised[np.argsort(distance, kind="stable")] if row != ego]
    return motion, start, [ego, *others]


def _names(motorised: list[int]) -> dict[str, int]:
    """The mover of each agent that is a motor vehicle, by name."""
    return {"ego" if k == 0 else f"mobile_{k}": row for k, row in enumerate(motorised)}


def _kind(scene_index: int) -> str:
    """The kind of a junction."""
    return ("cross", "tee", "cross", "cross", "wye")[scene_index % 5]


def _arms(scene_index: int, random: np.random.Generator) -> tuple[Arm, ...]:
    """Four arms, or three as a T or a Y, with random rotation, angles and widths."""
    degrees, bend = _KINDS[_kind(scene_index)]
    angles = np.array(degrees) + random.uniform(-bend, bend, len(degrees)) + random.uniform(0.0, 360.0)
    main, cross = int(random.choice([1, 2, 2, 3])), int(random.choice([1, 1, 2]))
    return arms_of(list(np.radians(angles)), [main, cross, main, cross][: len(degrees)])


def _choose_ego(network: LaneNetwork, motion: Motion, cars: Ints, window: int) -> tuple[int, int]:
    """The first frame and the ego, a moving car that crosses the junction."""
    crossing: Bools = network.origin[motion.path[:, cars]] >= 0
    travelled = np.concatenate([np.zeros((1, len(cars))), np.cumsum(motion.speed[:, cars], axis=0)])
    starts = np.arange(0, len(motion.speed) - window + 1, 5)
    best: tuple[float, int, int] | None = None
    for start in starts:
        inside = crossing[start : start + window]
        crossing_frame = (inside * np.arange(window)[:, None]).sum(axis=0) / np.maximum(inside.sum(axis=0), 1)
        # Best: crosses at 60 % of the window and travels far; cars that do not cross come last.
        score = travelled[start + window] - travelled[start]
        score = (
            score / travelled[-1].max(initial=1e-9) - np.abs(crossing_frame / window - 0.6) - 10.0 * ~inside.any(axis=0)
        )
        k = int(score.argmax())
        if best is None or score[k] > best[0]:
            best = float(score[k]), int(start), int(cars[k])
    assert best is not None
    return best[1], best[2]


class _Pole(NamedTuple):
    """position: (3,) m, world frame; rotation: (3, 3) active, of the pole"""

    position: Floats
    rotation: Floats


@lru_cache(maxsize=8)
def _poles(junction: _Junction, count: int) -> list[_Pole]:
    """The poles, which face the centre.

    They are on pavements, those nearest the stop lines first.
    """
    arms, positions = junction.arms, []
    for setback, side in _POLE_SITES:
        local = [np.array([[arm.stop + setback, side * (arm.half_width + 1.2)]]) for arm in arms]
        positions += [arm.world(point)[0] for arm, point in zip(arms, local, strict=True)]
    pitch = np.radians(POLE_PITCH_DEG)
    return [
        _Pole(np.array([x, y, POLE_HEIGHT_M]), rotation_from_yaw_pitch(float(np.arctan2(-y, -x)), pitch))
        for x, y in positions[:count]
    ]


def world_of_motion(
    name: str,
    period_ns: int,
    sizes: Floats,
    classes: list[str],
    motion: Motion,
    motorised: list[int],
    poles: list[_Pole],
    buildings: tuple[tuple[Floats, ...], Floats],
    agents: tuple[SceneAgent, ...] | None,
) -> World:
    """A scene's truth and its agents, flat ground at z = 0.

    sizes: (n, 3) m, classes: of the n objects of the motion; motorised: rows of the ego and of the other cars that are
    agents; buildings: outlines and heights; agents: None: with the usual sensors
    """
    frames, n = motion.yaw.shape
    heights = sizes[:, 2]
    if agents is None:
        cars = [
            SceneAgent(car, "mobile", row, *roof_sensors(float(heights[row]))) for car, row in _names(motorised).items()
        ]
        sensors = [(LidarSensor.infrastructure(), Camera(mount_position=np.zeros(3))) for _ in poles]
        agents = (*cars, *(SceneAgent(f"infra_{k + 1}", "static", -1, *each) for k, each in enumerate(sensors)))

    position = np.zeros((frames, len(agents), 3))
    rotation = np.zeros((frames, len(agents), 3, 3))
    velocity = np.zeros((frames, len(agents), 3))
    heading = np.stack([np.cos(motion.yaw), np.sin(motion.yaw), np.zeros_like(motion.yaw)], axis=-1)
    mover_velocity = heading * motion.speed[..., None]
    for k, row in enumerate(motorised):
        position[:, k, :2] = motion.position[:, row]
        rotation[:, k] = [rotation_from_yaw(float(yaw)) for yaw in motion.yaw[:, row]]
        velocity[:, k] = mover_velocity[:, row]
    for k, pole in enumerate(poles, start=len(motorised)):
        position[:, k], rotation[:, k] = pole
    centre = np.concatenate([motion.position, np.broadcast_to(heights[:, None] / 2, (frames, n, 1))], axis=-1)
    truth: ObjectStates = truth_states(
        {
            "id": np.tile(np.arange(n, dtype=np.int64), frames),
            "position": centre.reshape(-1, 3),
            "velocity": mover_velocity.reshape(-1, 3),
            "size": np.tile(sizes, (frames, 1)),
            "yaw": (motion.yaw.reshape(-1) + np.pi) % (2 * np.pi) - np.pi,
            "class_id": np.tile(np.array([CLASS_INDEX[name] for name in classes], np.uint8), frames),
        }
    )
    return World(
        name=name,
        agents=agents,
        period_ns=period_ns,
        times_ns=np.arange(frames, dtype=np.int64) * period_ns,
        truth=truth,
        truth_start=np.arange(frames + 1, dtype=np.int64) * n,
        agent_position=position,
        agent_rotation=rotation,
        agent_velocity=velocity,
        buildings=buildings[0],
        building_height=buildings[1],
    )


#: m, from the stop line to the middle of the first bay, and between two; poles stand in between, every 8 m.
_FIRST_BAY, _BAY = 12.0, 8.0
#: m, from the centre of the junction to the end of the last bay: beyond, lanes spread towards the turning loops.
_LAST_BAY = 100.0
#: m, from the kerb to the side of a car; pedestrians walk 2.25 m from the kerb and farther.
_TO_KERB = 0.1
#: (l, w, h) m of the smallest and the largest car.
_SMALLEST, _LARGEST = (3.8, 1.65, 1.4), (5.0, 1.95, 1.9)
_AGAINST_TRAFFIC = 0.1  # share of the cars that face oncoming traffic


@dataclass(frozen=True, eq=False)
class ParkedCars:
    """p cars that never move. position: (p, 2) m, centres, yaw: (p,) rad, size: (p, 3) m; world frame"""

    position: Floats
    yaw: Floats
    size: Floats


def parked_cars(arms: tuple[Arm, ...], random: np.random.Generator, count: int) -> ParkedCars:
    """`count` cars, or as many as there are bays, parked along the arms; some kerbs are fuller than others."""
    bays, weight = [], []
    for arm in arms:
        for side in (1.0, -1.0):
            fullness = random.uniform(0.2, 1.0)
            for along in np.arange(arm.stop + _FIRST_BAY, _LAST_BAY - _BAY / 2, _BAY):
                bays.append((arm, side, float(along)))
                weight.append(fullness)
    share = np.array(weight) / np.sum(weight)
    chosen = np.sort(random.choice(len(bays), size=min(count, len(bays)), replace=False, p=share))
    low, high = np.array(_SMALLEST), np.array(_LARGEST)
    size = np.round(low + (high - low) * random.random((len(chosen), 3)), 2)
    shift, turn = random.uniform(-0.5, 0.5, len(chosen)), random.normal(0.0, np.radians(1.0), len(chosen))
    against = random.random(len(chosen)) < _AGAINST_TRAFFIC
    position, yaw = np.zeros((len(chosen), 2)), np.zeros(len(chosen))
    for k, bay in enumerate(chosen):
        arm, side, along = bays[bay]
        beside = side * (arm.half_width + _TO_KERB + size[k, 1] / 2)
        position[k] = arm.world(np.array([[along + shift[k], beside]]))[0]
        # Lanes with a positive offset lead towards the centre.
        yaw[k] = arm.angle + np.pi * ((side > 0) ^ against[k]) + np.clip(turn[k], *np.radians([-2.0, 2.0]))
    return ParkedCars(position, yaw, size)
