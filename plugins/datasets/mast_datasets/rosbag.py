"""ROS 2 bags as scenes: poses, truth and detections of the topics that a map names."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mast_datasets.rosbag_map import parse_map, read_map
from mast_datasets.traffic import ABOVE_0, DataSetScene
from mast_zenoh.errors import ConfigurationError
from mast_zenoh.scenes.recording import Recording

#: What files of the two storages end with.
SUFFIXES = (".db3", ".mcap")


@dataclass(kw_only=True, eq=False)
class RosBag(DataSetScene):
    """A ROS 2 bag, in the storage SQLite3 or MCAP, with a map of its topics; see docs/scenes_rosbag.md.

    path:             a folder with metadata.yaml, a file, or a map that names its bag
    topics:           the map, or the TOML file that holds it; None: topics.toml in the folder, or the TOML file beside
                      the bag's file that has its name
    start_s:          s from the first time at which all agents have a pose to the first frame
    duration_s:       s from the first frame to the last; None: as long as all agents have a pose
    n_infrastructure: agents that never move to use, besides the first agent, the first ones; None: all
    n_mobile:         other agents to use, besides the first agent, the first ones; None: all
    detector:         the model that generates the detections of sensors for which the map has no topic
    max_unpacked_mb:  limit on the files unpacked from a bag that is compressed file by file, 10^6 bytes
    """

    short_name = "rosbag"
    files = tuple(("metadata.yaml", f"*{suffix}") for suffix in (*SUFFIXES, ".zstd"))

    topics: str | dict[str, Any] | None = None
    start_s: float = 0.0
    duration_s: float | None = None
    max_unpacked_mb: float = 4000.0

    def __post_init__(self) -> None:
        self.check(start_s=(0.0, math.inf), duration_s=ABOVE_0, max_unpacked_mb=ABOVE_0)

    @classmethod
    def recognises(cls, path: Path) -> bool:
        return super().recognises(path) or (path.is_file() and path.suffix in SUFFIXES)

    def inputs(self) -> Sequence[Path]:
        """The bag, and the file of the map."""
        bag, file = self._files()
        return (bag,) if file is None else (bag, file)

    def record(self, seed: int, frames: int | None) -> Recording:
        try:
            from mast_datasets import rosbag_reading, rosbag_recording, rosbag_storage
        except ModuleNotFoundError as error:
            if (missing := (error.name or "").partition(".")[0]) not in ("mast_ros2", "rosbags", "apsw", "lz4"):
                raise
            raise ConfigurationError(
                f"{self.path}: {missing} is not installed, expected pip install 'mast-zenoh[ros2]'"
            ) from None
        path, file = self._files()
        with rosbag_storage.open_bag(path, self.max_unpacked_mb) as bag:
            place = file or Path(f"{type(self).__name__}.topics")
            if file is None and not isinstance(self.topics, Mapping):
                raise ConfigurationError(
                    f"{self.path}: found no map of its topics, expected {self._usual_map}, or `topics` "
                    f"(docs/scenes_rosbag.md); the bag has {bag.listed_topics()}"
                )
            bag_map = parse_map(self.topics, place) if isinstance(self.topics, Mapping) else read_map(place)
            readers = rosbag_reading.read_topics(bag, bag_map, place)
        return rosbag_recording.BagScene(self, path, bag_map, readers).recording(seed, frames)

    def _files(self) -> tuple[Path, Path | None]:
        """The bag, and the file with the map; None: the map is given, or there is none."""
        if self.root.suffix == ".toml":
            if self.topics is not None:
                raise ConfigurationError(f"{self.path}: topics are given, expected None: the path is that of a map")
            bag = read_map(self.root).bag
            if not bag:
                raise ConfigurationError(f"{self.path}: bag is missing, expected the path of the bag of this map")
            return self.root.parent / bag, self.root
        if isinstance(self.topics, str):
            return self.root, Path(self.topics)
        return self.root, self._usual_map if self.topics is None and self._usual_map.is_file() else None

    @property
    def _usual_map(self) -> Path:
        return self.root / "topics.toml" if self.root.is_dir() else self.root.with_suffix(".toml")
