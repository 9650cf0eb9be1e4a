"""Sensing: lidar visibility, detection models and sensor frames."""

from mast_zenoh.sensing.detection_model import CleanDetector, DetectionModel, Detector, LastingErrors
from mast_zenoh.sensing.raycast import Walls, lidar_points
from mast_zenoh.sensing.sensors import Camera, LidarSensor, in_view, sensor_pose, to_sensor, to_world

__all__ = [
    "Camera",
    "CleanDetector",
    "DetectionModel",
    "Detector",
    "LastingErrors",
    "LidarSensor",
    "Walls",
    "in_view",
    "lidar_points",
    "sensor_pose",
    "to_sensor",
    "to_world",
]
