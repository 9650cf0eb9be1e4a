"""Scenes: ground truth, prepared once per seed as a `Recording` and replayed."""

from mast_zenoh.scenes.argoverse.av2 import AV2Log
from mast_zenoh.scenes.base import Scene
from mast_zenoh.scenes.cache import cache_folder, prepare, prepare_sweeps
from mast_zenoh.scenes.carla.avstack import AVstackScene
from mast_zenoh.scenes.commonroad.scenario import CommonRoadScenario
from mast_zenoh.scenes.dair.rcooper import RCooperScene
from mast_zenoh.scenes.dair.scene import DAIRScene
from mast_zenoh.scenes.from_arrays import from_arrays
from mast_zenoh.scenes.generated.intersection import Intersection
from mast_zenoh.scenes.kitti.tracking import KittiTracking
from mast_zenoh.scenes.names import parse_scene
from mast_zenoh.scenes.opv2v.multi_v2x import MultiV2XScene
from mast_zenoh.scenes.opv2v.scenes import OPV2VScene, V2V4RealScene, V2XRealScene
from mast_zenoh.scenes.own_detections.replayed import OwnDetections
from mast_zenoh.scenes.recording import Recording, SceneAgent
from mast_zenoh.scenes.recording_file import RecordingFile
from mast_zenoh.scenes.sumo.floating_cars import SumoTrace
from mast_zenoh.scenes.tumtraf.tumtraf import TUMTrafV2X
from mast_zenoh.scenes.urbaning.urbaning import UrbanIngV2X

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
