import numpy as np

from mast_zenoh.arrays.states import Detections
from mast_zenoh.scenario import load
from mast_zenoh.sensing import Detector, to_sensor


class ShortSighted(Detector):
    """Detects every object that the lidar hits within a distance, without errors.

    range_m: m, from the sensor
    """

    def __init__(self, *, range_m: float = 25.0) -> None:
        self.range_m = range_m

    def detect(self, objects, points, lidar, sensor_position, sensor_rotation, ground, random):
        distance = np.linalg.norm(objects.position - sensor_position, axis=1)
        seen = objects.select((points > 0) & (distance <= self.range_m))
        n = len(seen)
        detections = Detections(seen.position, seen.size, seen.yaw, np.ones(n), seen.class_id, np.zeros((n, 3, 3)))
        return to_sensor(detections, sensor_position, sensor_rotation), seen.id


def scenario(range_m=25.0):
    _, base = load("baseline")
    detector = dict(type="ShortSighted", range_m=range_m)
    return base | dict(name="short_sighted", scene=dict(type="Intersection", detector=detector))
