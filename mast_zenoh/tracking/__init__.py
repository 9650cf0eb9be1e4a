"""Tracking: turns detections or states into tracks with persistent ids.

See docs/explanation-tracking-and-fusion.md.
"""

from mast_zenoh.tracking.association import Assignment, BipartiteAssignment, GreedyAssignment
from mast_zenoh.tracking.base import Innovations, Tracker
from mast_zenoh.tracking.box_tracker import FilterpyBoxTracker3D, KalmanBoxTracker3D
from mast_zenoh.tracking.interacting_models import InteractingModelsTracker3D
from mast_zenoh.tracking.stone_soup_tracker import StoneSoupTracker
from mast_zenoh.tracking.view import SensorView

__all__ = [
    "Assignment",
    "BipartiteAssignment",
    "FilterpyBoxTracker3D",
    "GreedyAssignment",
    "Innovations",
    "InteractingModelsTracker3D",
    "KalmanBoxTracker3D",
    "SensorView",
    "StoneSoupTracker",
    "Tracker",
]
