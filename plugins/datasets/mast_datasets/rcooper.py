"""Scenes of RCooper: poles at a junction or along a road."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mast_datasets import dair
from mast_datasets.files import choose_name, entries
from mast_datasets.traffic import ABOVE_0, DataSetScene, Labels, check_times, listed_returns
from mast_zenoh.arrays.states import Floats, Ints
from mast_zenoh.errors import ConfigurationError, SceneError
from mast_zenoh.scenes.making.assembly import SceneBoxes, assemble
from mast_zenoh.scenes.making.virtual_agents import standing
from mast_zenoh.scenes.recording import Recording
from mast_zenoh.sensing import Camera, LidarSensor

_COOPERATIVE = "coop"
_CALIBRATION = "calib/lidar2world"
_TIME = re.compile(r"([0-9]{1,10})(?:\.([0-9]{1,9}))?", re.ASCII)
_LIDAR = LidarSensor(
    mount_position=np.zeros(3), elevation_min_deg=-40.0, elevation_max_deg=15.0, channels=80, max_range_m=200.0
)
_CAMERA = Camera(mount_position=np.zeros(3))


@dataclass(kw_only=True, eq=False)
class RCooperScene(DataSetScene):
    """A sequence of RCooper: two to four poles, with cooperative labels.

    path:                  the folder of the data set, with calib and labels (or label); the names of a site and of a
                           sequence may follow, as in RCooper/106-105/seq-0
    site:                  name of the site, such as "106-105"; None: the only one
    sequence:              name of the sequence, such as "seq-0"; None: the only one
    n_infrastructure:      poles besides the first one; None: all
    n_mobile:              cars; None: 0, the only value
    detector:              the model that generates detections from lidar visibility
    max_time_difference_s: limit on the time between a frame of a pole and the cooperative frame it belongs to
    max_gap_s:             limit on the time between two cooperative frames
    match_radius_m:        a pole sees a cooperative box if it has a label within this distance

    The first pole of the site is "ego", of kind static; the others are "infra_k". The truth are the cooperative labels,
    in the frame of the first pole's lidar. Each pole measures at the times of its own files. An agent's frame is that
    of its lidar; rotations are active.
    """

    short_name = "rcooper"
    files = (("calib/lidar2world/*.json",),)

    site: str | None = None
    sequence: str | None = None
    max_time_difference_s: float = 0.2
    max_gap_s: float = 0.15
    match_radius_m: float = 2.0

    def __post_init__(self) -> None:
        self.check(max_time_difference_s=ABOVE_0, max_gap_s=ABOVE_0, match_radius_m=ABOVE_0)
        for name, expected in zip(("site", "sequence"), _split_path(self.root)[1:], strict=True):
            value = getattr(self, name)
            if None not in (value, expected) and value != expected:
                raise ConfigurationError(f"{self.path}: {name} is {value!r}, expected {expected!r} as in the path")

    def inputs(self) -> Sequence[Path]:
        """The data set's folder."""
        return (_split_path(self.root)[0],)

    def time_differences_s(self) -> dict[str, Floats]:
        """(F,) s that each frame of a pole is later than the cooperative frame, by the pole's number in the data.

        Raises SceneError and ConfigurationError as `record` does.
        """
        folder, agents, sequence = self._folders()
        times, _ = self._frames(folder / _COOPERATIVE / sequence)
        differences = {}
        for agent in agents:
            moments, files = self._frames(own := folder / agent / sequence, len(times))
            differences[agent] = (moments - times) / 1e9
            names = [file.name for file in files]
            dair.check_differences(own, names, f"agent {agent}", differences[agent], self.max_time_difference_s)
        return differences

    def record(self, seed: int, frames: int | None) -> Recording:
        folder, agents, sequence = self._folders()
        (root,) = self.inputs()
        self.time_differences_s()
        cooperative = folder / _COOPERATIVE / sequence
        times, files = self._frames(cooperative)
        check_times(cooperative, [file.name for file in files], times, self.max_gap_s, "max_gap_s")
        poses = [dair.read_transform(root / _CALIBRATION / f"{agent}.json") for agent in agents]
        boxes = _truth(files, poses[0])
        paths = []
        for column, (agent, pose) in enumerate(zip(agents, poses, strict=True)):
            path = standing("ego" if column == 0 else f"infra_{column}", _LIDAR, *pose, len(times))
            seen = np.zeros(len(boxes), bool)
            measured, own_files = self._frames(folder / agent / sequence, len(times))
            for frame, file in enumerate(own_files):
                rows = boxes.frame == frame
                seen[rows] = dair.matched(
                    dair.positions(dair.read_labels(file), *pose), boxes.position[rows], self.match_radius_m
                )
            returns = listed_returns(boxes, path, seen, frames=frames)
            paths.append(replace(path, points=returns, measured_ns=measured))
        return assemble(f"{folder.name} {sequence}", times, boxes, paths, self.detector, seed=seed, frames=frames)

    def _folders(self) -> tuple[Path, list[str], str]:
        """The folder of the site's labels, the poles that play, and the name of the sequence."""
        root, site, sequence = _split_path(self.root)
        if not os.path.isdir(root):
            raise SceneError(f"{root}: no such folder")
        labels = root / "labels"
        labels = labels if os.path.isdir(labels) else root / "label"
        folder = labels / _chosen(labels, "site", self.site or site)
        agents = folder.name.split("-")
        for name in (*agents, _COOPERATIVE):
            if not os.path.isdir(folder / name):
                raise SceneError(f"{folder / name}: no such folder, expected one for every pole and coop")
        if len(set(agents)) != len(agents) or len(agents) < 2:
            raise SceneError(f"{folder}: found agents {', '.join(agents)}, expected at least two different ones")
        _, others = self.playing(agents[:1], agents[1:], "poles besides the ego")
        sequence = _chosen(folder / _COOPERATIVE, "sequence", self.sequence or sequence)
        return folder, [agents[0], *others], sequence

    def _frames(self, folder: Path, count: int | None = None) -> tuple[Ints, list[Path]]:
        """Times (F,) ns and label files of a sequence, in the order of their times.

        count: how many are expected
        """
        files = entries(folder)
        if not files:
            raise SceneError(f"{folder}: found no frames, expected at least one")
        if count is not None and len(files) != count:
            raise SceneError(f"{folder}: found {len(files)} frames, expected {count} as in {_COOPERATIVE}")
        moments = sorted((_time(file), file) for file in files)
        return np.array([time for time, _ in moments], np.int64), [file for _, file in moments]


def _split_path(path: Path) -> tuple[Path, str | None, str | None]:
    """The folder of the data set, and the names of a site and of a sequence if the path ends in them."""
    if not os.path.exists(path) and os.path.isdir(path.parent / _CALIBRATION):
        return path.parent, path.name, None
    if not os.path.exists(path) and os.path.isdir(path.parent.parent / _CALIBRATION):
        return path.parent.parent, path.parent.name, path.name
    return path, None, None


def _truth(files: list[Path], pose: tuple[Floats, Floats]) -> SceneBoxes:
    """The cooperative boxes in the world frame. pose: of the first pole."""
    truth = Labels(files[0].parent)
    for frame, file in enumerate(files):
        labels = dair.read_labels(file)
        for label in labels:
            if not dair.track_of(label):
                label["track_id"].fail("a name or a number")
        dair.add_labels(truth, frame, labels, pose)
    if not truth.tracks:
        raise SceneError(f"{files[0].parent}: found no labels in {len(files)} frames, expected at least one")
    return truth.boxes()[0]


def _chosen(folder: Path, parameter: str, value: str | None) -> str:
    """The name of a folder in `folder`: a parameter's value, or the only one."""
    return choose_name(folder, parameter, (entry.name for entry in entries(folder) if os.path.isdir(entry)), value)


def _time(file: Path) -> int:
    """The time ns in the name of a file, such as 1692685344.814447.json."""
    match = _TIME.fullmatch(file.name.removesuffix(".json"))
    if match is None or file.suffix != ".json":
        raise SceneError(f"{file}: found name {file.name}, expected a time in seconds and .json")
    return int(match[1]) * 10**9 + int((match[2] or "").ljust(9, "0"))
