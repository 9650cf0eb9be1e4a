"""Scenes: ground truth, prepared once per seed as a `Recording` and replayed.

Names are imported on first use: nodes import this package for its recordings, and need no scene.
"""

from __future__ import annotations

import importlib

TYPE_CHECKING = False  # known to type checkers; importing `typing` takes time in every node
if TYPE_CHECKING:
    from typing import Any

    from mast_zenoh.scenes.base import Scene as Scene
    from mast_zenoh.scenes.cache import cache_folder as cache_folder
    from mast_zenoh.scenes.cache import prepare as prepare
    from mast_zenoh.scenes.cache import prepare_sweeps as prepare_sweeps
    from mast_zenoh.scenes.from_arrays import from_arrays as from_arrays
    from mast_zenoh.scenes.generated.intersection import Intersection as Intersection
    from mast_zenoh.scenes.generated.road import StraightRoad as StraightRoad
    from mast_zenoh.scenes.making.sensor_types import Sensor as Sensor
    from mast_zenoh.scenes.own_detections import OwnDetections as OwnDetections
    from mast_zenoh.scenes.recording import Recording as Recording
    from mast_zenoh.scenes.recording import SceneAgent as SceneAgent
    from mast_zenoh.scenes.recording_file import RecordingFile as RecordingFile

#: Module of each type of scene, and of each other name.
_TYPES = {
    "Intersection": "generated.intersection",
    "RecordingFile": "recording_file",
    "OwnDetections": "own_detections",
    "StraightRoad": "generated.road",
}
_OTHERS = {
    "Recording": "recording",
    "SceneAgent": "recording",
    "Scene": "base",
    "Sensor": "making.sensor_types",
    "cache_folder": "cache",
    "from_arrays": "from_arrays",
    "prepare": "cache",
    "prepare_sweeps": "cache",
}

__all__ = [
    "Intersection",
    "OwnDetections",
    "Recording",
    "RecordingFile",
    "Scene",
    "SceneAgent",
    "Sensor",
    "StraightRoad",
    "cache_folder",
    "from_arrays",
    "prepare",
    "prepare_sweeps",
]


def __getattr__(name: str) -> Any:
    places = _TYPES | _OTHERS
    if name not in places:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    # A type can be named in a scenario once it is imported, so the base brings all of them.
    for module in _TYPES.values() if name == "Scene" else ():
        importlib.import_module(f"{__name__}.{module}")
    value = getattr(importlib.import_module(f"{__name__}.{places[name]}"), name)
    globals()[name] = value
    return value
