"""Detections as lines of text: of the KITTI tracking benchmark, and of AB3DMOT."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from mast_zenoh.arrays.geometry import wrap_angle
from mast_zenoh.arrays.states import CLASS_INDEX, Floats
from mast_zenoh.errors import SceneError, nearest
from mast_zenoh.scenes.files.elements import read_text
from mast_zenoh.scenes.own_detections.rows import DetectionRows
from mast_zenoh.scenes.recording import Recording

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


def write(folder: Path, agent: str, recording: Recording, row: int) -> Path:
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
