"""Prior knowledge of road users by class, in the order of `states.CLASSES`."""

from __future__ import annotations

import numpy as np

from mast_zenoh.arrays.states import CLASS_INDEX, CLASSES, Floats, Ints

#: Per class:
#: speed_along, speed_across  m/s, standard deviation of a new object's speed along and across its heading: covers
#:                            urban to motorway traffic in both directions, and heading errors of 0.25 rad
#: acceleration               m^2/s^3, spectral density: variance of the speed gained per second
#: jump                       factor on the tracker's `jump_std_m`
#: family                     classes that detectors confuse
_TABLE = {
    "unknown": (10.0, 10.0, 3.0, 0.5, 0),
    "car": (12.0, 3.0, 3.0, 1.0, 1),
    "truck": (10.0, 3.0, 2.0, 1.0, 1),
    "bus": (10.0, 3.0, 2.0, 1.0, 1),
    "motorcycle": (12.0, 3.0, 3.0, 0.6, 2),
    "bicycle": (5.0, 3.0, 2.0, 0.6, 2),
    "pedestrian": (1.5, 1.5, 0.5, 0.3, 3),
}
_COLUMNS = np.array([_TABLE[name] for name in CLASSES]).T

_ALONG, _ACROSS, ACCELERATION, JUMP, _FAMILY = _COLUMNS

#: (m/s)^2: mean and half difference of the variances of the speed along and across the heading.
_SPEED_MEAN, _SPEED_HALF = 0.5 * (_ALONG**2 + _ACROSS**2), 0.5 * (_ALONG**2 - _ACROSS**2)

#: (7,) bool: moves along its length axis, except for slip.
WHEELED = np.array([name not in ("unknown", "pedestrian") for name in CLASSES])

#: m^2/s^3, spectral density of vertical acceleration: roads are nearly flat.
VERTICAL_ACCELERATION = 0.2
#: m^2/s, drift of a size: objects are rigid, but their visible part changes.
SIZE_DRIFT = 4e-4

#: (7, 7) log-likelihood that an object of class row is detected as class column, up to a constant: detectors mostly
#: agree, often confuse within a family, rarely beyond.
CONFUSION = np.where(_FAMILY[:, None] == _FAMILY[None, :], -1.0, -3.0)
np.fill_diagonal(CONFUSION, 0.0)
CONFUSION[CLASS_INDEX["unknown"], :] = CONFUSION[:, CLASS_INDEX["unknown"]] = 0.0

#: m/s, standard deviation of a new object's vertical speed.
SPEED_VERTICAL = 0.5

#: (7,), (7,) and a scalar, (m/s)^2, of a new object's velocity: `_SPEED_MEAN`, `_SPEED_HALF`, the vertical variance.
FIRST_SPEED = _SPEED_MEAN, _SPEED_HALF, SPEED_VERTICAL**2


def first_covariance(box: Floats, yaw: Floats, class_id: Ints) -> Floats:
    """Covariances (n, 9, 9) of new objects: box noise and the velocity prior.

    box: (n, 6, 6)

    The heading constrains the velocity before any motion is observed.
    """
    double = 2.0 * yaw
    mean, half = _SPEED_MEAN.take(class_id), _SPEED_HALF.take(class_id)
    swing, cross = half * np.cos(double), half * np.sin(double)
    covariance = np.zeros((len(yaw), 9, 9))
    covariance[:, :6, :6] = box
    covariance[:, 6, 6], covariance[:, 7, 7] = mean + swing, mean - swing
    covariance[:, 6, 7] = covariance[:, 7, 6] = cross
    covariance[:, 8, 8] = SPEED_VERTICAL**2
    return covariance
