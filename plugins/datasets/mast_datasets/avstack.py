"""Recorded scenes in the CARLA multi-agent layout of AVstack."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mast_datasets.avstack_files import (
    ObjectState,
    RunLayout,
    SensorCalibration,
    open_layout,
    read_buildings,
    read_calibration,
    read_objects,
    read_seen,
    read_visibility,
)
from mast_datasets.traffic import ABOVE_0, DataSetScene
from mast_zenoh.arrays.states import Detections, Floats, Ints
from mast_zenoh.errors import ConfigurationError, SceneError
from mast_zenoh.scenes.making.assembly import AgentPath, SceneBoxes, assemble
from mast_zenoh.scenes.own_detections import read_json_lines
from mast_zenoh.scenes.recording import SEEN_RETURNS, Recording, SceneAgent
from mast_zenoh.scenes.recording_file import check_counts
from mast_zenoh.sensing import Camera, LidarSensor

#: Object id of agent 0; agent k, if it is an object, has this plus k. The layout numbers agents and objects
#: separately, both from 0, and its original reader gives the ego this id.
EGO_ID = 99999

_MAX_MOUNT_ERROR_M = 0.05  # between a sensor's position in its calibration and according to the agent's state
_ARCHIVES = (".tar", ".tar.gz", ".tgz", ".tar.bz2", ".tar.xz")
#: Converts a camera's optical axes (x right, y down, z forward) to x forward, y left, z up.
_OPTICAL = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])


@dataclass(kw_only=True, eq=False)
class AVstackScene(DataSetScene):
    """A scene in the CARLA multi-agent layout.

    With its accompanying files, see docs/scenes.md.

    path:             a run folder, a folder above a single run, or a tar archive of either
    n_infrastructure: number of static agents to use, the first ones; None: all
    n_mobile:         number of mobile agents besides the ego to use, the first ones; None: all
    replay:           use the detections in `detections.jsonl` if it exists; otherwise `detector` generates them
    detector:         the model that generates detections from lidar visibility
    max_unpacked_mb:  limit on the files unpacked from an archive, 10^6 bytes

    The first mobile agent is "ego", other ones are "mobile_k", static ones "infra_k", where k is their number in the
    files. An object's lidar returns come from `visibility.jsonl`. Without it, the objects in a lidar's object files
    are seen, with the returns that ray casting gives, scaled by their visible fraction, at least 5. For a lidar without
    object files, ray casting alone decides.
    """

    short_name = "avstack"
    files = (("objects/objectstate-*.txt",), ("*/objects/objectstate-*.txt",))

    replay: bool = True
    max_unpacked_mb: float = 1000.0

    def __post_init__(self) -> None:
        self.check(max_unpacked_mb=ABOVE_0)

    @classmethod
    def recognises(cls, path: Path) -> bool:
        return super().recognises(path) or (path.is_file() and path.name.endswith(_ARCHIVES))

    def record(self, seed: int, frames: int | None) -> Recording:
        with open_layout(self.root, self.max_unpacked_mb) as layout:
            return self._record(layout, seed, frames)

    def _record(self, layout: RunLayout, seed: int, frames: int | None) -> Recording:
        numbers = list(layout.frames())
        if frames is not None:
            if not 1 <= frames <= len(numbers):
                raise ConfigurationError(f"{self.path}: {frames} frames requested, the scene has {len(numbers)}")
            numbers = numbers[:frames]
        times, actors, objects = _read_states(layout, numbers)
        agents = self._agents(actors[0], layout.run)
        boxes, start = _boxes(objects)
        file = layout.accompanying_file("buildings.json")
        outlines, heights = read_buildings(file, layout.accompanying_file("scene.json")) if file else ((), np.zeros(0))
        paths = [
            _path(layout, numbers, number, k == 0, [each[number] for each in actors]) for k, number in enumerate(agents)
        ]
        make = partial(assemble, self.root.name, times, boxes, seed=seed, buildings=outlines, building_height=heights)
        none = Detections.empty(), np.zeros(len(times) * len(paths) + 1, np.int64), np.zeros(0, np.int64)
        points = _points(layout, boxes.id, start, numbers, agents, lambda: make(paths, none).points)
        bottoms = np.split(boxes.position[:, 2] - boxes.size[:, 2] / 2, start[1:-1])
        ground = np.array([np.median(bottom) for bottom in bottoms])
        paths = [replace(path, points=points[:, k], ground=ground) for k, path in enumerate(paths)]
        file = layout.accompanying_file("detections.jsonl") if self.replay else None
        if file is None:
            return replace(make(paths, self.detector), times_ns=times)
        turns = [path.rotation @ path.agent.sensor.mount_rotation for path in paths]
        return replace(make(paths, read_json_lines(file, numbers, agents, np.stack(turns, axis=1))), times_ns=times)

    def _agents(self, actors: dict[int, ObjectState], run: Path) -> list[int]:
        """Numbers of the agents: the ego, other mobile agents, then static agents."""
        mobile = [number for number, state in actors.items() if state.size is not None]
        static = [number for number, state in actors.items() if state.size is None]
        if not mobile:
            raise SceneError(f"{run / 'objects'}: no actor has a box, expected at least the ego")
        ego, *others = mobile
        check_counts(self.path, (self.n_mobile, len(others)), (self.n_infrastructure, len(static)))
        return [ego, *others[: self.n_mobile], *static[: self.n_infrastructure]]


def _read_states(
    layout: RunLayout, numbers: list[int]
) -> tuple[Ints, list[dict[int, ObjectState]], list[dict[int, ObjectState]]]:
    """Times (F,) ns, and the actors by number and objects by id of every frame.

    The objects include actors with a box.
    """
    times: list[float] = []
    all_actors: list[dict[int, ObjectState]] = []
    all_objects: list[dict[int, ObjectState]] = []
    actor_files = layout.frames()
    for frame in numbers:
        path = actor_files[frame]
        time, actors = read_objects(path, frame)
        by_number = {state.id: state for state in sorted(actors, key=lambda state: state.id)}
        others_path = path.with_name(path.name.replace("-actors-", "-npcs-"))
        others_time, others = read_objects(others_path, frame)
        if others_time != time:
            raise SceneError(f"{others_path}: time {others_time} s, but {time} s in {path.name}")
        if times and time <= times[-1]:
            raise SceneError(f"{path}: time {time} s is not later than {times[-1]} s in the frame before")
        if all_actors and list(by_number) != list(all_actors[0]):
            raise SceneError(f"{path}: actors {list(by_number)}, but {list(all_actors[0])} in the first frame")
        if len(by_number) != len(actors):
            raise SceneError(f"{path}: two actors have the same ID")
        objects = {state.id: state for state in others if state.size is not None}
        if len(objects) != len(others):
            raise SceneError(f"{others_path}: two objects have the same ID, or one has no box")
        objects |= {EGO_ID + number: state for number, state in by_number.items() if state.size is not None}
        times.append(time)
        all_actors.append(by_number)
        all_objects.append(dict(sorted(objects.items())))
    return np.round(np.array(times) * 1e9).astype(np.int64), all_actors, all_objects


def _boxes(objects: list[dict[int, ObjectState]]) -> tuple[SceneBoxes, Ints]:
    """The boxes of all objects by frame and id, and the row (F + 1,) with which each frame begins."""
    rows = [(frame, number, state) for frame, each in enumerate(objects) for number, state in each.items()]
    states = [state for _, _, state in rows]
    unknown = np.full(3, np.nan)
    boxes = SceneBoxes(
        frame=np.array([frame for frame, _, _ in rows], np.int64),
        id=np.array([number for _, number, _ in rows], np.int64),
        position=np.array([state.centre for state in states]),
        size=np.array([state.size for state in states]),
        yaw=np.array([state.yaw for state in states]),
        class_id=np.array([state.class_id for state in states], np.uint8),
        velocity=np.array([unknown if state.velocity is None else state.velocity for state in states]),
    )
    return boxes, np.cumsum([0, *map(len, objects)])


def _path(layout: RunLayout, numbers: list[int], number: int, is_ego: bool, states: list[ObjectState]) -> AgentPath:
    """The path of an agent with its first lidar and its first camera. states: of it in each frame"""
    mobile = states[0].size is not None
    position, rotation = np.array([each.position for each in states]), np.array([each.rotation for each in states])
    lidars = layout.sensors("lidar", number)
    if not lidars:
        raise SceneError(f"{layout.run / 'data'}: no folder lidar-<k>-{number} for agent {number}")
    files = layout.calibrations(lidars[0], numbers)
    mount_position, mount_rotation = _mount(read_calibration(files[numbers[0]]), position[0], rotation[0])
    for k, path in enumerate(files.values()):
        calibrated, expected = read_calibration(path).position, position[k] + rotation[k] @ mount_position
        if np.abs(calibrated - expected).max() > _MAX_MOUNT_ERROR_M:
            raise SceneError(
                f"{path}: the lidar is at {np.round(calibrated, 2).tolist()}, expected "
                f"{np.round(expected, 2).tolist()}: its mount must not change after the first frame"
            )
    lidar = LidarSensor() if mobile else LidarSensor.infrastructure()
    lidar = replace(lidar, mount_position=mount_position, mount_rotation=mount_rotation)
    camera = Camera()
    for name in layout.sensors("camera", number)[:1]:
        path = layout.calibrations(name, numbers)[numbers[0]]
        read = read_calibration(path)
        if read.focal is None or read.width is None or read.height is None:
            raise SceneError(f"{path}: img_shape is missing, expected the calibration of a camera")
        camera_position, camera_rotation = _mount(read, position[0], rotation[0])
        camera = Camera(camera_position, camera_rotation @ _OPTICAL, read.width, read.height, read.focal)
    name = "ego" if is_ego else f"mobile_{number}" if mobile else f"infra_{number}"
    kind, own = ("mobile", EGO_ID + number) if mobile else ("static", -1)
    velocity = None if mobile else np.zeros_like(position)
    return AgentPath(SceneAgent(name, kind, own, lidar, camera), position, rotation, velocity)


def _mount(calibration: SensorCalibration, position: Floats, rotation: Floats) -> tuple[Floats, Floats]:
    """A sensor's pose in its agent's frame, from both poses in the world.

    Some writers give the sensor's pose relative to the agent, others to the world: resolved, both are the same.
    """
    return rotation.T @ (calibration.position - position), rotation.T @ calibration.rotation


def _points(
    layout: RunLayout,
    ids: Ints,
    start: Ints,
    numbers: list[int],
    agents: list[int],
    cast: Callable[[], NDArray[np.int32]],
) -> NDArray[np.int32]:
    """(N, A) lidar returns, from the best source available.

    ids, start: (N,) of the boxes, and (F + 1,) row with which each frame begins; cast: what ray casting gives
    """
    file = layout.accompanying_file("visibility.jsonl")
    if file is not None:
        return read_visibility(file, numbers, agents, ids, start)
    cast_points = cast()
    points = cast_points.copy()
    listed: set[int] = set()
    for column, number in enumerate(agents):
        files = layout.seen(layout.sensors("lidar", number)[0], numbers)
        if files is None:
            continue
        points[:, column] = 0
        for k, (frame, path) in enumerate(files.items()):
            seen = read_seen(path, frame)
            listed |= seen.keys()
            for row in range(start[k], start[k + 1]):
                fraction = seen.get(int(ids[row]), -1.0)
                if fraction != -1.0:
                    share = 1.0 if fraction is None else fraction
                    points[row, column] = max(SEEN_RETURNS, round(share * int(cast_points[row, column])))
    # If a data set never lists the agents as objects, their visibility comes from ray casting.
    unlisted = (ids >= EGO_ID) & ~np.isin(ids, sorted(listed))
    points[unlisted] = cast_points[unlisted]
    return points
