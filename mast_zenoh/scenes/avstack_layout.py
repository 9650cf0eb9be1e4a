"""Where the files of a scene in the CARLA multi-agent layout lie.

    <run>/objects/objectstate-{actors,npcs}-<frame>-<time>.txt
    <run>/objects_sensor/<sensor>-<k>-<agent>/objectstate-objects-<frame>-<time>.txt
    <run>/data/<sensor>-<k>-<agent>/calib-timestamp_<time>-frame_<frame>.txt

and, beside the run or in a folder above it, what the layout does not know: `detections.jsonl`, `visibility.jsonl`,
`buildings.json`, `scene.json`.
"""

from __future__ import annotations

import contextlib
import itertools
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from mast_zenoh.errors import SceneError
from mast_zenoh.scenes.archive import unpack

_DEPTH = 3  # folders down from the given one in which a run is looked for


@dataclass(frozen=True)
class Layout:
    """A run folder, and the folders in which files beside it may lie, nearest first."""

    run: Path
    around: tuple[Path, ...]

    def beside(self, name: str) -> Path | None:
        """The nearest file of that name beside the run."""
        return next((folder / name for folder in self.around if (folder / name).is_file()), None)

    def frames(self) -> dict[int, Path]:
        """The actors' file of every frame, in order. Refuses gaps and frames without a file of the others."""
        actors = object_files(self.run / "objects", "actors")
        others = object_files(self.run / "objects", "npcs")
        if not actors:
            raise SceneError(f"{self.run / 'objects'}: no file objectstate-actors-<frame>-<time>.txt")
        same_frames(self.run / "objects", "npcs", others, list(actors))
        same_frames(self.run / "objects", "actors", actors, list(others))
        numbers = list(actors)
        stride = numbers[1] - numbers[0] if len(numbers) > 1 else 1
        for before, after in itertools.pairwise(numbers):
            if after - before != stride:
                raise SceneError(
                    f"{self.run / 'objects'}: frame {before} is followed by {after}, expected {before + stride}"
                )
        return actors

    def sensors(self, kind: str, agent: int) -> list[str]:
        """Names of an agent's sensors of a kind ("lidar", "camera") that have data, e.g. "lidar-0-3"."""
        folder = self.run / "data"
        names = sorted(path.name for path in folder.iterdir() if path.is_dir()) if folder.is_dir() else []
        return [name for name in names if (parts := name.split("-"))[0] == kind and parts[-1] == str(agent)]

    def calibrations(self, sensor: str, frames: Sequence[int]) -> dict[int, Path]:
        """The calibration of a sensor in every frame."""
        folder = self.run / "data" / sensor
        found: dict[int, Path] = {}
        for path in folder.glob("calib-timestamp_*-frame_*.txt"):
            found[_number(path, path.stem.rpartition("frame_")[2])] = path
        same_frames(folder, "calib", found, frames)
        return {frame: found[frame] for frame in frames}

    def seen(self, sensor: str, frames: Sequence[int]) -> dict[int, Path] | None:
        """The file of objects that a sensor sees in every frame; None when there is no folder of that sensor."""
        folder = self.run / "objects_sensor" / sensor
        if not folder.is_dir():
            return None
        found = object_files(folder, "objects")
        same_frames(folder, "objects", found, frames)
        return {frame: found[frame] for frame in frames}


@contextlib.contextmanager
def opened(path: Path, max_unpacked_mb: float) -> Iterator[Layout]:
    """The layout at `path`: a run folder, a folder above a single run, or a tar archive of either.

    An archive is unpacked into a temporary folder, never outside it, without the images and point clouds, and is gone
    when the context ends. Raises SceneError when there is no run or more than one, or more to unpack than
    `max_unpacked_mb` (10^6 bytes).
    """
    if path.is_dir():
        yield find(path)
        return
    if not path.is_file():
        raise SceneError(f"{path}: no such file or folder")
    with tempfile.TemporaryDirectory(prefix="mast-scene-") as folder:
        unpack(path, Path(folder), (".txt", ".json", ".jsonl"), int(max_unpacked_mb * 1e6))
        # Messages are to name the archive, not a folder that is gone when they are read.
        try:
            yield find(Path(folder))
        except SceneError as error:
            raise SceneError(str(error).replace(folder, str(path))) from error


def find(path: Path) -> Layout:
    """The layout in a folder: the folder itself, or the only run below it."""
    if (path / "objects").is_dir():
        return Layout(path, (path, path.parent))
    level, runs = [path], []
    for _ in range(_DEPTH):
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
    """The files `objectstate-<kind>-<frame>-<time>.txt` of a folder by frame, in order."""
    found: dict[int, Path] = {}
    for path in folder.glob(f"objectstate-{kind}-*.txt"):
        parts = path.stem.split("-")
        if len(parts) != 4:
            raise SceneError(f"{path}: the name has {len(parts)} parts, expected objectstate-{kind}-<frame>-<time>.txt")
        found[_number(path, parts[2])] = path
    return dict(sorted(found.items()))


def _number(path: Path, text: str) -> int:
    if not text.isdecimal():
        raise SceneError(f"{path}: {text!r} in the name is no frame number")
    return int(text)


def same_frames(folder: Path, kind: str, found: dict[int, Path], frames: Sequence[int]) -> None:
    """Raises SceneError, naming the first one, when a frame has no file of a kind."""
    missing = [frame for frame in frames if frame not in found]
    if missing:
        raise SceneError(
            f"{folder}: no {kind} file of frame {missing[0]} ({len(missing)} of {len(frames)} frames are without one)"
        )
