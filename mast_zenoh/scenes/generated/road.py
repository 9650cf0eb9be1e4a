"""A generated scene: a straight road on which an ego comes up to a vehicle that a collaborating car sees, too."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from mast_zenoh.arrays.geometry import rotation_from_yaw
from mast_zenoh.arrays.states import CLASS_INDEX, Floats
from mast_zenoh.driving.motion import Command, RouteAhead, drive
from mast_zenoh.errors import ConfigurationError, nearest
from mast_zenoh.scenes.base import Scene, SteppedWorld
from mast_zenoh.scenes.making.assembly import roof_sensors
from mast_zenoh.scenes.making.observe import World, detect, lidar_visibility, make_recording
from mast_zenoh.scenes.recording import Recording, SceneAgent, truth_states
from mast_zenoh.sensing import DetectionModel, Detector
from mast_zenoh.streams import stream

#: m/s of the ego, and of the vehicle and the collaborator in the case "cut_in"; m, width of a lane.
EGO_MPS, SLOW_MPS, LANE_M = 25.0 / 3.6, 9.0 / 3.6, 3.5
#: s, after which the ego is as far from the others as the case says: trackers begin before.
BEGINS_S = 2.0
#: Ids of the ego, the vehicle that it comes up to, and the collaborator; and their length, width and height, m.
EGO, TARGET, COLLABORATOR = range(3)
_SIZE = np.array([[4.9, 1.84, 1.49], [4.7, 1.85, 1.44], [4.2, 1.83, 1.35]])
_PERIOD_NS, _PERIOD_S, _FRAMES, _HORIZON_M = 100_000_000, 0.1, 150, 80
_DETECTOR = DetectionModel()


@dataclass(kw_only=True, eq=False)
class StraightRoad(Scene):
    """A straight road with two lanes: a slow vehicle beside the ego's lane, or one that stands in it.

    After the closed loop of PosePert (arXiv 2605.01301; zqzqz/PosePert 3c95189 and 4c58d7f, carla_demo): a lidar on the
    ego and on a collaborating car, mobile_1. "cut_in": the vehicle drives in the other lane at 9 km/h, 16 m ahead of
    the ego, which drives at 25 km/h; the collaborator follows it 8 m behind. "leader": the vehicle stands 45 m ahead, 1
    m from the middle of the ego's lane; the collaborator stands in the other lane, 8 m ahead. There, roads differ in
    their place on a map, and by up to 5 m and 0.15 m; here, by these lengths, drawn for each seed, and in the side of
    the other lane. Terraces along the road let views know what is free.

    case:     "cut_in" or "leader"
    detector: the model that generates detections from lidar visibility
    """

    short_name = "road"
    short_argument = "case"

    case: Literal["cut_in", "leader"]
    detector: Detector = _DETECTOR

    def __post_init__(self) -> None:
        if self.case not in ("cut_in", "leader"):
            expected = nearest(str(self.case), ("cut_in", "leader"))
            raise ConfigurationError(f"StraightRoad: case: found {self.case!r}{expected}")

    def world(self, seed: int, frames: int | None) -> RoadWorld:
        draws = stream(seed, "road", self.case)
        side, ahead_m = float(draws.choice([-1.0, 1.0])), float(draws.uniform(-5.0, 5.0))
        if self.case == "cut_in":
            target_m, collaborator_m, speed, aside = 16.0 + ahead_m, 8.0 + ahead_m, SLOW_MPS, LANE_M
        else:
            target_m, collaborator_m, speed, aside = 45.0 + ahead_m, 8.0, 0.0, 1.0 + float(draws.uniform(-0.15, 0.15))
        closed_m = BEGINS_S * (EGO_MPS - speed)
        return RoadWorld(
            f"road-{self.case}",
            np.array([0.0, target_m + closed_m, collaborator_m + closed_m]),
            side * np.array([0.0, aside, LANE_M]),
            np.array([EGO_MPS, speed, speed]),
            self.detector,
        )

    def record(self, seed: int, frames: int | None) -> Recording:
        count = _FRAMES if frames is None else frames
        if count < 1:
            raise ConfigurationError(f"StraightRoad: {count} frames, expected at least 1")
        stepped, states = self.world(seed, count), []
        for _ in range(count):
            states.append(stepped.state())
            stepped.step({})
        world = stepped.world_of(np.stack(states))
        points = lidar_visibility(world)
        return make_recording(world, points, *detect(world, points, self.detector, seed))


class RoadWorld(SteppedWorld):
    """The road along x, stepped: the ego can be driven, the others keep their speed.

    along: (3,) m, offset: (3,) m to the left of the ego's lane, speed: (3,) m/s, of the ego, the target, the
    collaborator
    """

    cars = ("ego",)

    def __init__(self, name: str, along: Floats, offset: Floats, speed: Floats, detector: Detector) -> None:
        self.detector, self._name = detector, name
        self._along, self._offset, self._speed, self._turn = along, offset, speed, np.zeros(3)
        self._agents = tuple(
            SceneAgent(car, "mobile", row, *roof_sensors(float(_SIZE[row, 2])))
            for car, row in (("ego", EGO), ("mobile_1", COLLABORATOR))
        )
        ends = np.array([[-60.0, 10.0], [300.0, 10.0], [300.0, 20.0], [-60.0, 20.0]])
        self._terraces = (ends, ends - np.array([0.0, 30.0]))

    def state(self) -> Floats:
        """(3, 4) along and offset, m, heading, rad, and speed, m/s, of each car now."""
        return np.stack([self._along, self._offset, self._turn, self._speed], axis=1)

    def now(self) -> World:
        return self.world_of(self.state()[None])

    def world_of(self, states: Floats) -> World:
        """The world of f frames. states: (f, 3, 4), see `state`"""
        frames = len(states)
        along, offset, turn, speed = np.moveaxis(states, 2, 0)
        heading = np.stack([np.cos(turn), np.sin(turn), np.zeros_like(turn)], axis=-1)
        ground = np.stack([along, offset, np.zeros_like(along)], axis=-1)
        velocity, rows = heading * speed[..., None], [agent.object_id for agent in self._agents]
        truth = {
            "id": np.tile(np.arange(3), frames),
            "position": (ground + [0.0, 0.0, 0.5] * _SIZE).reshape(-1, 3),
            "velocity": velocity.reshape(-1, 3),
            "size": np.tile(_SIZE, (frames, 1)),
            "yaw": turn.reshape(-1),
            "class_id": np.full(3 * frames, CLASS_INDEX["car"], np.uint8),
        }
        return World(
            name=self._name,
            agents=self._agents,
            period_ns=_PERIOD_NS,
            times_ns=np.arange(frames, dtype=np.int64) * _PERIOD_NS,
            truth=truth_states(truth),
            truth_start=np.arange(frames + 1, dtype=np.int64) * 3,
            agent_position=ground[:, rows],
            agent_rotation=np.array([[rotation_from_yaw(float(yaw)) for yaw in row] for row in turn[:, rows]]),
            agent_velocity=velocity[:, rows],
            buildings=self._terraces,
            building_height=np.full(2, 8.0),
        )

    def route(self, car: str) -> RouteAhead:
        ahead = self._along[EGO] + np.arange(_HORIZON_M + 1.0)
        return RouteAhead(np.stack([ahead, np.zeros_like(ahead)], axis=1), np.full(len(ahead), EGO_MPS), np.inf)

    def size(self, car: str) -> Floats:
        return _SIZE[EGO, :2].copy()

    def step(self, commands: Mapping[str, Command]) -> None:
        way = self._speed * _PERIOD_S
        self._along, self._offset, self._turn = self._along + way, self._offset.copy(), self._turn.copy()
        if "ego" in commands:
            acceleration, curvature = commands["ego"]
            speed = max(self._speed[EGO] + acceleration * _PERIOD_S, 0.0)
            way, self._speed = 0.5 * (self._speed[:1] + speed) * _PERIOD_S, self._speed.copy()
            moved = drive(self._offset[:1], self._turn[:1], way, np.array([curvature]), np.zeros(1))
            self._along[EGO] += moved.along[0] - self._speed[EGO] * _PERIOD_S
            self._offset[EGO], self._turn[EGO], self._speed[EGO] = moved.offset[0], moved.turn[0], speed
