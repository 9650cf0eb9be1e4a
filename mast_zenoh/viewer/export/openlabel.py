"""ASAM OpenLABEL 1.0: a file for the truth and for each estimate, with cuboids in the world frame."""

from __future__ import annotations

import json
from collections import Counter, defaultdict
from collections.abc import Sequence
from contextlib import ExitStack
from itertools import pairwise
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from mast_zenoh.arrays.geometry import scalar_last_quaternions
from mast_zenoh.metrics.record import Series
from mast_zenoh.viewer.export.columns import class_names, standard_deviations, stem
from mast_zenoh.viewer.frame import Frame, Pose
from mast_zenoh.viewer.recorded import RecordedRun
from mast_zenoh.viewer.routes import TRUTH

#: Name of the data with an object's box.
CUBOID = "box"


def write(run: RecordedRun, path: Path) -> None:
    """Write the files into a folder, frame by frame."""
    path.mkdir()
    with ExitStack() as stack:
        files = {
            series: _File(stack.enter_context((path / f"{stem(series)}.json").open("w", encoding="utf-8")))
            for series in run.topics
        }
        for frame in run:
            for series in frame.objects:
                files[series].add(frame.index, _frame(frame, series))
        for series, file in files.items():
            file.end(run, series)


class _File:
    """Writes a file: first its frames, then what is known only after them."""

    def __init__(self, file: TextIO) -> None:
        self.file = file
        self.numbers: list[int] = []
        self.present: defaultdict[str, list[int]] = defaultdict(list)
        self.kinds: defaultdict[str, Counter[str]] = defaultdict(Counter)
        file.write('{"openlabel": {"frames": {')

    def add(self, number: int, content: dict[str, Any]) -> None:
        """Write a frame."""
        self.file.write(f'{", " if self.numbers else ""}"{number}": {json.dumps(content)}')
        self.numbers.append(number)
        for track, element in content["objects"].items():
            self.present[track].append(number)
            self.kinds[track][element["object_data"]["cuboid"][0]["attributes"]["text"][0]["val"]] += 1

    def end(self, run: RecordedRun, series: Series) -> None:
        """Write the objects, the coordinate systems and the metadata."""
        objects = {
            track: {
                "name": f"{stem(series)} {track}",
                "type": self.kinds[track].most_common(1)[0][0],
                "coordinate_system": "world",
                "frame_intervals": _intervals(present),
                "object_data_pointers": {CUBOID: {"type": "cuboid", "frame_intervals": _intervals(present)}},
            }
            for track, present in self.present.items()
        }
        systems = {"world": {"type": "local", "parent": "", "children": list(run.agents)}}
        systems |= {agent: {"type": "local", "parent": "world", "children": []} for agent in run.agents}
        content = {
            "metadata": {
                "schema_version": "1.0.0",
                "name": f"{run.id}: {stem(series)}",
                "annotator": "mast-zenoh",
                "comment": "x east, y north, z up, m; sizes are length, width, height",
            },
            "coordinate_systems": systems,
            "frame_intervals": _intervals(self.numbers),
            "objects": objects,
        }
        self.file.write(f"}}, {json.dumps(content)[1:]}}}\n")


def _frame(frame: Frame, series: Series) -> dict[str, Any]:
    """A frame: time in s, poses of the agents, and the objects by id."""
    states, outcomes = frame.objects[series], frame.outcomes[series]
    values = np.concatenate([states.position, scalar_last_quaternions(states.yaw), states.size], axis=1).tolist()
    deviations = np.nan_to_num(standard_deviations(states), nan=-1.0).tolist()
    objects: dict[str, Any] = {}
    for k, (track, kind) in enumerate(zip(states.id.tolist(), class_names(states), strict=True)):
        vectors = [{"name": "velocity", "val": states.velocity[k].tolist()}]
        attributes: dict[str, Any] = {
            "text": [{"name": "class", "val": kind}, {"name": "outcome", "val": outcomes.names[k]}],
            "vec": vectors,
        }
        if series != TRUTH:
            vectors.append({"name": "standard_deviation", "val": deviations[k]})
            attributes["num"] = [{"name": "score", "val": float(states.score[k])}]
        cuboid = {"name": CUBOID, "val": values[k], "coordinate_system": "world", "attributes": attributes}
        objects[str(track)] = {"object_data": {"cuboid": [cuboid]}}
    transforms = {
        f"{agent}_to_world": {"src": agent, "dst": "world", "transform_src_to_dst": {"matrix4x4": _matrix(pose)}}
        for agent, pose in frame.poses.items()
    }
    return {"objects": objects, "frame_properties": {"timestamp": frame.time_ns * 1e-9, "transforms": transforms}}


def _matrix(pose: Pose) -> list[float]:
    """The 16 numbers of the transform from an agent's frame to the world, row by row."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = pose.rotation, pose.position
    values: list[float] = matrix.ravel().tolist()
    return values


def _intervals(numbers: Sequence[int]) -> list[dict[str, int]]:
    """Intervals of consecutive numbers, which ascend."""
    starts = [numbers[0], *(b for a, b in pairwise(numbers) if b > a + 1)] if numbers else []
    ends = [*(a for a, b in pairwise(numbers) if b > a + 1), numbers[-1]] if numbers else []
    return [{"frame_start": start, "frame_end": end} for start, end in zip(starts, ends, strict=True)]
