"""Scenes: ground truth, prepared once per seed as a `Recording` and replayed."""

from mast_zenoh.scenes.argoverse.av2 import AV2Log
from mast_zenoh.scenes.base import Scene
from mast_zenoh.scenes.cache import cache_folder, prepare, prepare_sweeps
from mast_zenoh.scenes.carla.avstack import AVstackScene
from mast_zenoh.scenes.commonroad.scenario import CommonRoadScenario
from mast_zenoh.scenes.generated.intersection import Intersection
from mast_zenoh.scenes.kitti.tracking import KittiTracking
from mast_zenoh.scenes.names import parse_scene
from mast_zenoh.scenes.recording import Recording, SceneAgent
from mast_zenoh.scenes.sumo.floating_cars import SumoTrace

__all__ = [
    "AV2Log",
    "AVstackScene",
    "CommonRoadScenario",
    "Intersection",
    "KittiTracking",
    "Recording",
    "Scene",
    "SceneAgent",
    "SumoTrace",
    "cache_folder",
    "parse_scene",
    "prepare",
    "prepare_sweeps",
]
