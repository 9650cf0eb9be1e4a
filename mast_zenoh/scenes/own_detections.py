"""Any scene with the detections of a user's own detector.

Detections in text files (KITTI, AB3DMOT) and Parquet tables, as rows.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.geometry import heading, rotation_from_quaternion, wrap_angle
from mast_zenoh.arrays.states import CLASS_INDEX, CLASSES, Detections, Floats, Ints
from mast_zenoh.errors import SceneError, nearest
from mast_zenoh.scenes.base import Scene
from mast_zenoh.scenes.making.assembly import DetectionColumns
from mast_zenoh.scenes.recording import Recording

#: m, of a coordinate: far beyond any map projection, and its square is far below the limit of a number; of an object's
#: length: of a train.
MAX_COORDINATE_M, MAX_SIZE_M = 1e8, 1000.0


def lines_of_agents(
    path: Path,
    frames: Sequence[int],
    agents: Sequence[int] | Sequence[str],
    key: str,
    *,
    others: bool = True,
    later: bool = True,
) -> Iterator[tuple[str, int, int, list[Any]]]:
    """Yield the list under `key` for the requested frames and agents.

    Each comes with its position in the file, frame row and agent row. agents: as they are called in the file.
    others, later: whether lines of other agents, and of frames before or after these, are left out, or refused
    Raises SceneError if a frame of an agent occurs twice or not at all.
    """
    frame_row = {frame: k for k, frame in enumerate(frames)}
    agent_row = {agent: k for k, agent in enumerate(agents)}
    named = any(isinstance(agent, str) for agent in agents)
    line_numbers: dict[tuple[int, int | str], int] = {}
    try:
        with path.open(encoding="utf-8") as file:
            for number, line in enumerate(file, start=1):
                place = f"{path}: line {number}"
                try:
                    data = json.loads(line, parse_constant=reject_constant)
                    frame_agent = (int(data["frame"]), str(data["agent"]) if named else int(data["agent"]))
                    entries = data[key]
                    if not isinstance(entries, list):
                        raise ValueError(f"{key} is not a list")
                except (ValueError, KeyError, TypeError, OverflowError, RecursionError) as error:
                    raise SceneError(f"{place}: {reason(error)}") from error
                if frame_agent in line_numbers:
                    raise SceneError(
                        f"{place}: frame {frame_agent[0]} of agent {frame_agent[1]} "
                        f"is already in line {line_numbers[frame_agent]}"
                    )
                line_numbers[frame_agent] = number
                if not others and frame_agent[1] not in agent_row:
                    close = nearest(str(frame_agent[1]), [str(agent) for agent in agents])
                    raise SceneError(f"{place}: agent is {frame_agent[1]!r}, which the scene does not have{close}")
                if not later and frame_agent[0] not in frame_row:
                    raise SceneError(f"{place}: frame is {frame_agent[0]}, expected {frames[0]} to {frames[-1]}")
                if frame_agent[0] in frame_row and frame_agent[1] in agent_row:
                    yield place, frame_row[frame_agent[0]], agent_row[frame_agent[1]], entries
    except (OSError, UnicodeDecodeError) as error:
        raise SceneError(f"{path}: {error}") from error
    for frame in frames:
        for agent in agents:
            if (frame, agent) not in line_numbers:
                raise SceneError(
                    f"{path}: no line for frame {frame}, agent {agent}; use an empty list if nothing was detected"
                )


def reject_constant(name: str) -> NoReturn:
    """Refuse a number that is not finite, for `json.loads(parse_constant=)`."""
    raise ValueError(f"{name} is not a finite number")


def reason(error: Exception) -> str:
    """Why decoding failed, in words."""
    return f"{error} is missing" if isinstance(error, KeyError) else str(error)


def read_json_lines(
    path: Path,
    frames: Sequence[int],
    agents: Sequence[int] | Sequence[str],
    sensor_rotation: Floats,
    *,
    others: bool = True,
    later: bool = True,
) -> DetectionColumns:
    """The detections of a recording, in the order of the file.

    frames: F frame numbers, and agents: A agents, as they are called in the file
    sensor_rotation: (F, A, 3, 3) active, sensor to world; needed for detections that have an attitude in the sensor's
    frame instead of a yaw
    others, later: see `lines_of_agents`

    Raises SceneError with the line.
    """
    rows: dict[tuple[int, int], tuple[Detections, Ints]] = {}
    for place, frame, agent, data in lines_of_agents(path, frames, agents, "detections", others=others, later=later):
        rotation = sensor_rotation[frame, agent]
        try:
            rows[frame, agent] = _detections(data, rotation)
        except (ValueError, KeyError, TypeError, OverflowError) as error:
            raise SceneError(f"{place}: {reason(error)}") from error
    ordered = [rows[frame, agent] for frame in range(len(frames)) for agent in range(len(agents))]
    flat = Detections.joined([part for part, _ in ordered])
    ids = np.concatenate([truth_id for _, truth_id in ordered])
    return flat, np.cumsum([0, *(len(part) for part, _ in ordered)]), ids


def _detections(data: Sequence[Mapping[str, Any]], sensor_rotation: Floats) -> tuple[Detections, Ints]:
    n = len(data)
    numbers = np.array([[float(d[key]) for key in ("x", "y", "z", "l", "w", "h")] for d in data]).reshape(n, 6)
    yaw = np.array([float(d["yaw"]) if "yaw" in d else _yaw(d["q"], sensor_rotation) for d in data])
    score = np.array([float(d.get("score", 1.0)) for d in data])
    covariance = np.array([d.get("covariance", np.zeros((3, 3))) for d in data], np.float64).reshape(n, 3, 3)
    for name, values in (("x, y, z, l, w, h", numbers), ("yaw", yaw), ("covariance", covariance)):
        if not np.isfinite(values).all():
            raise ValueError(f"{name} contains a number that is not finite")
    for name, values, valid, expected in (
        ("x, y, z", numbers[:, :3], np.abs(numbers[:, :3]) <= MAX_COORDINATE_M, f"at most {MAX_COORDINATE_M:g} m"),
        ("l, w, h", sizes := numbers[:, 3:], (sizes > 0) & (sizes <= MAX_SIZE_M), f"above 0, at most {MAX_SIZE_M:g} m"),
        ("score", score, (score >= 0) & (score <= 1), "0 to 1"),
    ):
        if not valid.all():
            raise ValueError(f"{name}: found {values[~valid][0]:g}, expected {expected}")
    classes = np.array([class_of(str(d.get("class", "unknown"))) for d in data], np.uint8)
    truth_id = np.array([int(d.get("gt", -1)) for d in data], np.int64)
    return Detections(numbers[:, :3], numbers[:, 3:], yaw, score, classes, covariance), truth_id


def _yaw(q: Sequence[float], sensor_rotation: Floats) -> float:
    """Yaw about the world's vertical minus the sensor's.

    q: passive attitude (w, x, y, z) in the sensor's frame
    """
    if len(q) != 4:
        raise ValueError(f"q has {len(q)} numbers, expected 4")
    rotation = sensor_rotation @ rotation_from_quaternion(np.array(q, np.float64) * [1.0, -1.0, -1.0, -1.0])
    return float(heading(rotation) - heading(sensor_rotation))


class OwnDetections(Scene):
    """A scene whose detections come from files, see docs/how-to-scenes.md.

    scene:       where everything else comes from
    path:        a .jsonl or .parquet file, or a folder with a text file for each agent (KITTI, AB3DMOT)
    first_frame: number of the scene's first frame in the files

    Each agent has one sensor, its first, which measures at the times of the frames.
    In a scenario, `detections` of any scene makes one: dict(type="AV2Log", path=…, detections=PATH).
    """

    def __init__(self, *, scene: Scene, path: str, first_frame: int = 0) -> None:
        self.scene = scene
        self.path = Path(path)
        self.first_frame = first_frame

    def inputs(self) -> Sequence[Path]:
        """The scene's inputs and the detections."""
        return (*self.scene.inputs(), self.path)

    def record(self, seed: int, frames: int | None) -> Recording:
        recording = self.scene.record(seed, frames)
        detections, start, truth_id = self._read(recording, shortened=frames is not None)
        agents = tuple(replace(agent, sensors=()) for agent in recording.agents)
        complete = replace(
            recording,
            agents=agents,
            detections=detections,
            detection_start=start,
            detection_truth_id=truth_id,
            measurements=None,
        )
        complete.validate()
        return complete

    def _read(self, recording: Recording, shortened: bool) -> DetectionColumns:
        """The detections of the recorded frames; later ones are an error unless the recording is shortened."""
        names, count = recording.agent_names, len(recording)
        if self.path.suffix == ".jsonl":
            mounts = np.stack([agent.sensor.mount_rotation for agent in recording.agents])
            numbers = range(self.first_frame, self.first_frame + count)
            rotation = recording.agent_rotation @ mounts
            return read_json_lines(self.path, numbers, names, rotation, others=False, later=shortened)
        if self.path.suffix == ".parquet":
            rows = read_parquet(self.path, names, self.first_frame)
        elif self.path.is_dir():
            rows = read_kitti(self.path, names, self.first_frame)
        else:
            raise SceneError(f"{self.path}: found no such folder, expected a folder, a .jsonl or a .parquet file")
        return (rows.before(count) if shortened else rows).columns(count, len(names), self.path)


_CLASSES = {
    "van": "car",
    "walker": "pedestrian",
    "person": "pedestrian",
    "cyclist": "bicycle",
    "bike": "bicycle",
    "motorbike": "motorcycle",
}


def class_of(name: str) -> int:
    """The index into CLASSES of a type name; 0 (unknown) for other names."""
    return CLASS_INDEX.get(_CLASSES.get(name.lower(), name.lower()), 0)


#: Limit on the size of one file, bytes.
MAX_FILE_BYTES = 500_000_000


@dataclass(frozen=True, eq=False)
class DetectionRows:
    """D detections of all frames and agents, in any order; in the frame of the sensor that made them.

    place:    (D,) text, where each is in its file, for messages
    frame:    (D,) int64, row of the scene's frames;  agent: (D,) int64, row of its agents
    position: (D, 3) m, middle of the box;  size: (D, 3) m, length, width, height;  yaw: (D,) rad
    score:    (D,) 0 to 1
    class_id: (D,) uint8, index into CLASSES;  covariance: (D, 3, 3) m², all zero if not given
    truth_id: (D,) int64, id of the detected object, -1 if it is clutter or not known; for scoring only
    """

    place: Sequence[str]
    frame: Ints
    agent: Ints
    position: Floats
    size: Floats
    yaw: Floats
    score: Floats
    class_id: NDArray[np.uint8]
    covariance: Floats
    truth_id: Ints

    def before(self, frames: int) -> DetectionRows:
        """The rows of the first frames only."""
        kept = np.flatnonzero(self.frame < frames)
        arrays = {field.name: getattr(self, field.name)[kept] for field in fields(self) if field.name != "place"}
        return DetectionRows(place=[self.place[row] for row in kept.tolist()], **arrays)

    def columns(self, frames: int, agents: int, path: Path) -> DetectionColumns:
        """The columns of a recording; the rows of a frame and an agent stay in their order.

        Raises SceneError for the first row that cannot be. path: of the file, for the message.
        """
        self._check(frames, agents, path)
        group = self.frame * agents + self.agent
        order = np.argsort(group, kind="stable")
        yaw = wrap_angle(self.yaw)
        unordered = Detections(self.position, self.size, yaw, self.score, self.class_id, self.covariance)
        detections = unordered.select(order)
        start = np.searchsorted(group[order], np.arange(frames * agents + 1)).astype(np.int64)
        return detections, start, self.truth_id[order]

    def _check(self, frames: int, agents: int, path: Path) -> None:
        covariance = self.covariance
        symmetric = np.abs(covariance - np.swapaxes(covariance, 1, 2)).max(axis=(1, 2), initial=0.0) <= 1e-9
        smallest = np.linalg.eigvalsh(np.nan_to_num(covariance)).min(axis=1, initial=0.0)
        for name, valid, expected in (
            ("frame", (self.frame >= 0) & (self.frame < frames), f"0 to {frames - 1}"),
            ("agent", (self.agent >= 0) & (self.agent < agents), f"0 to {agents - 1}"),
            ("position", (np.abs(self.position) <= MAX_COORDINATE_M).all(axis=1), f"at most {MAX_COORDINATE_M:g} m"),
            ("size", ((self.size > 0) & (self.size <= MAX_SIZE_M)).all(axis=1), f"above 0, at most {MAX_SIZE_M:g} m"),
            ("yaw", np.isfinite(self.yaw), "a finite number, rad"),
            ("score", (self.score >= 0) & (self.score <= 1), "0 to 1"),
            ("class_id", self.class_id < len(CLASSES), f"0 to {len(CLASSES) - 1}"),
            ("covariance", np.isfinite(covariance).all(axis=(1, 2)), "finite numbers, m²"),
            ("covariance", symmetric & (smallest >= -1e-9), "a symmetric matrix without negative eigenvalues"),
        ):
            if not valid.all():
                row = int(np.flatnonzero(~valid)[0])
                raise SceneError(
                    f"{path}: {self.place[row]}: {name} is {getattr(self, name)[row].tolist()}, expected {expected}"
                )


#: Numbers of a line of AB3DMOT: frame, type, left, top, right, bottom, score, h, w, l, x, y, z, rotation_y, alpha.
_AB3DMOT = 15
#: Words of a line of KITTI tracking: frame, track, type, truncated, occluded, alpha, left, top, right, bottom, h, w, l,
#: x, y, z, rotation_y, score.
_KITTI = 18
#: Types of AB3DMOT by number, and of KITTI by name.
_NUMBERED = {1: "pedestrian", 2: "car", 3: "bicycle"}
_NAMED = {
    **dict.fromkeys(("car", "van"), "car"),
    **dict.fromkeys(("pedestrian", "person_sitting", "person"), "pedestrian"),
    **dict.fromkeys(("cyclist", "bicycle"), "bicycle"),
    **dict.fromkeys(("truck", "tram"), "truck"),
    "bus": "bus",
    "motorcycle": "motorcycle",
    "misc": "unknown",
}


def read_text(path: Path) -> str:
    """The content of a text file in UTF-8. Raises SceneError if it is missing or too large."""
    try:
        size = path.stat().st_size
        if not path.is_file():  # a pipe would be waited for
            raise OSError("not a regular file")
        if size > MAX_FILE_BYTES:
            raise SceneError(f"{path}: found {size} bytes, expected at most {MAX_FILE_BYTES}")
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise SceneError(f"{path}: {error}") from error


def read_kitti(folder: Path, agents: Sequence[str], first_frame: int) -> DetectionRows:
    """The detections in `<agent>.txt` of a folder, with a line for each.

    first_frame: number of the scene's first frame in the files. A frame without lines has no detections.

    If any score is outside 0 to 1, all are mapped by the logistic function.

    Lines with commas are AB3DMOT's, others KITTI's. The box is in camera axes (x right, y down, z ahead, m) with its
    origin at the sensor; (x, y, z) is the middle of its underside, rotation_y its heading about the axis down, 0 to the
    right (Geiger, Lenz, Urtasun: Are we ready for autonomous driving?, CVPR 2012, and its development kit).

    Raises SceneError with the file and the line.
    """
    if not folder.is_dir():
        raise SceneError(f"{folder}: no such folder, expected one with {', '.join(f'{name}.txt' for name in agents)}")
    places: list[str] = []
    table: list[tuple[float, ...]] = []
    for row, agent in enumerate(agents):
        file = folder / f"{agent}.txt"
        if not file.is_file():
            found = sorted(path.stem for path in folder.glob("*.txt"))
            raise SceneError(f"{file}: no such file, expected one for each agent{nearest(agent, found)}")
        for number, line in enumerate(read_text(file).splitlines(), start=1):
            if line.strip():
                places.append(f"{agent}.txt: line {number}")
                table.append((row, *_line(file, number, line)))
    data = np.array(table, np.float64).reshape(-1, 11)
    _, frame, class_id, score, height, width, length, x, y, z, turn = data.T
    return DetectionRows(
        place=places,
        frame=frame.astype(np.int64) - first_frame,
        agent=data[:, 0].astype(np.int64),
        position=np.column_stack([z, -x, height / 2 - y]),
        size=np.column_stack([length, width, height]),
        yaw=-turn - np.pi / 2,
        score=_confidence(score),
        class_id=class_id.astype(np.uint8),
        covariance=np.zeros((len(data), 3, 3)),
        truth_id=np.full(len(data), -1, np.int64),
    )


def _confidence(score: Floats) -> Floats:
    """Scores from 0 to 1; NaN stays, and is refused later."""
    if ((score >= 0.0) & (score <= 1.0)).all():
        return score
    return 1.0 / (1.0 + np.exp(-np.clip(score, -500.0, 500.0)))


def _line(file: Path, number: int, line: str) -> tuple[float, ...]:
    """frame, class index, score, h, w, l, x, y, z, rotation_y of a line."""
    place = f"{file}: line {number}"
    commas = "," in line
    words = [word.strip() for word in line.split(",")] if commas else line.split()
    expected = _AB3DMOT if commas else _KITTI
    if len(words) != expected:
        kind = "numbers with commas" if commas else "words, or 15 numbers with commas"
        raise SceneError(f"{place}: found {len(words)} values, expected {expected} {kind}")
    try:
        if commas:
            numbers = [float(word) for word in words]
            frame, kind_number, score, box = numbers[0], numbers[1], numbers[6], numbers[7:14]
            class_name = _NUMBERED.get(int(kind_number), "unknown") if np.isfinite(kind_number) else "unknown"
        else:
            frame, score, box = float(words[0]), float(words[17]), [float(word) for word in words[10:17]]
            class_name = _NAMED.get(words[2].lower(), "unknown")
    except ValueError as error:
        raise SceneError(f"{place}: {error}") from None
    if not frame.is_integer() or abs(frame) > 1e9:
        raise SceneError(f"{place}: found frame {frame:g}, expected a whole number")
    return (frame, CLASS_INDEX[class_name], score, *box)


def write_detections(folder: Path, agent: str, recording: Recording, row: int) -> Path:
    """Write the detections of an agent of a recording as lines of AB3DMOT, and return the file.

    row: of the agent in the recording. Covariances, true ids and other classes have no place in the file.
    """
    numbers = {CLASS_INDEX[name]: number for number, name in _NUMBERED.items()}
    lines = []
    for frame in range(len(recording)):
        found = recording.detections_at(frame, row)
        for position, size, yaw, score, class_id in zip(
            found.position, found.size, found.yaw, found.score, found.class_id.tolist(), strict=True
        ):
            length, width, height = size
            ahead, left, up = position
            turn = wrap_angle(-yaw - np.pi / 2)
            values = (score, height, width, length, -left, height / 2 - up, ahead, turn)
            kind = numbers.get(class_id, 0)
            lines.append(",".join([str(frame), str(kind), "0,0,0,0", *(f"{value:.6f}" for value in values), "0"]))
    file = folder / f"{agent}.txt"
    file.write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")
    return file


_NEEDED = ("frame", "agent", "x", "y", "z", "l", "w", "h", "yaw")
#: Position covariance, m²; all six or none.
_COVARIANCE = ("xx", "xy", "xz", "yy", "yz", "zz")
_OPTIONAL = ("score", "class", "truth_id", *_COVARIANCE)


def read_parquet(path: Path, agents: Sequence[str], first_frame: int) -> DetectionRows:
    """The detections in a Parquet file, see docs/how-to-scenes.md.

    first_frame: number of the scene's first frame in the file. A frame without rows has no detections.
    Raises SceneError with the column and the row.
    """
    table = _open(path)
    columns = {name: read_column(path, table, name, "float64") for name in ("x", "y", "z", "l", "w", "h", "yaw")}
    count, given = table.num_rows, set(table.column_names)
    classes = read_column(path, table, "class", "string") if "class" in given else ["unknown"] * count
    return DetectionRows(
        place=[f"row {row}" for row in range(count)],
        frame=_whole_numbers(path, table, "frame") - first_frame,
        agent=_rows_of_agents(path, read_column(path, table, "agent", "string").tolist(), agents),
        position=np.column_stack([columns[name] for name in ("x", "y", "z")]),
        size=np.column_stack([columns[name] for name in ("l", "w", "h")]),
        yaw=columns["yaw"],
        score=read_column(path, table, "score", "float64") if "score" in given else np.ones(count),
        class_id=np.array([class_of(name) for name in classes], np.uint8),
        covariance=_covariance(path, table),
        truth_id=_whole_numbers(path, table, "truth_id") if "truth_id" in given else np.full(count, -1, np.int64),
    )


def _open(path: Path) -> Any:
    import pyarrow  # takes 0.15 s, and every run imports this module

    from mast_zenoh.run_folder import unpacking

    try:
        return unpacking.read_parquet(path, (*_NEEDED, *_OPTIONAL))
    except (OSError, ValueError, pyarrow.ArrowException) as error:
        raise SceneError(f"{path}: cannot be read as Parquet: {error}") from error


def read_column(path: Path, table: Any, name: str, kind: str) -> NDArray[Any]:
    """A column of a table of pyarrow, as "float64", "int64" or "string". path: of its file, for the message

    Raises SceneError if it is missing, has empty values or holds something else.
    """
    import pyarrow

    from mast_zenoh.run_folder.unpacking import check_expanded

    if table.column_names.count(name) > 1:
        raise SceneError(f"{path}: column {name} occurs twice")
    if name not in table.column_names:
        raise SceneError(f"{path}: column {name} is missing{nearest(name, table.column_names)}")
    column = table[name]
    if column.null_count:
        raise SceneError(f"{path}: column {name} has {column.null_count} empty values")
    try:
        if kind == "string":
            check_expanded(column)
            return np.array(column.cast(kind).to_pylist(), np.str_)
        return np.asarray(column.cast(kind).to_numpy(), kind)
    except (ValueError, pyarrow.ArrowException) as error:
        meaning = "text" if kind == "string" else "numbers"
        raise SceneError(f"{path}: column {name} is not of {meaning}: {error}") from error


def _whole_numbers(path: Path, table: Any, name: str) -> NDArray[np.int64]:
    values = read_column(path, table, name, "float64")
    invalid = np.flatnonzero(~((values == np.round(values)) & (np.abs(values) < 2**53)))
    if len(invalid):
        raise SceneError(f"{path}: row {invalid[0]}: {name} is {values[invalid[0]]}, expected a whole number")
    return values.astype(np.int64)


def _rows_of_agents(path: Path, names: Sequence[str], agents: Sequence[str]) -> NDArray[np.int64]:
    rows = {name: row for row, name in enumerate(agents)}
    for row, name in enumerate(names):
        if name not in rows:
            raise SceneError(
                f"{path}: row {row}: agent is {name!r}, which the scene does not have{nearest(name, agents)}"
            )
    return np.array([rows[name] for name in names], np.int64)


def _covariance(path: Path, table: Any) -> NDArray[np.float64]:
    """(n, 3, 3) m²; zero without these columns."""
    given = [name for name in _COVARIANCE if name in table.column_names]
    if not given:
        return np.zeros((table.num_rows, 3, 3))
    if len(given) < len(_COVARIANCE):
        raise SceneError(f"{path}: covariance has the columns {', '.join(given)}, expected {', '.join(_COVARIANCE)}")
    xx, xy, xz, yy, yz, zz = (read_column(path, table, name, "float64") for name in _COVARIANCE)
    return np.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz], axis=1).reshape(-1, 3, 3)
