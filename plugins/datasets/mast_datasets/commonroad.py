"""Scenarios of CommonRoad."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
from msgspec import Meta

from mast_datasets import files
from mast_datasets.traffic import (
    HEIGHT_OF_CLASS,
    TrafficScene,
    busiest_vehicle,
    classes_of,
    ego_in_traffic,
    ground_below,
)
from mast_zenoh.arrays.states import Floats
from mast_zenoh.errors import ConfigurationError, SceneError
from mast_zenoh.scenes.making.assembly import VEHICLE_CLASSES, SceneBoxes, assemble
from mast_zenoh.scenes.recording import Recording

_Step = Annotated[int, Meta(ge=0, le=100_000)]  # number of a time step
_SHAPES = ("rectangle", "circle", "polygon")


class Outline(NamedTuple):
    """The box around a shape, in the obstacle's frame.

    size: (2,) m, length and width; centre: (2,) m, its middle; yaw: rad
    """

    size: Floats
    centre: Floats
    yaw: float


def read_outline(shape: files.Element) -> Outline:
    """The box around the only shape of an obstacle: a rectangle, or the box of a circle or polygon."""
    kinds = [kind for kind in _SHAPES if shape.get(kind)]
    if len(kinds) != 1:
        shape.fail(f"one of {', '.join(_SHAPES)}")
    part = shape[kinds[0]]
    if kinds == ["polygon"]:
        corners = read_polygon(part)
        low, high = corners.min(axis=0), corners.max(axis=0)
        if (high <= low).any():
            part.fail("a polygon with an area")
        return Outline(high - low, (low + high) / 2, 0.0)
    centre = part.get("center")
    middle = np.zeros(2) if centre is None else read_point(centre)
    if kinds == ["circle"]:
        return Outline(np.full(2, 2 * part["radius"].read(files.Side)), middle, 0.0)
    angle = part.get("orientation")
    size = np.array([part[side].read(files.Side) for side in ("length", "width")])
    return Outline(size, middle, 0.0 if angle is None else angle.read(files.Angle))


def read_polygon(polygon: files.Element) -> Floats:
    """Corners (k, 2) m of a polygon, without repeating the first."""
    return files.closed_outline(np.array([read_point(point) for point in polygon["point"].elements()]), polygon)


def read_point(point: files.Element) -> Floats:
    """(2,) m of an element with <x> and <y>."""
    return np.array([point[axis].read(files.Coordinate) for axis in "xy"])


_VERSIONS = ("2018b", "2020a")
_TAGS = ("obstacle", "dynamicObstacle", "staticObstacle", "environmentObstacle", "phantomObstacle")

CLASS_OF_TYPE = classes_of(
    car="car taxi priorityVehicle parkedVehicle",
    truck="truck",
    bus="bus",
    motorcycle="motorcycle",
    bicycle="bicycle",
    pedestrian="pedestrian",
    unknown="train unknown",
)
#: Types of obstacles that are not road users.
LEFT_OUT = ("constructionZone", "roadBoundary", "building", "pillar", "median_strip")


class Obstacle(NamedTuple):
    """An obstacle: whether it moves, and its boxes, whose frames are time steps; one that stands has a single box."""

    moves: bool
    boxes: SceneBoxes


class ScenarioFile(NamedTuple):
    """The content of a file: its name, the duration of a time step s, obstacles by id, and outlines of buildings."""

    name: str
    step_s: float
    obstacles: dict[int, Obstacle]
    buildings: list[Floats]


def read_scenario(path: Path) -> ScenarioFile:
    """The scenario in a file. Raises SceneError with file, line and reason."""
    elements = files.read_xml(path, "commonRoad", _TAGS)
    root = next(elements)
    root["commonRoadVersion"].text(_VERSIONS)
    step_s = root["timeStepSize"].read(Annotated[float, Meta(ge=1e-3, le=10)])
    name = root["benchmarkID"].text()
    obstacles: dict[int, Obstacle] = {}
    buildings: list[Floats] = []
    for element in elements:
        kind = element["type"] if element.tag != "phantomObstacle" else None
        if kind and element.tag == "environmentObstacle":
            if kind.text() == "building":
                buildings.append(read_polygon(element["shape"]["polygon"]))
        elif kind and kind.text((*CLASS_OF_TYPE, *LEFT_OUT)) not in LEFT_OUT:
            number = element["id"].read(files.Whole)
            if number in obstacles:
                element.refuse(f"id {number} occurs twice, expected it once")
            obstacles[number] = _obstacle(element, number, CLASS_OF_TYPE[kind.text()])
    return ScenarioFile(name, step_s, obstacles, buildings)


def _obstacle(element: files.XmlElement, number: int, class_id: int) -> Obstacle:
    moving = element.tag == "dynamicObstacle"
    if element.tag == "obstacle":  # 2018b
        moving = element["role"].text(("dynamic", "static")) == "dynamic"
    outline = read_outline(element["shape"])
    states = _states(element, moving)
    steps = [state["time"]["exact"].read(_Step) for state in states]
    first = steps[0]
    for step, expected, state in zip(steps, range(first, first + len(steps)), states, strict=True):
        if step != expected:
            state["time"]["exact"].fail(f"{expected}, the next time step")
    position, yaw = _poses(states, outline)
    velocity = _velocities(states, yaw - outline.yaw) if moving else np.zeros((1, 2))
    height, none = HEIGHT_OF_CLASS[class_id], np.zeros((len(states), 1))
    middle = np.concatenate([position, none + height / 2], axis=1)
    boxes = SceneBoxes.throughout(number, middle, np.array([*outline.size, height]), yaw, class_id)
    velocity = np.concatenate([velocity, none], axis=1)
    return Obstacle(moving, replace(boxes, frame=first + boxes.frame, velocity=velocity))


def _states(element: files.Element, moving: bool) -> list[files.Element]:
    if not moving:
        return [element["initialState"]]
    if element.get("occupancySet"):
        element.fail("a trajectory, not an occupancySet: sets of possible positions are no truth")
    return [element["initialState"], *element["trajectory"].several("state")]


def _poses(states: list[files.Element], outline: Outline) -> tuple[Floats, Floats]:
    """Position (K, 2) m of the middle of the box, and its yaw (K,) rad."""
    origin = np.array([read_point(state["position"]["point"]) for state in states])
    angle = np.array([state["orientation"]["exact"].read(files.Angle) for state in states])
    return origin + _turned(angle, *outline.centre), angle + outline.yaw


def _velocities(states: list[files.Element], angle: Floats) -> Floats:
    """(K, 2) m/s: `velocity` along the orientation and, if there is one, `velocityY` to the left of it."""
    ahead, left = (
        np.array([part["exact"].read(files.Speed) if part else usual for part in parts])
        for usual, parts in (
            (np.nan, [state.get("velocity") for state in states]),
            (0.0, [state.get("velocityY") for state in states]),
        )
    )
    return _turned(angle, ahead, left)


def _turned(angle: Floats, x: Floats, y: Floats) -> Floats:
    """(K, 2), x ahead and y to the left of angles (K,) rad."""
    return np.stack([x * np.cos(angle) - y * np.sin(angle), x * np.sin(angle) + y * np.cos(angle)], axis=1)


_MAX_BOXES = 2_000_000
_MAX_IDS = 30  # in a message


@dataclass(kw_only=True, eq=False)
class CommonRoadScenario(TrafficScene):
    """A CommonRoad scenario: recorded or simulated traffic without sensors, to which virtual agents are added.

    path:              the scenario (.xml, .xml.gz), or a folder with a single one
    ego:               id of the dynamic obstacle that is the ego; None: of those there for the longest, the one with
                       the most others within 50 m. The scene consists of the time steps at which the ego is there
    building_height_m: of the outlines of buildings, if there are any

    Scenarios are flat: the ground is at z = 0, and heights depend on the class. The position in a state is that of the
    origin of the shape, usually its middle, and the orientation is counter-clockwise from x, in rad (documentation of
    CommonRoad, 2020a). The world's axes are those of the file, and its origin is below the ego's first position. Who
    sees what comes from ray casting.
    """

    short_name = "commonroad"

    ego: int | None = None
    building_height_m: float = 12.0

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check(building_height_m=(0.1, 1000.0))

    @classmethod
    def recognises(cls, path: Path) -> bool:
        return files.has_root(path, "commonRoad")

    def record(self, seed: int, frames: int | None) -> Recording:
        file = files.find_file(self.root, "files *.xml", lambda file: file.name.endswith((".xml", ".xml.gz")))
        scenario = read_scenario(file)
        start, count = self._window(scenario, file)
        boxes = _boxes(scenario.obstacles.values(), start, count, file)
        ego = busiest_vehicle(boxes, count, file) if self.ego is None else self.ego
        origin, boxes = ground_below(boxes, ego, boxes.position[boxes.rows_of(ego)])
        return assemble(
            scenario.name,
            np.round(np.arange(count) * scenario.step_s * 1e9).astype(np.int64),
            boxes,
            self.agents(boxes, ego_in_traffic(boxes, ego, count, file), file),
            self.detector,
            seed=seed,
            frames=frames,
            buildings=tuple(outline - origin[:2] for outline in scenario.buildings),
            building_height=np.full(len(scenario.buildings), self.building_height_m),
        )

    def _window(self, scenario: ScenarioFile, file: Path) -> tuple[int, int]:
        """First time step of the scene, and number of its frames."""
        moving = {number: boxes for number, (moves, boxes) in scenario.obstacles.items() if moves}
        vehicles = [number for number, boxes in moving.items() if boxes.class_id[0] in VEHICLE_CLASSES]
        if not vehicles:
            raise SceneError(f"{file}: found no dynamic car, truck or bus, expected one for the ego")
        if self.ego is not None and self.ego not in moving:
            known = ", ".join(map(str, sorted(vehicles)[:_MAX_IDS]))
            raise ConfigurationError(f"{file}: ego is {self.ego}, expected the id of a dynamic vehicle: {known}")
        longest = min(vehicles, key=lambda number: (-len(moving[number]), moving[number].frame[0], number))
        steps = moving[longest if self.ego is None else self.ego].frame
        return int(steps[0]), len(steps)


def _boxes(obstacles: Iterable[Obstacle], start: int, count: int, file: Path) -> SceneBoxes:
    """The boxes of the time steps from `start`, on the ground at z = 0."""
    parts, total = [], 0
    for moves, boxes in obstacles:
        frame = boxes.frame - start if moves else np.arange(count)
        rows = np.flatnonzero((frame >= 0) & (frame < count))
        total += len(rows)
        if total > _MAX_BOXES:
            raise SceneError(f"{file}: found more than {_MAX_BOXES} boxes, expected at most as many")
        parts.append(replace(boxes.select(rows if moves else 0 * rows), frame=frame[rows]))
    return SceneBoxes.concatenate(parts)
