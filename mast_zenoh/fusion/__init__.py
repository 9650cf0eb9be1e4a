"""Fusion at the command centre: combines the tracks of many agents into one picture.

See docs/explanation-tracking-and-fusion.md.
"""

from mast_zenoh.fusion.base import Clusterer, Fusion, GroupTracker
from mast_zenoh.fusion.clustering import DBSCANClusterer, SampledAssignmentClusterer
from mast_zenoh.fusion.covariance_check import CheckedCovariances, CovarianceCheck, ReportedCovariances
from mast_zenoh.fusion.covariance_intersection import (
    BestMemberFusion,
    CovarianceIntersectionFusion,
    InverseCovarianceIntersectionFusion,
    NaiveKalmanFusion,
)
from mast_zenoh.fusion.group_tracking import GroupTrackerWrapper, UnfilteredGroupTracker
from mast_zenoh.fusion.information_matrix import InformationMatrixGroupTracker
from mast_zenoh.fusion.input_limit import FairInput, InputLimit, NoInputLimit

__all__ = [
    "BestMemberFusion",
    "CheckedCovariances",
    "Clusterer",
    "CovarianceCheck",
    "CovarianceIntersectionFusion",
    "DBSCANClusterer",
    "FairInput",
    "Fusion",
    "GroupTracker",
    "GroupTrackerWrapper",
    "InformationMatrixGroupTracker",
    "InputLimit",
    "InverseCovarianceIntersectionFusion",
    "NaiveKalmanFusion",
    "NoInputLimit",
    "ReportedCovariances",
    "SampledAssignmentClusterer",
    "UnfilteredGroupTracker",
]
