"""Simulated traffic: floating-car data of the simulator SUMO."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from mast_zenoh.arrays.states import Floats
from mast_zenoh.errors import ConfigurationError, SceneError
from mast_zenoh.scenes.base import Scene
from mast_zenoh.scenes.making.assembly import assemble
from mast_zenoh.scenes.making.boxes import Boxes
from mast_zenoh.scenes.making.recorded_traffic import (
    add_agents,
    agent_counts,
    busiest_vehicle,
    near_route,
    with_origin_at,
)
from mast_zenoh.scenes.recording import Recording
from mast_zenoh.scenes.sumo.buildings import read_buildings
from mast_zenoh.scenes.sumo.trace import Trace, read_trace
from mast_zenoh.scenes.sumo.vehicle_types import VehicleTypes, sizes
from mast_zenoh.sensing import DetectionModel, Detector

_DETECTOR = DetectionModel()
_SUFFIXES = (".xml", ".xml.gz", ".csv", ".csv.gz")


class SumoTrace(Scene):
    """Traffic simulated by SUMO, from its floating-car data (FCD), to which virtual agents are added.

    path:              the trace (.xml or .csv, or either with .gz), or a folder with a single one with "fcd" in its
                       name. Files next to it are read, too: *.poly.xml for buildings and, if the trace contains no
                       sizes, *.rou.xml and *.add.xml for vehicle types
    start_s:           time of the first frame, as in the trace; None: its first
    duration_s:        of the scene; None: to the end of the trace, 20 s at most
    ego:               name of the vehicle that is the ego; None: the one with the most others within 50 m
    radius_m:          objects are there while they are within this distance of any point of the ego's route, 20 to 2000
    n_infrastructure:  virtual poles along the ego's route, 15 m above the ground, looking 30 degrees down, 0 to 16;
                       None: 4
    n_mobile:          vehicles that get a lidar on the roof, besides the ego, the nearest ones that are there in every
                       frame; None: 0
    building_height_m: of the outlines of buildings without a height
    detector:          the model that generates detections from lidar visibility

    SUMO's position is the middle of the front bumper, and its angle is in degrees clockwise from north ("FCDOutput" in
    its documentation); a box is half its length behind that, and its yaw is 90 degrees minus the angle. Velocities are
    the speed along the yaw, because a change of lanes may be a jump of positions. The world's axes are those of the
    network, and its origin is below the middle of the ego in the first frame. What an agent sees comes from ray
    casting.
    """

    def __init__(
        self,
        *,
        path: str,
        start_s: float | None = None,
        duration_s: float | None = None,
        ego: str | None = None,
        radius_m: float = 150.0,
        n_infrastructure: int | None = None,
        n_mobile: int | None = None,
        building_height_m: float = 12.0,
        detector: Detector = _DETECTOR,
    ) -> None:
        self.counts = agent_counts("SumoTrace", n_infrastructure, n_mobile)
        for name, value, low, high in (
            ("start_s", start_s, 0.0, 1e9),
            ("duration_s", duration_s, 0.001, 1e5),
            ("radius_m", radius_m, 20.0, 2000.0),
            ("building_height_m", building_height_m, 0.1, 1000.0),
        ):
            if value is not None and not low <= value <= high:
                raise ConfigurationError(f"SumoTrace: {name} is {value}, expected {low:g} to {high:g}")
        self.path = Path(path)
        self.start_s = start_s
        self.duration_s = duration_s
        self.ego = ego
        self.radius_m = radius_m
        self.building_height_m = building_height_m
        self.detector = detector

    def inputs(self) -> Sequence[Path]:
        """The folder of the trace."""
        return (self.path.parent if self.path.is_file() else self.path,)

    def record(self, seed: int, frames: int | None) -> Recording:
        file = _find_trace(self.path)
        types = VehicleTypes([*_beside(file, ".rou.xml"), *_beside(file, ".add.xml")])
        trace = read_trace(file, types, self.start_s, self.duration_s)
        count = len(trace.times_ns)
        boxes = _boxes(trace)
        ego = busiest_vehicle(boxes, count, file) if self.ego is None else self._find_ego(trace, file)
        own = boxes.select(boxes.id == ego)
        route = own.position[np.argsort(own.frame, kind="stable")]
        origin = route[0] - [0.0, 0.0, own.size[0, 2] / 2]
        boxes = boxes.select(near_route(boxes, route[:, :2], self.radius_m))
        outlines, heights = read_buildings(
            _beside(file, ".poly.xml"), route[:, :2], self.radius_m, self.building_height_m
        )
        boxes = with_origin_at(boxes, origin)
        return assemble(
            file.name.partition(".")[0],
            trace.times_ns,
            boxes,
            add_agents(boxes, ego, count, self.counts, file, lambda number: trace.names[number - 1]),
            self.detector,
            seed=seed,
            frames=frames,
            buildings=tuple(outline - origin[:2] for outline in outlines),
            building_height=np.array(heights, np.float64),
        )

    def _find_ego(self, trace: Trace, file: Path) -> int:
        if self.ego not in trace.names:
            raise ConfigurationError(
                f"{file}: ego is {self.ego!r}, expected the name of a vehicle in the trace from "
                f"{trace.times_ns[0] / 1e9:g} to {trace.times_ns[-1] / 1e9:g} s, such as {', '.join(trace.names[:10])}"
            )
        return trace.names.index(self.ego) + 1


def _find_trace(path: Path) -> Path:
    if path.is_file():
        if not path.name.endswith(_SUFFIXES):
            raise SceneError(f"{path}: found another kind of file, expected {', '.join(_SUFFIXES)}")
        return path
    if not path.is_dir():
        raise SceneError(f"{path}: no such file or folder")
    files = sorted(file for file in path.iterdir() if "fcd" in file.name.lower() and file.name.endswith(_SUFFIXES))
    if len(files) != 1:
        names = ", ".join(file.name for file in files[:10]) or "none"
        raise SceneError(
            f"{path}: found {len(files)} traces *fcd*.xml or *fcd*.csv ({names}), expected one; "
            "add its name to the path"
        )
    return files[0]


def _beside(file: Path, suffix: str) -> list[Path]:
    return sorted(other for other in file.parent.iterdir() if other.name.endswith((suffix, suffix + ".gz")))


def _boxes(trace: Trace) -> Boxes:
    """The boxes of all objects, in the frame of the network."""
    size = sizes(trace.types)
    ahead: Floats = np.stack([np.cos(trace.yaw), np.sin(trace.yaw), np.zeros(len(trace.yaw))], axis=1)
    back = np.where(trace.person, 0.0, size[:, 0] / 2)
    return Boxes(
        frame=trace.frame,
        id=trace.id,
        position=trace.front - back[:, None] * ahead + np.stack([0 * back, 0 * back, size[:, 2] / 2], axis=1),
        size=size,
        yaw=trace.yaw,
        class_id=np.array([kind.class_id for kind in trace.types], np.uint8),
        velocity=trace.speed[:, None] * ahead,
    )
