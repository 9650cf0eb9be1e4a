"""Detectors of points: what is in a scan. (`detection_model.Detector` models detections from the truth instead.)"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.geometry import rotation_from_quaternion
from mast_zenoh.arrays.states import CLASSES, Detections
from mast_zenoh.sensing.points import Points


class PointDetector(ABC):
    """Finds objects among points; a user's detector is a subclass.

    It gets nothing but points: from simulated and recorded lidars alike. Each sensor has a detector of its own, so it
    may remember earlier scans.
    """

    @abstractmethod
    def detect(self, points: Points) -> Detections:
        """The objects of one scan.

        points: of the scan, read-only, in a frame with its origin at the lidar, z up, and x where the lidar faces; the
                ground is below 0

        Returns detections in the same frame: `position` (n, 3) m, the middle of the box; `yaw` (n,) rad,
        counter-clockwise from x; `score` 0 to 1; `covariance` (n, 3, 3) m², of the position, all zero: not known.
        """


class NoDetections(PointDetector):
    """Finds nothing; for tests, and to measure what everything else costs."""

    def detect(self, points: Points) -> Detections:
        return Detections.empty()


#: Shape of a row and largest number, in SI units, of columns of detections: messages allow it in turned axes, too.
_COLUMNS = {
    "position": ((3,), 1e8),
    "size": ((3,), 1e3),
    "yaw": ((), 1e8),
    "score": ((), 1e8),
    "covariance": ((3, 3), 1e8),
}


def problem_of(detections: object) -> str:
    """What is wrong with what a detector returned; empty: nothing."""
    if not isinstance(detections, Detections):
        return f"returned {type(detections).__name__}, expected Detections"
    n = len(detections)
    for name, (shape, most) in _COLUMNS.items():
        values = getattr(detections, name)
        if not isinstance(values, np.ndarray) or values.shape != (n, *shape):
            return f"{name} has the shape {np.shape(values)}, expected {(n, *shape)}"
        if not np.isfinite(values).all():
            return f"{name} has a number that is not finite"
        if n and np.abs(values).max() > most:
            return f"{name} has the number {values.flat[np.abs(values).argmax()]:g}, expected at most {most:g}"
    if n and not 0.0 <= detections.score.min() <= detections.score.max() <= 1.0:
        return f"score {detections.score.min():g} to {detections.score.max():g}, expected 0 to 1"
    if n and not detections.size.min() > 0.0:
        return f"size {detections.size.min():g} m, expected more than 0"
    if n and (variance := np.diagonal(detections.covariance, axis1=1, axis2=2)).min() < 0.0:
        return f"covariance with the variance {variance.min():g} m², expected 0 or more"
    if np.shape(detections.class_id) != (n,) or (n and int(np.max(detections.class_id)) >= len(CLASSES)):
        return f"class_id: expected {n} indices below {len(CLASSES)}"
    return ""


def detected(detector: PointDetector, scan: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """The columns of a `detections` message: what a detector finds in a scan, in the lidar's own frame.

    scan: the columns of a `points` message. Raises ValueError for detections that cannot be.
    """
    level = rotation_from_quaternion(scan["level_rotation"])
    detections = detector.detect(Points.from_columns(scan).turned(level).read_only())
    if problem := problem_of(detections):
        raise ValueError(f"{type(detector).__name__}.detect: {problem}")
    own = replace(detections, position=detections.position @ level, covariance=level.T @ detections.covariance @ level)
    return nothing_detected(scan) | own.columns()


def detected_or_nothing(
    detector: PointDetector, scan: Mapping[str, NDArray[Any]], failed: Callable[[str, BaseException], None]
) -> dict[str, NDArray[Any]]:
    """As `detected`, but a detector that fails, which may be a user's, finds nothing. failed: of a node's context"""
    try:
        return detected(detector, scan)
    except Exception as error:
        failed("detect", error)
        return nothing_detected(scan)


def nothing_detected(scan: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """The columns of a `detections` message without detections, for a scan as of `detected`."""
    return Detections.empty().columns() | {name: scan[name] for name in ("mount_position", "mount_rotation")}
