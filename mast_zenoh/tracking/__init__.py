"""Tracking: turns detections or states into tracks with persistent ids.

See docs/tracking.md.
"""

from mast_zenoh.tracking.assignment import Assignment, BipartiteAssignment, GreedyAssignment
from mast_zenoh.tracking.base import Tracker
from mast_zenoh.tracking.box_tracker import KalmanBoxTracker3D
from mast_zenoh.tracking.filterpy_tracker import FilterpyBoxTracker3D
from mast_zenoh.tracking.innovations import Innovations
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
