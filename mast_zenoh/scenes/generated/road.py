"""A generated scene: a straight road on which an ego comes up to a vehicle that a collaborating car sees, too."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from mast_zenoh.arrays.states import Floats
from mast_zenoh.driving.motion import Command, RouteAhead, drive
from mast_zenoh.errors import ConfigurationError, nearest
from mast_zenoh.scenes.base import Scene, SteppedWorld
from mast_zenoh.scenes.generated.intersection import world_of_motion
from mast_zenoh.scenes.generated.traffic import Motion
from mast_zenoh.scenes.making.observe import World, detect, lidar_visibility, make_recording
from mast_zenoh.scenes.recording import Recording, SceneAgent
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
_ENDS = np.array([[-60.0, 10.0], [300.0, 10.0], [300.0, 20.0], [-60.0, 20.0]])
#: Terraces on both sides: outlines and heights, m.
_TERRACES = (_ENDS, _ENDS - [0.0, 30.0]), np.full(2, 8.0)


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
        along = np.array([0.0, target_m + closed_m, collaborator_m + closed_m])
        offset, speeds = np.array([0.0, side * aside, side * LANE_M]), np.array([EGO_MPS, speed, speed])
        return RoadWorld(f"road-{self.case}", np.stack([along, offset, np.zeros(3), speeds], axis=1), self.detector)

    def record(self, seed: int, frames: int | None) -> Recording:
        count = _FRAMES if frames is None else frames
        if count < 1:
            raise ConfigurationError(f"StraightRoad: {count} frames, expected at least 1")
        stepped, states = self.world(seed, count), []
        for _ in range(count):
            states.append(stepped.state)
            stepped.step({})
        world = stepped.world_of(np.stack(states))
        points = lidar_visibility(world)
        return make_recording(world, points, *detect(world, points, self.detector, seed))


class RoadWorld(SteppedWorld):
    """The road along x, stepped: the ego can be driven, the others keep their speed.

    state: (3, 4) along and to the left of the ego's lane, m, heading, rad, and speed, m/s, now: of the ego, the target
    and the collaborator
    """

    cars = ("ego",)

    def __init__(self, name: str, state: Floats, detector: Detector) -> None:
        self.detector, self.state, self._name = detector, state, name
        self._agents: tuple[SceneAgent, ...] | None = None
        self._agents = self.now().agents

    def now(self) -> World:
        return self.world_of(self.state[None])

    def world_of(self, states: Floats) -> World:
        """The world of f frames. states: (f, 3, 4), see `state`"""
        motion = Motion(states[..., :2], states[..., 2], states[..., 3], np.zeros(states.shape[:2], np.int64))
        cars = [EGO, COLLABORATOR]
        world = world_of_motion(self._name, _PERIOD_NS, _SIZE, ["car"] * 3, motion, cars, [], _TERRACES, self._agents)
        return replace(world, truth=world.truth.with_(yaw=motion.yaw.reshape(-1)))  # it is small: no need to wrap it

    def route(self, car: str) -> RouteAhead:
        ahead = self.state[EGO, 0] + np.arange(_HORIZON_M + 1.0)
        return RouteAhead(np.stack([ahead, np.zeros_like(ahead)], axis=1), np.full(len(ahead), EGO_MPS), np.inf)

    def size(self, car: str) -> Floats:
        return _SIZE[EGO, :2].copy()

    def step(self, commands: Mapping[str, Command]) -> None:
        along, offset, turn, speed = state = self.state.T.copy()
        along += speed * _PERIOD_S
        if "ego" in commands:
            acceleration, curvature = commands["ego"]
            commanded = max(speed[EGO] + acceleration * _PERIOD_S, 0.0)
            way = 0.5 * (speed[:1] + commanded) * _PERIOD_S
            moved = drive(offset[:1], turn[:1], way, np.array([curvature]), np.zeros(1))
            along[EGO] += moved.along[0] - speed[EGO] * _PERIOD_S
            offset[EGO], turn[EGO], speed[EGO] = moved.offset[0], moved.turn[0], commanded
        self.state = state.T
