"""The base class of detectors, and one without errors."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.states import Detections, Floats, Ints, ObjectStates
from mast_zenoh.sensing.frames import to_sensor
from mast_zenoh.sensing.lidar import LidarSensor


class Detector(ABC):
    """Generates detections from the objects that a lidar sees."""

    def begin(self, agent: str, sensor: str, period_s: float) -> Detector:
        """The detector for one sensor of an agent, from its first measurement on.

        Its `detect` is called for every measurement in order. A detector whose errors last returns a new object here,
        with a memory of its own; by default, all sensors share one without.
        period_s: s, between two measurements
        """
        return self

    @abstractmethod
    def detect(
        self,
        objects: ObjectStates,
        points: NDArray[np.int32],
        lidar: LidarSensor,
        sensor_position: Floats,
        sensor_rotation: Floats,
        ground: float,
        random: np.random.Generator,
    ) -> tuple[Detections, Ints]:
        """Detections of one sensor in one frame, and their truth ids (n,).

        Detections are in the sensor frame, best score first.

        objects: n objects in the world frame. points: (n,) lidar returns of each at this sensor.
        sensor_position (3,) m, sensor_rotation (3, 3) active: pose of the lidar in the world.
        ground: m, z of the ground at the sensor. random: the random stream of this sensor and frame.
        The id of clutter is -1; ids are for scoring only.
        """


class CleanDetector(Detector):
    """Reports every object with enough points exactly; for tests and upper bounds.

    No noise, misses or clutter.

    min_points: minimum number of lidar returns of a detected object
    """

    def __init__(self, *, min_points: int = 5) -> None:
        self.min_points = min_points

    def detect(
        self,
        objects: ObjectStates,
        points: NDArray[np.int32],
        lidar: LidarSensor,
        sensor_position: Floats,
        sensor_rotation: Floats,
        ground: float,
        random: np.random.Generator,
    ) -> tuple[Detections, Ints]:
        """Detections in the order of the objects, all scores one."""
        seen = objects.select(points >= self.min_points)
        n = len(seen)
        detections = Detections(seen.position, seen.size, seen.yaw, np.ones(n), seen.class_id, np.zeros((n, 3, 3)))
        return to_sensor(detections, sensor_position, sensor_rotation), seen.id
