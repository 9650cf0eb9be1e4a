"""Sensing: lidar visibility, scans and points, detectors of points, detection models and sensor frames."""

from mast_zenoh.sensing.beams import MODELS, Beams, LidarModel
from mast_zenoh.sensing.cluster_detector import ClusterDetector
from mast_zenoh.sensing.clutter import Clutter
from mast_zenoh.sensing.detection_model import CleanDetector, DetectionModel, Detector, LastingErrors
from mast_zenoh.sensing.point_checks import CheckedDetector, PointCheck
from mast_zenoh.sensing.point_detector import NoDetections, PointDetector
from mast_zenoh.sensing.points import Points
from mast_zenoh.sensing.raycast import Walls, lidar_points
from mast_zenoh.sensing.returns import REFLECTIVITY, Returns
from mast_zenoh.sensing.scan import Moving, Scan, cast
from mast_zenoh.sensing.sensors import Camera, LidarSensor, in_view, sensor_pose, to_sensor, to_world
from mast_zenoh.sensing.shapes import Parts

__all__ = [
    "MODELS",
    "REFLECTIVITY",
    "Beams",
    "Camera",
    "CheckedDetector",
    "CleanDetector",
    "ClusterDetector",
    "Clutter",
    "DetectionModel",
    "Detector",
    "LastingErrors",
    "LidarModel",
    "LidarSensor",
    "Moving",
    "NoDetections",
    "Parts",
    "PointCheck",
    "PointDetector",
    "Points",
    "Returns",
    "Scan",
    "Walls",
    "cast",
    "in_view",
    "lidar_points",
    "sensor_pose",
    "to_sensor",
    "to_world",
]
