"""Detectors of points: what is in a scan. (`detection_model.Detector` models detections from the truth instead.)"""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from mast_zenoh.arrays.states import CLASSES, Detections, Floats
from mast_zenoh.sensing.points import Points


class PointDetector(ABC):
    """Finds objects among points; a user's detector is a subclass.

    It gets nothing but points: from simulated and recorded lidars alike. Each sensor has a detector of its own, so it
    may remember earlier scans.
    """

    @abstractmethod
    def detect(self, points: Points) -> Detections:
        """The objects of one scan.

        points: of the scan, in a frame with its origin at the lidar, z up, and x where the lidar faces; the ground is
                below 0

        Returns detections in the same frame: `position` (n, 3) m, the middle of the box; `yaw` (n,) rad,
        counter-clockwise from x; `score` 0 to 1; `covariance` (n, 3, 3) m², of the position, all zero: not known.
        """


class NoDetections(PointDetector):
    """Finds nothing; for tests, and to measure what all else costs."""

    def detect(self, points: Points) -> Detections:
        return Detections.empty()


def problem_of(found: object) -> str:
    """What is wrong with what a detector returned; empty: nothing."""
    if not isinstance(found, Detections):
        return f"returned {type(found).__name__}, expected Detections"
    n = len(found)
    for name, shape in (("position", (3,)), ("size", (3,)), ("yaw", ()), ("score", ()), ("covariance", (3, 3))):
        values = getattr(found, name)
        if not isinstance(values, np.ndarray) or values.shape != (n, *shape):
            return f"{name} has the shape {np.shape(values)}, expected {(n, *shape)}"
        if not np.isfinite(values).all():
            return f"{name} has a number that is not finite"
    if n and not 0.0 <= found.score.min() <= found.score.max() <= 1.0:
        return f"score {found.score.min():g} to {found.score.max():g}, expected 0 to 1"
    if n and not found.size.min() > 0.0:
        return f"size {found.size.min():g} m, expected more than 0"
    if np.shape(found.class_id) != (n,) or (n and int(np.max(found.class_id)) >= len(CLASSES)):
        return f"class_id: expected {n} indices below {len(CLASSES)}"
    return ""


def detect_levelled(detector: PointDetector, points: Points, level: Floats) -> Detections:
    """The detections of a scan in the lidar's own frame.

    points: in the lidar's frame; level: (3, 3) active, from that to the frame of `PointDetector.detect`
    Raises ValueError for detections that cannot be.
    """
    found = detector.detect(points.turned(level))
    if problem := problem_of(found):
        raise ValueError(f"{type(detector).__name__}.detect: {problem}")
    position = found.position @ level
    return Detections(position, found.size, found.yaw, found.score, found.class_id, level.T @ found.covariance @ level)
