"""Readers of public data sets: the plugin mast-zenoh-datasets of mast-zenoh.

Importing this package defines its scenes, which scenarios and commands can then name.
"""

from mast_datasets.argoverse import AV2Log
from mast_datasets.avstack import AVstackScene
from mast_datasets.commonroad import CommonRoadScenario
from mast_datasets.dair import DAIRScene
from mast_datasets.kitti import KittiTracking
from mast_datasets.opv2v import MultiV2XScene, OPV2VScene, V2V4RealScene, V2XRealScene
from mast_datasets.rcooper import RCooperScene
from mast_datasets.rosbag import RosBag
from mast_datasets.sumo import SumoTrace
from mast_datasets.sumo_traffic import SumoTraffic
from mast_datasets.tumtraf import TUMTrafV2X
from mast_datasets.urbaning import UrbanIngV2X

__all__ = [
    "AV2Log",
    "AVstackScene",
    "CommonRoadScenario",
    "DAIRScene",
    "KittiTracking",
    "MultiV2XScene",
    "OPV2VScene",
    "RCooperScene",
    "RosBag",
    "SumoTrace",
    "SumoTraffic",
    "TUMTrafV2X",
    "UrbanIngV2X",
    "V2V4RealScene",
    "V2XRealScene",
]
