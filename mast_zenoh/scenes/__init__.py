"""Scenes: ground truth, prepared once per seed as a `Recording` and replayed.

Names are imported on first use: nodes import this package for its recordings, and need no reader of data sets.
"""

from __future__ import annotations

import importlib

TYPE_CHECKING = False  # known to type checkers; importing `typing` takes time in every node
if TYPE_CHECKING:
    from typing import Any

    from mast_zenoh.scenes.argoverse.av2 import AV2Log as AV2Log
    from mast_zenoh.scenes.base import Scene as Scene
    from mast_zenoh.scenes.cache import cache_folder as cache_folder
    from mast_zenoh.scenes.cache import prepare as prepare
    from mast_zenoh.scenes.cache import prepare_sweeps as prepare_sweeps
    from mast_zenoh.scenes.carla.avstack import AVstackScene as AVstackScene
    from mast_zenoh.scenes.commonroad.scenario import CommonRoadScenario as CommonRoadScenario
    from mast_zenoh.scenes.dair.rcooper import RCooperScene as RCooperScene
    from mast_zenoh.scenes.dair.scene import DAIRScene as DAIRScene
    from mast_zenoh.scenes.from_arrays import from_arrays as from_arrays
    from mast_zenoh.scenes.generated.intersection import Intersection as Intersection
    from mast_zenoh.scenes.kitti.tracking import KittiTracking as KittiTracking
    from mast_zenoh.scenes.making.sensor_types import Sensor as Sensor
    from mast_zenoh.scenes.names import parse_scene as parse_scene
    from mast_zenoh.scenes.opv2v.multi_v2x import MultiV2XScene as MultiV2XScene
    from mast_zenoh.scenes.opv2v.scenes import OPV2VScene as OPV2VScene
    from mast_zenoh.scenes.opv2v.scenes import V2V4RealScene as V2V4RealScene
    from mast_zenoh.scenes.opv2v.scenes import V2XRealScene as V2XRealScene
    from mast_zenoh.scenes.own_detections.replayed import OwnDetections as OwnDetections
    from mast_zenoh.scenes.recording import Recording as Recording
    from mast_zenoh.scenes.recording import SceneAgent as SceneAgent
    from mast_zenoh.scenes.recording_file import RecordingFile as RecordingFile
    from mast_zenoh.scenes.sumo.floating_cars import SumoTrace as SumoTrace
    from mast_zenoh.scenes.tumtraf.tumtraf import TUMTrafV2X as TUMTrafV2X
    from mast_zenoh.scenes.urbaning.urbaning import UrbanIngV2X as UrbanIngV2X

#: Module of each type of scene.
_TYPES = {
    "Intersection": "generated.intersection",
    "RecordingFile": "recording_file",
    "OwnDetections": "own_detections.replayed",
    "AVstackScene": "carla.avstack",
    "AV2Log": "argoverse.av2",
    "KittiTracking": "kitti.tracking",
    "CommonRoadScenario": "commonroad.scenario",
    "SumoTrace": "sumo.floating_cars",
    "OPV2VScene": "opv2v.scenes",
    "V2XRealScene": "opv2v.scenes",
    "MultiV2XScene": "opv2v.multi_v2x",
    "V2V4RealScene": "opv2v.scenes",
    "DAIRScene": "dair.scene",
    "RCooperScene": "dair.rcooper",
    "TUMTrafV2X": "tumtraf.tumtraf",
    "UrbanIngV2X": "urbaning.urbaning",
}
#: Module of each other name.
_OTHERS = {
    "Recording": "recording",
    "SceneAgent": "recording",
    "Scene": "base",
    "Sensor": "making.sensor_types",
    "cache_folder": "cache",
    "from_arrays": "from_arrays",
    "parse_scene": "names",
    "prepare": "cache",
    "prepare_sweeps": "cache",
}

__all__ = [
    "AV2Log",
    "AVstackScene",
    "CommonRoadScenario",
    "DAIRScene",
    "Intersection",
    "KittiTracking",
    "MultiV2XScene",
    "OPV2VScene",
    "OwnDetections",
    "RCooperScene",
    "Recording",
    "RecordingFile",
    "Scene",
    "SceneAgent",
    "Sensor",
    "SumoTrace",
    "TUMTrafV2X",
    "UrbanIngV2X",
    "V2V4RealScene",
    "V2XRealScene",
    "cache_folder",
    "from_arrays",
    "parse_scene",
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
