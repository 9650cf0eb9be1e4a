"""Prepared scenes: all data of one (scene, seed) in columns."""

from __future__ import annotations

import json
import os
import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, fields
from functools import cached_property, partial
from itertools import accumulate
from pathlib import Path
from tokenize import TokenError
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.states import CLASSES, DETECTION_COLUMNS, Detections, Floats, Ints, ObjectStates
from mast_zenoh.errors import SceneError
from mast_zenoh.run_folder import check_plain, open_plain
from mast_zenoh.scenes.agents import SceneAgent as SceneAgent
from mast_zenoh.scenes.agents import agent_from_json, agent_to_json
from mast_zenoh.scenes.mapped import MappedArray, check_stored, mapped_arrays
from mast_zenoh.scenes.recorded_scans import SCAN_TYPES, RecordedScans

#: In place of the age of a measurement, in frames without a new one.
NO_MEASUREMENT = -1


@dataclass(frozen=True, eq=False)
class Measurements:
    """The new measurements of S sensors in F frames.

    age_ns:   (F, S) int64, ns, time of the frame minus that of the measurement; NO_MEASUREMENT: none is new
    position: (F, S, 3) m, of the sensor's agent when it measured, world frame
    rotation: (F, S, 3, 3) active, agent to world, at that time
    """

    age_ns: Ints
    position: Floats
    rotation: Floats

    def select(self, frames: slice, sensors: slice | Ints) -> Measurements:
        """Those of some frames and sensors."""
        part = frames, sensors
        return Measurements(self.age_ns[part], self.position[part], self.rotation[part])

    def arrays(self) -> dict[str, NDArray[np.int64] | Floats]:
        """All arrays by name."""
        return {"age_ns": self.age_ns, "position": self.position, "rotation": self.rotation}

    def problems(self, times_ns: Ints, names: list[str]) -> Iterator[str]:
        """What is wrong with them, each in a sentence.

        times_ns: (F,) of the frames; names: (S,) of the sensors
        """
        frames, sensors = len(times_ns), len(names)
        for name, shape in (("age_ns", ()), ("position", (3,)), ("rotation", (3, 3))):
            values = getattr(self, name)
            if values.shape != (frames, sensors, *shape):
                yield f"measurements.{name} has shape {values.shape}, expected {(frames, sensors, *shape)}"
                return
            if isinstance(values, np.ndarray) and not np.isfinite(values).all():  # a MappedArray checks what is read
                yield f"measurements.{name} has a number that is not finite"
        latest = np.concatenate([[0], np.diff(times_ns) - 1])
        invalid = np.argwhere((self.age_ns < NO_MEASUREMENT) | (self.age_ns > latest[:, None]))
        if len(invalid):
            frame, sensor = invalid[0].tolist()
            yield (
                f"measurements.age_ns: {names[sensor]} in frame {frame}: found {self.age_ns[frame, sensor]} ns, "
                f"expected {NO_MEASUREMENT} (none), or 0 to {latest[frame]}: after the frame before it"
            )

    def check(self, place: str, times_ns: Ints, names: list[str]) -> None:
        """Raise SceneError for the first problem. place: of the recording, for the message"""
        for problem in self.problems(times_ns, names):
            raise SceneError(f"{place}: {problem}")


_BOX = {"position": "N,3", "size": "N,3", "yaw": "N", "class_id": "N"}
_BUILDINGS = {"building_height": "B", "building_start": "U", "building_corners": "C,2"}
#: Shape of each array: F frames, A agents, N truth rows, D detections, B buildings, C corners of them,
#: S = F * sensors + 1, T = F + 1, U = B + 1.
SHAPES: dict[str, str] = {
    "times_ns": "F",
    "truth_start": "T",
    "points": "N,A",
    "agent_position": "F,A,3",
    "agent_rotation": "F,A,3,3",
    "agent_velocity": "F,A,3",
    "detection_start": "S",
    "detection_truth_id": "D",
    **_BUILDINGS,
    "truth.id": "N",
    "truth.velocity": "N,3",
    **{f"truth.{name}": shape for name, shape in _BOX.items()},
    **{f"detections.{name}": shape.replace("N", "D") for name, shape in _BOX.items()},
    "detections.score": "D",
    "detections.covariance": "D,3,3",
}
#: Arrays that only some recordings have; their shapes are checked in `measurements` and `scans`.
_OPTIONAL = ("measurements.age_ns", "measurements.position", "measurements.rotation", *SCAN_TYPES)
#: Arrays that `Recording.open` reads: times, offsets and buildings.
_OFFSETS = ("truth_start", "detection_start", "scans.start")
_READ_AT_ONCE = ("head", "times_ns", "measurements.age_ns", *_OFFSETS, *_BUILDINGS)
#: Size in bytes from which `Recording.open` leaves the other arrays in their file.
MAPPED_BYTES = 64 << 20
#: Types other than float64.
_TYPES: dict[str, Any] = {
    "points": np.int32,
    "measurements.age_ns": np.int64,
    **SCAN_TYPES,
    **{name: np.uint8 for name in SHAPES if name.endswith("class_id")},
    **{name: np.int64 for name in SHAPES if name.endswith(("_ns", "_start", "id")) and not name.endswith("class_id")},
}
#: Where the number of each kind comes from.
_COUNTED = {
    "F": "times_ns",
    "N": "truth.id",
    "D": "detection_truth_id",
    "B": "building_height",
    "C": "building_corners",
}


def arrays_of_file(
    place: object, arrays: Mapping[str, NDArray[Any]], agents: int, sensors: int
) -> dict[str, NDArray[Any]]:
    """The arrays of SHAPES, and of sweeps, with their types.

    place: of the recording, for messages; agents: A; sensors: of all agents

    Raises SceneError for an array that is missing, of another shape, or not of the numbers that it should hold.
    """
    for name in SHAPES:
        if name not in arrays:
            raise SceneError(f"{place}: {name} is missing")
    check_shapes(place, arrays, agents, sensors)
    return {
        name: _typed(place, name, values)
        for name, values in arrays.items()
        if name in (*SHAPES, *_OPTIONAL) or name.startswith("sweeps.")
    }


def check_shapes(place: object, arrays: Mapping[str, NDArray[Any]], agents: int, sensors: int) -> None:
    """Raise SceneError for the first of the arrays of SHAPES, as far as they are given, with another shape."""
    counts = {"A": agents, "3": 3, "2": 2}
    counts |= {letter: max(arrays[name].shape[:1], default=0) for letter, name in _COUNTED.items() if name in arrays}
    counts |= {"T": counts["F"] + 1, "S": counts["F"] * sensors + 1, "U": counts["B"] + 1}
    for name in SHAPES:
        if name in arrays:
            expected = tuple(counts[letter] for letter in SHAPES[name].split(","))
            if arrays[name].shape != expected:
                raise SceneError(f"{place}: {name} has shape {arrays[name].shape}, expected {expected}")


def check_times(place: object, times_ns: NDArray[np.int64]) -> None:
    """Raise SceneError for a frame that is not later than the one before."""
    late = np.flatnonzero(np.diff(times_ns) <= 0)
    if len(late):
        raise SceneError(f"{place}: frame {late[0] + 1} is not later than frame {late[0]}")


def _typed(place: object, name: str, array: NDArray[Any]) -> NDArray[Any]:
    """An array with its type; raises SceneError if that would change a number."""
    wanted = np.dtype(_TYPES.get(name, np.float32 if name.startswith("sweeps.") else np.float64))
    if array.dtype == wanted:
        return array
    kinds = "iu" if wanted.kind in "iu" else "fiu"
    limits = np.iinfo(wanted) if wanted.kind in "iu" else None
    outside = limits is not None and array.dtype.kind in "iu" and array.size > 0
    if array.dtype.kind not in kinds or (
        outside and limits is not None and (int(array.min()) < limits.min or int(array.max()) > limits.max)
    ):
        raise SceneError(f"{place}: {name} has the type {array.dtype}, expected {wanted}")
    converted: NDArray[Any] = array.astype(wanted)
    return converted


def _check_numbers(
    place: str,
    name: str,
    values: NDArray[Any],
    place_of: Callable[[NDArray[Any]], list[int]] = np.ndarray.tolist,
) -> None:
    """Raise SceneError for a number of an array that is not finite, or a class that is not in CLASSES.

    values: a part of the array, or all;  place_of: from a place in the part to that in the array
    """
    invalid = np.argwhere(~np.isfinite(values))
    if len(invalid):
        number = values[tuple(invalid[0])]
        raise SceneError(f"{place}: {name}{place_of(invalid[0])} is {number}, expected a finite number")
    if name == "truth.class_id" and np.max(values, initial=0) >= len(CLASSES):
        raise SceneError(f"{place}: truth.class_id {np.max(values)} is not in CLASSES")


#: Truth columns of a recording; covariance and score are constant for truth.
TRUTH_COLUMNS = ("id", "position", "velocity", "size", "yaw", "class_id")

#: Lidar returns of an object that counts as seen.
SEEN_RETURNS = 5

_FORMAT = 1
_ORIGIN_STEP_M = 10_000.0
#: What reading a damaged file may raise.
_DAMAGE = (
    *(OSError, ValueError, KeyError, TypeError, AttributeError, IndexError, OverflowError, EOFError),
    *(MemoryError, RuntimeError, TokenError, zipfile.BadZipFile, zlib.error),
)


@contextmanager
def _reading(path: Path) -> Iterator[None]:
    """Turn errors that a damaged file explains into SceneError."""
    try:
        yield
    except _DAMAGE as error:
        raise SceneError(f"{path}: not a prepared scene: {error}") from error


@dataclass(frozen=True, eq=False)
class Recording:
    """F frames of a scene with A agents, S sensors, N truth rows, D detections and B buildings.

    name:               of the scene
    agents:             A agents, the ego first; their sensors, agent by agent, are the S sensors
    period_ns:          int, ns, between two frames
    times_ns:           (F,) int64, ns, time of each frame, ascending
    truth:              N rows, world frame, the rows of a frame together; covariance zero, score one
    truth_start:        (F + 1,) int64: frame f has the rows truth_start[f] to truth_start[f + 1]
    points:             (N, A) int32, lidar returns of each truth row at each agent: the most of one of its sensors
    agent_position:     (F, A, 3) m, world frame
    agent_rotation:     (F, A, 3, 3) active, agent to world
    agent_velocity:     (F, A, 3) m/s, world frame
    detections:         D rows, each in its sensor's frame (agent pose, then the sensor's mount)
    detection_start:    (F * S + 1,) int64: sensor s in frame f has the rows [f * S + s] to [f * S + s + 1]
    detection_truth_id: (D,) int64, id of the object detected, -1 for clutter; for scoring only, never an input
    buildings:          B outlines, each (k, 2) m, world frame, closed without repeating the first corner
    building_height:    (B,) m, z of each building's top in the world frame
    sweeps:             for each agent (F, bands, sectors) float32, m, of its first sensor, see `sensing.raycast`; ():
                        unknown
    measurements:       when the sensors measured; None: in every frame, at its time
    scans:              of real lidars; None: the data has none, or they were not asked for
    notes:              what its source left out or assumed, in sentences, for people
    """

    name: str
    agents: tuple[SceneAgent, ...]
    period_ns: int
    times_ns: Ints
    truth: ObjectStates
    truth_start: Ints
    points: NDArray[np.int32]
    agent_position: Floats
    agent_rotation: Floats
    agent_velocity: Floats
    detections: Detections
    detection_start: Ints
    detection_truth_id: Ints
    buildings: tuple[Floats, ...]
    building_height: Floats
    sweeps: tuple[NDArray[np.float32], ...] = ()
    measurements: Measurements | None = None
    notes: tuple[str, ...] = ()
    scans: RecordedScans | None = None

    def __len__(self) -> int:
        """Number of frames."""
        return len(self.times_ns)

    def nearest(self, frame: int) -> int:
        """The nearest frame that there is: a scene that is shorter than its run keeps its last poses."""
        return min(max(frame, 0), len(self) - 1)

    @property
    def agent_names(self) -> tuple[str, ...]:
        """Names of the agents, in column order."""
        return tuple(agent.name for agent in self.agents)

    @property
    def origin(self) -> tuple[float, float]:
        """x and y, m, of the origin of local planes: the multiples of 10 km nearest to where the first agent begins.

        A scene near the origin of the world has that one, and one in UTM coordinates has its own.
        """
        x, y = np.rint(self.agent_position[0, 0, :2] / _ORIGIN_STEP_M) * _ORIGIN_STEP_M + 0.0
        return float(x), float(y)

    def _rows(self, frame: int) -> slice:
        return slice(int(self.truth_start[frame]), int(self.truth_start[frame + 1]))

    def truth_at(self, frame: int) -> ObjectStates:
        """All objects of a frame, world frame; views, not copies."""
        return self.truth.select(self._rows(frame))

    def points_at(self, frame: int) -> NDArray[np.int32]:
        """(n, A) lidar returns of the rows of `truth_at(frame)` at each agent."""
        return self.points[self._rows(frame)]

    @property
    def sensor_names(self) -> list[str]:
        """Name of each of the S sensors, after that of its agent."""
        return [f"{agent.name}/{sensor.name}" for agent in self.agents for sensor in agent.sensors]

    def column(self, agent: int, sensor: int = 0) -> int:
        """Which of the S sensors one is. agent: row of `agents`; sensor: row of its sensors"""
        return self._first_columns[agent] + sensor

    @cached_property
    def _first_columns(self) -> list[int]:
        """The column of each agent's first sensor, and S; kept, since every detection of a frame needs it."""
        return list(accumulate((len(agent.sensors) for agent in self.agents), initial=0))

    def _detection_rows(self, frame: int, column: int) -> slice:
        index = frame * self._first_columns[-1] + column
        return slice(int(self.detection_start[index]), int(self.detection_start[index + 1]))

    def detections_at(self, frame: int, agent: int, sensor: int = 0) -> Detections:
        """New detections of a sensor in a frame, in the sensor's frame when it measured; views, not copies.

        agent: row of `agents`; sensor: row of its sensors
        """
        return self.detections.select(self._detection_rows(frame, self.column(agent, sensor)))

    def detection_truth_id_at(self, frame: int, agent: int, sensor: int = 0) -> Ints:
        """Truth ids (n,) of `detections_at`, -1 for clutter; for scoring only."""
        return self.detection_truth_id[self._detection_rows(frame, self.column(agent, sensor))]

    def age_ns_at(self, frame: int, agent: int, sensor: int = 0) -> int:
        """Age, ns, of the new measurement of a sensor in a frame; NO_MEASUREMENT: it has none."""
        return 0 if self.measurements is None else int(self.measurements.age_ns[frame, self.column(agent, sensor)])

    def mount_at(self, frame: int, agent: int, sensor: int = 0) -> tuple[Floats, Floats]:
        """Position (3,) m and rotation (3, 3) of a sensor when it measured, in its agent's frame at the frame's time.

        They differ from the sensor's mount by the motion of the agent since the measurement.
        """
        lidar = self.agents[agent].sensors[sensor].lidar
        if self.age_ns_at(frame, agent, sensor) in (0, NO_MEASUREMENT) or self.measurements is None:
            return lidar.mount_position, lidar.mount_rotation
        column = self.column(agent, sensor)
        then, turn = self.measurements.position[frame, column], self.measurements.rotation[frame, column]
        now, to_agent = self.agent_position[frame, agent], self.agent_rotation[frame, agent].T
        if np.array_equal(then, now) and np.array_equal(turn, to_agent.T):  # exactly, for agents that stand
            return lidar.mount_position, lidar.mount_rotation
        return to_agent @ (then + turn @ lidar.mount_position - now), to_agent @ turn @ lidar.mount_rotation

    def sweep_at(self, frame: int, agent: int) -> Floats:
        """(bands, sectors) m that each direction of a sensor is free; (0, 0): unknown.

        agent: row of `agents`
        """
        return self.sweeps[agent][frame].astype(np.float64) if self.sweeps else np.zeros((0, 0))

    def validate(self) -> None:
        """Raise SceneError for the first invalid shape, offset or number.

        The message names its column and frame.
        """
        self._check_structure()
        for name, columns in (("truth", self.truth.columns()), ("detections", self.detections.columns())):
            for column, values in columns.items():
                _check_numbers(self.name, f"{name}.{column}", values)
        for name in ("agent_position", "agent_rotation", "agent_velocity"):
            _check_numbers(self.name, name, getattr(self, name))
        for index, sweep in enumerate(self.sweeps):
            _check_numbers(self.name, f"sweeps.{index}", sweep)
        for name, values in (self.scans.arrays() if self.scans is not None else {}).items():
            _check_numbers(self.name, name, values)
        for frame in range(len(self)):
            self._check_ids(frame, self.truth_at(frame).id)

    def _check_structure(self) -> None:
        """Raise SceneError for the first invalid shape, time, offset or building."""
        f, a, n, d = len(self.times_ns), len(self.agents), len(self.truth), len(self.detections)
        if f == 0 or a == 0:
            raise SceneError(f"{self.name}: {f} frames and {a} agents, expected at least one of each")
        if self.period_ns <= 0:
            raise SceneError(f"{self.name}: period_ns is {self.period_ns}, expected a positive number")
        check_shapes(self.name, self._columns(), a, len(self.sensor_names))
        if len(self.building_height) != len(self.buildings):
            shape = self.building_height.shape
            raise SceneError(f"{self.name}: building_height has shape {shape}, expected {(len(self.buildings),)}")
        if self.sweeps and [(*sweep.shape[:1], sweep.ndim) for sweep in self.sweeps] != [(f, 3)] * a:
            raise SceneError(f"{self.name}: sweeps of {len(self.sweeps)} agents, expected {f} frames of {a} agents")
        if len(set(self.agent_names)) != a:
            raise SceneError(f"{self.name}: agent names repeat: {', '.join(self.agent_names)}")
        check_times(self.name, self.times_ns)
        if self.measurements is not None:
            self.measurements.check(self.name, self.times_ns, self.sensor_names)
        for problem in self.scans.problems(f, a) if self.scans is not None else ():
            raise SceneError(f"{self.name}: {problem}")
        for name, start, rows in (("truth", self.truth_start, n), ("detections", self.detection_start, d)):
            if start[0] != 0 or start[-1] != rows or np.any(np.diff(start) < 0):
                raise SceneError(f"{self.name}: the offsets of {name} do not cover its {rows} rows in order")
        _check_numbers(self.name, "building_height", self.building_height)
        for index, outline in enumerate(self.buildings):
            _check_numbers(self.name, f"buildings[{index}]", outline)
            if outline.ndim != 2 or outline.shape[1:] != (2,) or len(outline) < 3:
                raise SceneError(f"{self.name}: buildings[{index}] has shape {outline.shape}, expected (k >= 3, 2)")

    def _check_ids(self, frame: int, ids: Ints) -> None:
        if len(np.unique(ids)) != len(ids):
            raise SceneError(f"{self.name}: frame {frame} has two truth rows with the same id")

    def _columns(self) -> dict[str, NDArray[Any]]:
        """All arrays by their names in a file, but those of buildings' corners and of sweeps."""
        columns = {f"truth.{name}": getattr(self.truth, name) for name in TRUTH_COLUMNS}
        columns |= {f"detections.{name}": getattr(self.detections, name) for name in DETECTION_COLUMNS}
        return columns | {name: getattr(self, name) for name in _ARRAYS}

    def save(self, path: Path) -> None:
        """Write everything to one .npz file; no pickle inside."""
        header = {
            "format": _FORMAT,
            "name": self.name,
            "period_ns": self.period_ns,
            "agents": [agent_to_json(agent) for agent in self.agents],
        }
        if self.notes:
            header["notes"] = self.notes
        arrays: dict[str, NDArray[Any]] = {"head": np.array(json.dumps(header))}
        arrays |= self._columns()
        arrays |= {f"sweeps.{index}": sweep for index, sweep in enumerate(self.sweeps)}
        if self.measurements is not None:
            arrays |= {f"measurements.{name}": values for name, values in self.measurements.arrays().items()}
        if self.scans is not None:
            arrays |= self.scans.arrays()
        arrays["building_start"] = np.cumsum([0, *map(len, self.buildings)])
        arrays["building_corners"] = np.concatenate([np.zeros((0, 2)), *self.buildings])
        with path.open("wb") as file:
            np.savez(file, allow_pickle=False, **arrays)

    @classmethod
    def load(cls, path: Path) -> Recording:
        """Read a file written by `save`.

        Raises SceneError when the file is missing, broken or of another format.
        """
        with _reading(path):
            with np.load(check_plain(path), allow_pickle=False) as file:
                check_stored(file.zip, path.stat().st_size)
                arrays = {name: file[name] for name in file.files}
            recording = cls._of(path, arrays)
        recording.validate()
        return recording

    @classmethod
    def open(cls, path: Path) -> Recording:
        """Open a file written by `save`, to show frames of it: a large one is not read.

        Of a file of MAPPED_BYTES or more, shapes, times, offsets and buildings are checked now; numbers when they are
        asked for, and the ids of a frame when its truth is. Its arrays are `MappedArray`s: take a part by an index.

        Raises SceneError, now or then, as `load` does; a damaged bit in such a file may pass for another number.
        """
        with _reading(path), open_plain(path) as file:
            if os.fstat(file.fileno()).st_size < MAPPED_BYTES:
                return cls.load(path)
            recording = _OpenedRecording._of(path, mapped_arrays(file))
        recording._check_structure()
        return recording

    @classmethod
    def _of(cls, path: Path, arrays: dict[str, Any]) -> Self:
        """The recording of a file's arrays, whose types are right and whose numbers are not checked."""
        header = json.loads(str(arrays["head"]))
        if header["format"] != _FORMAT:
            raise SceneError(f"{path}: format {header['format']}, expected {_FORMAT}")
        agents = tuple(map(agent_from_json, header["agents"]))
        arrays |= arrays_of_file(path, arrays, len(agents), sum(len(agent.sensors) for agent in agents))
        arrays = cls._held(str(header["name"]), arrays)
        start = arrays["building_start"]
        if start[0] != 0 or start[-1] != len(arrays["building_corners"]) or np.any(np.diff(start) < 0):
            raise SceneError(f"{path}: building_start is {start.tolist()[:8]}, expected offsets of the corners")
        return cls(
            name=str(header["name"]),
            agents=agents,
            period_ns=int(header["period_ns"]),
            truth=truth_states({name: arrays[f"truth.{name}"] for name in TRUTH_COLUMNS}),
            detections=Detections(*(arrays[f"detections.{name}"] for name in DETECTION_COLUMNS)),
            buildings=tuple(np.split(arrays["building_corners"], start[1:-1])) if len(start) > 1 else (),
            sweeps=tuple(arrays[f"sweeps.{i}"] for i in range(len(header["agents"])) if "sweeps.0" in arrays),
            measurements=Measurements(*(arrays[f"measurements.{name}"] for name in _MEASUREMENTS))
            if "measurements.age_ns" in arrays
            else None,
            notes=tuple(map(str, header.get("notes", ()))),
            scans=RecordedScans.from_arrays(arrays) if "scans.start" in arrays else None,
            **{name: arrays[name] for name in _ARRAYS},
        )

    @classmethod
    def _held(cls, name: str, arrays: dict[str, Any]) -> dict[str, Any]:
        """The arrays as they are held in memory. name: of the recording, for messages"""
        for array in arrays.values():
            array.setflags(write=False)  # so that messages need not copy it
        return arrays


class _OpenedRecording(Recording):
    """A recording whose columns stay in its file, see `Recording.open`."""

    def truth_at(self, frame: int) -> ObjectStates:
        truth = super().truth_at(frame)
        self._check_ids(frame, truth.id)
        return truth

    @classmethod
    def _held(cls, name: str, arrays: dict[str, Any]) -> dict[str, Any]:
        read = {key: np.array(arrays[key]) for key in _READ_AT_ONCE if key in arrays}
        mapped = {key: MappedArray(arrays[key], partial(_check_numbers, name, key)) for key in arrays.keys() - read}
        return super()._held(name, read) | mapped


_ARRAYS = tuple(field.name for field in fields(Recording) if field.name in SHAPES)
_MEASUREMENTS = tuple(field.name for field in fields(Measurements))


def truth_states(columns: Mapping[str, NDArray[Any]]) -> ObjectStates:
    """Truth with the given TRUTH_COLUMNS.

    The covariances are n views of one zero matrix.
    """
    n = len(columns["id"])
    return ObjectStates(
        **{name: columns[name] for name in TRUTH_COLUMNS},
        covariance=np.broadcast_to(np.zeros((9, 9)), (n, 9, 9)),
        score=np.ones(n),
    )
