"""Sensing: lidar visibility, detection models and sensor frames."""

from mast_zenoh.sensing.camera import Camera
from mast_zenoh.sensing.detection_model import DetectionModel
from mast_zenoh.sensing.detector import CleanDetector, Detector
from mast_zenoh.sensing.frames import sensor_pose, to_sensor, to_world
from mast_zenoh.sensing.lasting_errors import LastingErrors
from mast_zenoh.sensing.lidar import LidarSensor, in_view
from mast_zenoh.sensing.raycast import Walls, lidar_points

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
