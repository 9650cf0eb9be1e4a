"""Recorded traffic: scenarios of the CommonRoad collection."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from mast_zenoh.arrays.states import Ints
from mast_zenoh.errors import ConfigurationError, SceneError
from mast_zenoh.scenes.base import Scene
from mast_zenoh.scenes.commonroad.files import Obstacle, ScenarioFile, find_scenario, read_scenario
from mast_zenoh.scenes.making.assembly import assemble
from mast_zenoh.scenes.making.boxes import Boxes
from mast_zenoh.scenes.making.recorded_traffic import (
    HEIGHT_OF_CLASS,
    add_agents,
    agent_counts,
    busiest_vehicle,
    with_origin_at,
)
from mast_zenoh.scenes.making.virtual_agents import VEHICLE_CLASSES
from mast_zenoh.scenes.recording import Recording
from mast_zenoh.sensing import DetectionModel, Detector

_DETECTOR = DetectionModel()
_MAX_BOXES = 2_000_000
_MAX_IDS = 30  # in a message


class CommonRoadScenario(Scene):
    """A CommonRoad scenario: recorded or simulated traffic without sensors, to which virtual agents are added.

    path:              the scenario (.xml, .xml.gz), or a folder with a single one
    ego:               id of the dynamic obstacle that is the ego; None: of those there for the longest, the one with
                       the most others within 50 m. The scene consists of the time steps at which the ego is there
    n_infrastructure:  virtual poles along the ego's route, 15 m above the ground, looking 30 degrees down, 0 to 16;
                       None: 4
    n_mobile:          vehicles that get a lidar on the roof, besides the ego, the nearest ones that are there in every
                       frame; None: 0
    building_height_m: of the outlines of buildings, if there are any
    detector:          the model that generates detections from lidar visibility

    Scenarios are flat: the ground is at z = 0, and heights depend on the class. The position in a state is that of the
    origin of the shape, usually its middle, and the orientation is counter-clockwise from x, in rad (documentation of
    CommonRoad, 2020a). The world's axes are those of the file, and its origin is below the ego's first position. Who
    sees what comes from ray casting.
    """

    def __init__(
        self,
        *,
        path: str,
        ego: int | None = None,
        n_infrastructure: int | None = None,
        n_mobile: int | None = None,
        building_height_m: float = 12.0,
        detector: Detector = _DETECTOR,
    ) -> None:
        self.counts = agent_counts("CommonRoadScenario", n_infrastructure, n_mobile)
        if not 0.0 < building_height_m <= 1000.0:
            raise ConfigurationError(
                f"CommonRoadScenario: building_height_m is {building_height_m}, expected above 0, up to 1000"
            )
        self.path = Path(path)
        self.ego = ego
        self.building_height_m = building_height_m
        self.detector = detector

    def inputs(self) -> Sequence[Path]:
        """The scenario, or its folder."""
        return (self.path,)

    def record(self, seed: int, frames: int | None) -> Recording:
        file = find_scenario(self.path)
        scenario = read_scenario(file)
        start, count = self._window(scenario, file)
        boxes = _boxes(scenario.obstacles, start, count, file)
        ego = busiest_vehicle(boxes, count, file) if self.ego is None else self.ego
        origin = np.array([*boxes.position[(boxes.id == ego) & (boxes.frame == 0), :2][0], 0.0])
        boxes = with_origin_at(boxes, origin)
        return assemble(
            scenario.name,
            np.round(np.arange(count) * scenario.step_s * 1e9).astype(np.int64),
            boxes,
            add_agents(boxes, ego, count, self.counts, file),
            self.detector,
            seed=seed,
            frames=frames,
            buildings=tuple(outline - origin[:2] for outline in scenario.buildings),
            building_height=np.full(len(scenario.buildings), self.building_height_m),
        )

    def _window(self, scenario: ScenarioFile, file: Path) -> tuple[int, int]:
        """First time step of the scene, and number of its frames."""
        moving = {one.id: one for one in scenario.obstacles if one.first_step is not None}
        vehicles = [one for one in moving.values() if one.class_id in VEHICLE_CLASSES]
        if not vehicles:
            raise SceneError(f"{file}: found no dynamic car, truck or bus, expected one for the ego")
        if self.ego is not None and self.ego not in moving:
            known = ", ".join(map(str, sorted(one.id for one in vehicles)[:_MAX_IDS]))
            raise ConfigurationError(f"{file}: ego is {self.ego}, expected the id of a dynamic vehicle: {known}")
        longest = min(vehicles, key=lambda one: (-len(one.yaw), one.first_step or 0, one.id))
        ego = longest if self.ego is None else moving[self.ego]
        return ego.first_step or 0, len(ego.yaw)


def _boxes(obstacles: Sequence[Obstacle], start: int, count: int, file: Path) -> Boxes:
    """The boxes of the time steps from `start`, on the ground at z = 0."""
    parts = []
    total = 0
    for one in obstacles:
        if one.first_step is None:
            frame, rows = np.arange(count), np.zeros(count, np.intp)
        else:
            rows = np.flatnonzero((one.steps >= start) & (one.steps < start + count))
            frame = one.steps[rows] - start
        total += len(rows)
        if total > _MAX_BOXES:
            raise SceneError(f"{file}: found more than {_MAX_BOXES} boxes, expected at most as many")
        parts.append(_part(one, frame, rows))
    return Boxes.concatenate(parts)


def _part(one: Obstacle, frame: Ints, rows: Ints) -> Boxes:
    n = len(rows)
    height = HEIGHT_OF_CLASS[one.class_id]
    up = np.full((n, 1), height / 2)
    velocity = np.zeros((n, 2)) if one.first_step is None else one.velocity[rows]
    return Boxes(
        frame=frame,
        id=np.full(n, one.id),
        position=np.concatenate([one.position[rows], up], axis=1),
        size=np.tile([*one.size, height], (n, 1)),
        yaw=one.yaw[rows],
        class_id=np.full(n, one.class_id, np.uint8),
        velocity=np.concatenate([velocity, np.zeros((n, 1))], axis=1),
    )
