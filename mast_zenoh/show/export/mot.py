"""MOTChallenge: boxes of one sequence on the ground, seen from above, in metres."""

from __future__ import annotations

import re
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from mast_zenoh.arrays.geometry import box_corners
from mast_zenoh.arrays.states import Floats, ObjectStates
from mast_zenoh.runs.frame import Frame
from mast_zenoh.runs.recorded import frames_of
from mast_zenoh.runs.routes import TRUTH
from mast_zenoh.runs.run import Run
from mast_zenoh.scenes.recording import SEEN_RETURNS
from mast_zenoh.show.export.columns import stem


def write(run: Run, path: Path) -> None:
    """Write gt/RUN and trackers/ESTIMATE/data, as TrackEval expects them, and the list of sequences."""
    name = re.sub(r"[^\w-]", "_", run.id)
    sequence = path / "gt" / name
    files = {series: path / "trackers" / stem(series) / "data" / f"{name}.txt" for series in run.topics}
    files[TRUTH] = sequence / "gt" / "gt.txt"
    for file in files.values():
        file.parent.mkdir(parents=True)
    length, times = 0, []
    with ExitStack() as stack:
        opened = {series: stack.enter_context(file.open("w", encoding="ascii")) for series, file in files.items()}
        for frame in frames_of(run):
            length = frame.index + 1
            times.append(frame.time_ns)
            for series, states in frame.objects.items():
                opened[series].writelines(_truth(frame) if series == TRUTH else _tracks(frame, states))
    rate = 1e9 / np.median(np.diff(times)) if len(times) > 1 else 10.0
    ini = {"name": name, "frameRate": f"{rate:g}", "seqLength": length}
    lines = "".join(f"{key}={value}\n" for key, value in ini.items())
    (sequence / "seqinfo.ini").write_text(f"[Sequence]\n{lines}", encoding="ascii")
    (path / "seqmap.txt").write_text(f"name\n{name}\n", encoding="ascii")


def _truth(frame: Frame) -> list[str]:
    """frame, id, left, top, width, height, whether it is evaluated, class 1, visibility.

    An object that no agent sees is not evaluated.
    """
    states = frame.objects[TRUTH]
    seen = frame.points.max(axis=1, initial=0) >= SEEN_RETURNS
    return [
        ",".join([*words, str(int(flag)), "1", "1"]) + "\n"
        for words, flag in zip(_boxes(frame, states), seen.tolist(), strict=True)
    ]


def _tracks(frame: Frame, states: ObjectStates) -> list[str]:
    """frame, id, left, top, width, height, score, and -1 for the three world coordinates."""
    return [
        ",".join([*words, f"{score:.6f}", "-1", "-1", "-1"]) + "\n"
        for words, score in zip(_boxes(frame, states), states.score.tolist(), strict=True)
    ]


def _boxes(frame: Frame, states: ObjectStates) -> list[list[str]]:
    """Number of the frame from 1, id, and x, y, width and height, m, of the rectangle around each outline."""
    corners: Floats = box_corners(states.position, states.size, states.yaw)[:, :4, :2]
    low, high = corners.min(axis=1), corners.max(axis=1)
    rectangles = np.concatenate([low, high - low], axis=1)
    return [
        [str(frame.index + 1), str(number), *(f"{value:.6f}" for value in rectangle)]
        for number, rectangle in zip(states.id.tolist(), rectangles, strict=True)
    ]
