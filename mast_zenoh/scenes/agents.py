"""The agents of a scene and their sensors."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from fnmatch import fnmatchcase
from typing import Any

import numpy as np

from mast_zenoh.errors import nearest
from mast_zenoh.sensing.sensors import Camera, LidarSensor

#: Kinds of sensors.
KINDS = ("lidar", "camera", "radar")


@dataclass(frozen=True, eq=False)
class SceneSensor:
    """One sensor of an agent.

    name:  unique for its agent, one chunk of a key
    kind:  one of KINDS
    lidar: its mount, field of view and range, with the rays that decide what it sees
    detection_probability: of an object in full view, for trackers; None: unknown

    Raises ValueError for another kind, and for a probability outside (0, 1).
    """

    name: str
    kind: str
    lidar: LidarSensor
    detection_probability: float | None = None

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise ValueError(f"sensor {self.name!r} is of the kind {self.kind!r}{nearest(str(self.kind), KINDS)}")
        if self.detection_probability is not None and not 0.0 < self.detection_probability < 1.0:
            found = self.detection_probability
            raise ValueError(f"sensor {self.name!r}: detection_probability: found {found}, expected between 0 and 1")


@dataclass(frozen=True, eq=False)
class SceneAgent:
    """One agent of a scene.

    name:      "ego", "mobile_1", …, "infra_1", …
    kind:      "mobile" or "static"
    object_id: id of the agent's own object; -1: none (a pole)
    sensor:    its lidar, or the geometry of its first sensor
    camera:    its camera, for rendering
    sensors:   all of its sensors, `sensor` first; empty: that lidar alone
    """

    name: str
    kind: str
    object_id: int
    sensor: LidarSensor
    camera: Camera
    sensors: tuple[SceneSensor, ...] = ()

    def __post_init__(self) -> None:
        if not self.sensors:
            object.__setattr__(self, "sensors", (SceneSensor("lidar", "lidar", self.sensor),))
        names = [sensor.name for sensor in self.sensors]
        if self.sensors[0].lidar is not self.sensor or len(set(names)) < len(names):
            raise ValueError(f"agent {self.name!r}: sensors {names}: expected `sensor` first, and different names")


def best_pattern(patterns: Iterable[str], name: str) -> str | None:
    """The longest pattern that matches the name of an agent; None if none matches.

    A plain name therefore wins over a wildcard.
    """
    matches = [pattern for pattern in patterns if fnmatchcase(name, pattern)]
    return max(matches, key=lambda pattern: (pattern == name, len(pattern))) if matches else None


def agent_to_json(agent: SceneAgent) -> dict[str, Any]:
    """An agent as JSON values; a single lidar is not listed again."""
    data = {
        "name": agent.name,
        "kind": agent.kind,
        "object_id": agent.object_id,
        "sensor": _part_to_json(agent.sensor),
        "camera": _part_to_json(agent.camera),
    }
    only = agent.sensors[0]
    if len(agent.sensors) == 1 and (only.name, only.kind, only.detection_probability) == ("lidar", "lidar", None):
        return data
    return data | {"sensors": [_part_to_json(each) | {"lidar": _part_to_json(each.lidar)} for each in agent.sensors]}


def agent_from_json(data: Mapping[str, Any]) -> SceneAgent:
    """The agent that `agent_to_json` described; raises ValueError, KeyError or TypeError for anything else."""
    if not isinstance(data["name"], str) or data["kind"] not in ("mobile", "static"):
        raise ValueError(f"agent {data['name']!r} is {data['kind']!r}, expected a name, and mobile or static")
    first = LidarSensor(**_arrays(data["sensor"]))
    sensors = []
    for index, each in enumerate(data.get("sensors", ())):
        if not isinstance(each["name"], str):
            raise ValueError(f"agent {data['name']!r}: sensors[{index}]: name is {each['name']!r}, expected a string")
        lidar = LidarSensor(**_arrays(each["lidar"])) if index else first
        sensors.append(SceneSensor(**{**each, "lidar": lidar}))
    camera = Camera(**_arrays(data["camera"]))
    return SceneAgent(data["name"], data["kind"], int(data["object_id"]), first, camera, tuple(sensors))


def _part_to_json(part: LidarSensor | Camera | SceneSensor) -> dict[str, Any]:
    values = {field.name: getattr(part, field.name) for field in fields(part) if field.name != "lidar"}
    return {key: value.tolist() if isinstance(value, np.ndarray) else value for key, value in values.items()}


def _arrays(part: Mapping[str, Any]) -> dict[str, Any]:
    return {key: np.array(value, np.float64) if isinstance(value, list) else value for key, value in part.items()}
