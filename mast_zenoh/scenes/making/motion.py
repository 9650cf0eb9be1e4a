"""Objects and agents between two frames."""

from __future__ import annotations

import numpy as np

from mast_zenoh.arrays.geometry import quaternion_from_rotation, rotation_from_quaternion, wrap_angle
from mast_zenoh.arrays.states import Floats, ObjectStates


def objects_between(
    objects: ObjectStates, neighbours: ObjectStates | None, span_s: float, share: float
) -> ObjectStates:
    """The n objects of a frame, at a time between it and a neighbouring frame.

    neighbours: the objects of that frame; None: there is none. span_s: s from the frame to its neighbour, negative to
    an earlier one; share: 0 to 1, of the way to the neighbour.

    Positions follow a cubic Hermite spline, which keeps positions and velocities of both frames. An object without a
    neighbour moves at constant velocity. Velocities stay those of the frame.
    """
    position, yaw = objects.position + objects.velocity * (share * span_s), objects.yaw.copy()
    if neighbours is not None and len(neighbours):
        order = np.argsort(neighbours.id, kind="stable")
        row = order[np.minimum(np.searchsorted(neighbours.id[order], objects.id), len(order) - 1)]
        known = neighbours.id[row] == objects.id
        row = row[known]
        ends = objects.position[known], neighbours.position[row]
        speeds = objects.velocity[known], neighbours.velocity[row]
        position[known] = hermite(ends, speeds, span_s, share)
        yaw[known] += share * wrap_angle(neighbours.yaw[row] - yaw[known])
    return objects.with_(position=position, yaw=wrap_angle(yaw))


def hermite(ends: tuple[Floats, Floats], speeds: tuple[Floats, Floats], span_s: float, share: float) -> Floats:
    """Positions (..., 3) m at a `share` of a cubic spline of `span_s` s between `ends` with velocities `speeds`."""
    t, u = share, 1.0 - share
    along = (1.0 + 2.0 * t) * u * u * ends[0] + t * t * (3.0 - 2.0 * t) * ends[1]
    return np.asarray(along + span_s * (t * u * u * speeds[0] - t * t * u * speeds[1]))


def rotation_between(first: Floats, second: Floats, share: float) -> Floats:
    """The rotation (3, 3) at a share of the way between two that are close to each other."""
    start, end = quaternion_from_rotation(first), quaternion_from_rotation(second)
    end = end if start @ end >= 0.0 else -end
    return np.asarray(rotation_from_quaternion((1.0 - share) * start + share * end))
