"""Any scene with the detections of a user's own detector."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from mast_zenoh.errors import SceneError
from mast_zenoh.scenes.base import Scene
from mast_zenoh.scenes.making.assembly import DetectionColumns
from mast_zenoh.scenes.own_detections.json_lines import read_json_lines
from mast_zenoh.scenes.own_detections.kitti import read_kitti
from mast_zenoh.scenes.own_detections.parquet import read_parquet
from mast_zenoh.scenes.recording import Recording


class OwnDetections(Scene):
    """A scene whose detections come from files, see docs/scenes.md.

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
            return read_json_lines(self.path, numbers, names, recording.agent_rotation @ mounts)
        if self.path.suffix == ".parquet":
            rows = read_parquet(self.path, names, self.first_frame)
        elif self.path.is_dir():
            rows = read_kitti(self.path, names, self.first_frame)
        else:
            raise SceneError(f"{self.path}: found no such folder, expected a folder, a .jsonl or a .parquet file")
        return (rows.before(count) if shortened else rows).columns(count, len(names), self.path)
