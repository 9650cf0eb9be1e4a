"""Finds the files of a scene in the CARLA multi-agent layout.

    <run>/objects/objectstate-{actors,npcs}-<frame>-<time>.txt
    <run>/objects_sensor/<sensor>-<k>-<agent>/objectstate-objects-<frame>-<time>.txt
    <run>/data/<sensor>-<k>-<agent>/calib-timestamp_<time>-frame_<frame>.txt

The files `detections.jsonl`, `visibility.jsonl`, `buildings.json` and `scene.json`, which are not part of the layout,
may be in the run folder or in a folder above it.
"""

from __future__ import annotations

import contextlib
import itertools
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from mast_zenoh.errors import SceneError
from mast_zenoh.scenes.carla.archive import unpack

_MAX_DEPTH = 3  # levels of subfolders that are searched for a run


@dataclass(frozen=True)
class Layout:
    """A run folder, and the folders that may hold accompanying files, nearest first."""

    run: Path
    search_folders: tuple[Path, ...]

    def accompanying_file(self, name: str) -> Path | None:
        """The nearest accompanying file of that name; None: there is none."""
        return next((folder / name for folder in self.search_folders if (folder / name).is_file()), None)

    def frames(self) -> dict[int, Path]:
        """The actors' file of every frame, in order.

        Raises SceneError for gaps and for missing files.
        """
        actors = object_files(self.run / "objects", "actors")
        others = object_files(self.run / "objects", "npcs")
        if not actors:
            raise SceneError(f"{self.run / 'objects'}: no file objectstate-actors-<frame>-<time>.txt")
        check_frames(self.run / "objects", "npcs", others, list(actors))
        check_frames(self.run / "objects", "actors", actors, list(others))
        numbers = list(actors)
        stride = numbers[1] - numbers[0] if len(numbers) > 1 else 1
        for before, after in itertools.pairwise(numbers):
            if after - before != stride:
                raise SceneError(
                    f"{self.run / 'objects'}: frame {before} is followed by {after}, expected {before + stride}"
                )
        return actors

    def sensors(self, kind: str, agent: int) -> list[str]:
        """Names of an agent's sensors of a kind with data, such as "lidar-0-3".

        kind: "lidar" or "camera"
        """
        folder = self.run / "data"
        names = sorted(path.name for path in folder.iterdir() if path.is_dir()) if folder.is_dir() else []
        return [name for name in names if (parts := name.split("-"))[0] == kind and parts[-1] == str(agent)]

    def calibrations(self, sensor: str, frames: Sequence[int]) -> dict[int, Path]:
        """The calibration of a sensor in every frame."""
        folder = self.run / "data" / sensor
        files: dict[int, Path] = {}
        for path in folder.glob("calib-timestamp_*-frame_*.txt"):
            files[_frame_number(path, path.stem.rpartition("frame_")[2])] = path
        check_frames(folder, "calib", files, frames)
        return {frame: files[frame] for frame in frames}

    def seen(self, sensor: str, frames: Sequence[int]) -> dict[int, Path] | None:
        """The file of visible objects of a sensor in every frame.

        None without a folder for that sensor.
        """
        folder = self.run / "objects_sensor" / sensor
        if not folder.is_dir():
            return None
        files = object_files(folder, "objects")
        check_frames(folder, "objects", files, frames)
        return {frame: files[frame] for frame in frames}


@contextlib.contextmanager
def open_layout(path: Path, max_unpacked_mb: float) -> Iterator[Layout]:
    """Open the layout at `path`: a run folder, a folder above one, or a tar archive.

    A folder above must contain a single run. An archive is unpacked into a temporary folder, without the images and
    point clouds; the folder is deleted when the context ends. Raises SceneError without exactly one run, or if the
    files exceed `max_unpacked_mb` (10^6 bytes).
    """
    if path.is_dir():
        yield find_layout(path)
        return
    if not path.is_file():
        raise SceneError(f"{path}: no such file or folder")
    with tempfile.TemporaryDirectory(prefix="mast-scene-") as folder:
        unpack(path, Path(folder), (".txt", ".json", ".jsonl"), int(max_unpacked_mb * 1e6))
        # Error messages name the archive, not the temporary folder.
        try:
            yield find_layout(Path(folder))
        except SceneError as error:
            raise SceneError(str(error).replace(folder, str(path))) from error


def find_layout(path: Path) -> Layout:
    """The layout in a folder: the folder itself, or the only run below it."""
    if (path / "objects").is_dir():
        return Layout(path, (path, path.parent))
    level, runs = [path], []
    for _ in range(_MAX_DEPTH):
        level = sorted(child for folder in level for child in folder.iterdir() if child.is_dir())
        runs += [folder for folder in level if (folder / "objects").is_dir()]
        level = [folder for folder in level if folder not in runs]
    if not runs:
        raise SceneError(f"{path}: no run folder, expected a folder with objects/, objects_sensor/ and data/")
    if len(runs) > 1:
        names = ", ".join(str(run.relative_to(path)) for run in runs[:5])
        raise SceneError(f"{path}: {len(runs)} runs ({names}), expected the path of one")
    above = [folder for folder in runs[0].parents if folder == path or path in folder.parents]
    return Layout(runs[0], (runs[0], *above))


def object_files(folder: Path, kind: str) -> dict[int, Path]:
    """The files `objectstate-<kind>-<frame>-<time>.txt` by frame, in order."""
    files: dict[int, Path] = {}
    for path in folder.glob(f"objectstate-{kind}-*.txt"):
        parts = path.stem.split("-")
        if len(parts) != 4:
            raise SceneError(f"{path}: the name has {len(parts)} parts, expected objectstate-{kind}-<frame>-<time>.txt")
        files[_frame_number(path, parts[2])] = path
    return dict(sorted(files.items()))


def _frame_number(path: Path, text: str) -> int:
    if not text.isdecimal():
        raise SceneError(f"{path}: {text!r} in the name is not a frame number")
    return int(text)


def check_frames(folder: Path, kind: str, files: dict[int, Path], frames: Sequence[int]) -> None:
    """Raise SceneError with the first frame that has no file of a kind."""
    missing = [frame for frame in frames if frame not in files]
    if missing:
        raise SceneError(
            f"{folder}: no {kind} file for frame {missing[0]} (missing for {len(missing)} of {len(frames)} frames)"
        )
