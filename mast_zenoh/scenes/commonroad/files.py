"""Reads the obstacles of a CommonRoad scenario, versions 2018b and 2020a.

Althoff, Koschi, Manzinger: CommonRoad: Composable benchmarks for motion planning on roads, IV 2017.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mast_zenoh.arrays.states import CLASS_INDEX, Floats, Ints
from mast_zenoh.errors import SceneError
from mast_zenoh.scenes.commonroad.shapes import Outline, read_outline, read_point, read_polygon
from mast_zenoh.scenes.files.xml_elements import XmlElement, read_xml

_VERSIONS = ("2018b", "2020a")
_TAGS = ("obstacle", "dynamicObstacle", "staticObstacle", "environmentObstacle", "phantomObstacle")
_MAX_OBSTACLES = 10_000
_MAX_STEP = 100_000  # number of the last time step

#: Types of obstacles by class; None: not an object.
CLASS_OF_TYPE = {
    "car": "car",
    "taxi": "car",
    "priorityVehicle": "car",
    "parkedVehicle": "car",
    "truck": "truck",
    "bus": "bus",
    "motorcycle": "motorcycle",
    "bicycle": "bicycle",
    "pedestrian": "pedestrian",
    "train": "unknown",
    "unknown": "unknown",
    "constructionZone": None,
    "roadBoundary": None,
    "building": None,
    "pillar": None,
    "median_strip": None,
}


@dataclass(frozen=True, eq=False)
class Obstacle:
    """An obstacle at K time steps.

    first_step: of its first state; None: it stands still, and is there at all times
    size:       (2,) m, length and width
    position:   (K, 2) m, middle of its box; yaw: (K,) rad
    velocity:   (K, 2) m/s; NaN where the file has none
    """

    id: int
    class_id: int
    first_step: int | None
    size: Floats
    position: Floats
    yaw: Floats
    velocity: Floats

    @property
    def steps(self) -> Ints:
        """(K,) time steps of a moving obstacle."""
        return np.arange(len(self.yaw)) + (self.first_step or 0)


@dataclass(frozen=True, eq=False)
class ScenarioFile:
    """The content of a file: its name, the duration of a time step s, obstacles, and outlines (k, 2) m of buildings."""

    name: str
    step_s: float
    obstacles: list[Obstacle]
    buildings: list[Floats]


def find_scenario(path: Path) -> Path:
    """The scenario at `path`: a file, or a folder with a single file *.xml or *.xml.gz."""
    if path.is_file():
        return path
    if not path.is_dir():
        raise SceneError(f"{path}: no such file or folder")
    files = sorted(file for file in path.iterdir() if file.name.endswith((".xml", ".xml.gz")))
    if len(files) != 1:
        names = ", ".join(file.name for file in files[:10]) or "none"
        raise SceneError(f"{path}: found {len(files)} files *.xml ({names}), expected one; add its name to the path")
    return files[0]


def read_scenario(path: Path) -> ScenarioFile:
    """The scenario in a file. Raises SceneError with file, line and reason."""
    elements = read_xml(path, "commonRoad", _TAGS)
    root = next(elements, None)
    if root is None:
        raise SceneError(f"{path}: found no element, expected <commonRoad>")
    root.attribute("commonRoadVersion").text(_VERSIONS)
    step_s = root.attribute("timeStepSize").number(1e-3, 10.0)
    name = root.attribute("benchmarkID").text()
    obstacles: dict[int, Obstacle] = {}
    buildings: list[Floats] = []
    for count, element in enumerate(elements):
        if count >= _MAX_OBSTACLES:
            element.fail(f"found more than {_MAX_OBSTACLES} obstacles, expected at most as many")
        kind = element.child("type").text.text() if element.tag != "phantomObstacle" else ""
        if element.tag == "environmentObstacle" and kind == "building":
            buildings.append(read_polygon(element.child("shape").child("polygon")))
        if element.tag in ("environmentObstacle", "phantomObstacle"):
            continue
        obstacle = _obstacle(element)
        if obstacle is None:
            continue
        if obstacle.id in obstacles:
            element.fail(f"id {obstacle.id} occurs twice, expected it once")
        obstacles[obstacle.id] = obstacle
    return ScenarioFile(name, step_s, list(obstacles.values()), buildings)


def _obstacle(element: XmlElement) -> Obstacle | None:
    """An obstacle; None if it is not a road user."""
    number = element.attribute("id").integer(0)
    kind = element.child("type").text
    if CLASS_OF_TYPE[kind.text(tuple(CLASS_OF_TYPE))] is None:
        return None
    class_id = CLASS_INDEX[CLASS_OF_TYPE[kind.text()] or ""]
    moving = element.tag == "dynamicObstacle"
    if element.tag == "obstacle":  # 2018b
        moving = element.child("role").text.text(("dynamic", "static")) == "dynamic"
    outline = read_outline(element.child("shape"))
    states = list(_states(element, moving))
    first = _step(states[0])
    for index, state in enumerate(states):
        if _step(state) != first + index:
            state.child("time").fail(f"found time step {_step(state)}, expected {first + index}: the next one")
    position, yaw = _poses(states, outline)
    return Obstacle(
        number, class_id, first if moving else None, outline.size, position, yaw, _velocities(states, yaw - outline.yaw)
    )


def _states(element: XmlElement, moving: bool) -> Iterator[XmlElement]:
    yield element.child("initialState")
    if not moving:
        return
    if element.get_child("occupancySet") is not None:
        element.fail("found <occupancySet>, expected <trajectory>: sets of possible positions are no truth")
    for state in element.child("trajectory").children:
        if state.tag != "state":
            state.fail("found this element in a trajectory, expected <state>")
        yield state


def _step(state: XmlElement) -> int:
    return state.child("time").child("exact").text.integer(0, _MAX_STEP)


def _poses(states: list[XmlElement], outline: Outline) -> tuple[Floats, Floats]:
    """Position (K, 2) m of the middle of the box, and its yaw (K,) rad."""
    origin = np.array([read_point(state.child("position").child("point")) for state in states])
    angle = np.array([state.child("orientation").child("exact").text.number(-1e3, 1e3) for state in states])
    x, y = outline.centre
    offset = np.stack([x * np.cos(angle) - y * np.sin(angle), x * np.sin(angle) + y * np.cos(angle)], axis=1)
    return origin + offset, angle + outline.yaw


def _velocities(states: list[XmlElement], angle: Floats) -> Floats:
    """(K, 2) m/s: `velocity` along the orientation and, if there is one, `velocityY` to the left of it."""
    velocity = np.full((len(states), 2), np.nan)
    for row, (state, yaw) in enumerate(zip(states, angle, strict=True)):
        forward = state.get_child("velocity")
        if forward is None:
            continue
        ahead = forward.child("exact").text.number(-200.0, 200.0)
        sideways = state.get_child("velocityY")
        left = 0.0 if sideways is None else sideways.child("exact").text.number(-200.0, 200.0)
        velocity[row] = (
            ahead * np.cos(yaw) - left * np.sin(yaw),
            ahead * np.sin(yaw) + left * np.cos(yaw),
        )
    return velocity
