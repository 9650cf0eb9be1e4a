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
from mast_datasets.traffic import ABOVE_0, DataSetScene, check_times, listed_returns
from mast_zenoh.arrays.states import Floats, Ints
from mast_zenoh.errors import SceneError
from mast_zenoh.scenes.making.assembly import assemble, standing
from mast_zenoh.scenes.recording import Recording
from mast_zenoh.sensing import LidarSensor

_COOPERATIVE = "coop"
_CALIBRATION = "calib/lidar2world"
#: Times (F,) ns and label files of a sequence.
_Clock = tuple[Ints, list[Path]]
_TIME = re.compile(r"([0-9]{1,10})(?:\.([0-9]{1,9}))?", re.ASCII)
_LIDAR = LidarSensor(
    mount_position=np.zeros(3), elevation_min_deg=-40.0, elevation_max_deg=15.0, channels=80, max_range_m=200.0
)


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
        self.chosen(_CALIBRATION, "site", "sequence")

    def inputs(self) -> Sequence[Path]:
        """The data set's folder."""
        return (self.chosen(_CALIBRATION, "site", "sequence")[0],)

    def time_differences_s(self) -> dict[str, Floats]:
        """(F,) s that each frame of a pole is later than the cooperative frame, by the pole's number in the data.

        Raises SceneError and ConfigurationError as `record` does.
        """
        (times, _), poles = self._clocks(*self._folders())
        return {agent: (moments - times) / 1e9 for agent, (moments, _) in poles.items()}

    def record(self, seed: int, frames: int | None) -> Recording:
        folder, agents, sequence = self._folders()
        (times, files), poles = self._clocks(folder, agents, sequence)
        names = [file.name for file in files]
        check_times(folder / _COOPERATIVE / sequence, names, times, self.max_gap_s, "max_gap_s")
        (root,) = self.inputs()
        poses = [dair.read_transform(root / _CALIBRATION / f"{agent}.json") for agent in agents]
        listed = [
            [dair.Side(file, *pose) for file in own] for (_, own), pose in zip(poles.values(), poses, strict=True)
        ]
        labelled = [(file, poses[0], sides) for file, *sides in zip(files, *listed, strict=True)]
        truth = dair.read_truth(labelled, times, self.match_radius_m)
        paths = []
        for column, ((measured, _), pose) in enumerate(zip(poles.values(), poses, strict=True)):
            path = standing("ego" if column == 0 else f"infra_{column}", _LIDAR, *pose, len(times))
            returns = listed_returns(truth.boxes, path, truth.seen[:, column], frames=frames)
            paths.append(replace(path, points=returns, measured_ns=measured))
        return assemble(f"{folder.name} {sequence}", times, truth.boxes, paths, self.detector, seed=seed, frames=frames)

    def _folders(self) -> tuple[Path, list[str], str]:
        """The folder of the site's labels, the poles that play, and the name of the sequence."""
        root, (site, sequence) = self.chosen(_CALIBRATION, "site", "sequence")
        if not os.path.isdir(root):
            raise SceneError(f"{root}: no such folder")
        labels = root / "labels"
        labels = labels if os.path.isdir(labels) else root / "label"
        folder = labels / _folder_in(labels, "site", site)
        agents = folder.name.split("-")
        if len(set(agents)) != len(agents) or len(agents) < 2:
            raise SceneError(f"{folder}: found agents {', '.join(agents)}, expected at least two different ones")
        _, others = self.playing(agents[:1], agents[1:], "poles besides the ego")
        return folder, [agents[0], *others], _folder_in(folder / _COOPERATIVE, "sequence", sequence)

    def _clocks(self, folder: Path, agents: list[str], sequence: str) -> tuple[_Clock, dict[str, _Clock]]:
        """The cooperative frames, and those of the poles, by their numbers in the data."""
        times, files = self._frames(folder / _COOPERATIVE / sequence)
        poles = {agent: self._frames(folder / agent / sequence, len(times)) for agent in agents}
        for agent, (moments, own) in poles.items():
            names, difference_s = [file.name for file in own], (moments - times) / 1e9
            dair.check_differences(own[0].parent, names, f"agent {agent}", difference_s, self.max_time_difference_s)
        return (times, files), poles

    def _frames(self, folder: Path, count: int | None = None) -> _Clock:
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


def _folder_in(folder: Path, parameter: str, value: str | None) -> str:
    """The name of a folder in `folder`: a parameter's value, or the only one."""
    return choose_name(folder, parameter, (entry.name for entry in entries(folder) if os.path.isdir(entry)), value)


def _time(file: Path) -> int:
    """The time ns in the name of a file, such as 1692685344.814447.json."""
    match = _TIME.fullmatch(file.name.removesuffix(".json"))
    if match is None or file.suffix != ".json":
        raise SceneError(f"{file}: found name {file.name}, expected a time in seconds and .json")
    return int(match[1]) * 10**9 + int((match[2] or "").ljust(9, "0"))
