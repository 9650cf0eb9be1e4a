"""Frames, rotations and boxes. Pure functions on arrays.

Frames are right-handed, x forward, y left, z up; the world frame is east-north-up. Rotations are ACTIVE: a
rotation R (3, 3) of a body turns components in the body frame into components in the world frame,
`world = position + R @ local`. Quaternions are (w, x, y, z) of the same active rotation.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.states import Bools, Floats, ObjectStates
from mast_zenoh.kernels import kernel

TWO_PI = 2.0 * np.pi

#: Origin (3,) m and rotation (4,), active quaternion w x y z, of a frame that is the frame of reference itself.
NO_OFFSET, NO_TURN = np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])
NO_OFFSET.setflags(write=False)
NO_TURN.setflags(write=False)
_NO_TURN: list[float] = NO_TURN.tolist()


def wrap_angle(angle: Floats) -> Floats:
    """Angles in rad wrapped to [-pi, pi); rounding may give pi itself."""
    return (np.asarray(angle) + np.pi) % TWO_PI - np.pi


def rotation_from_yaw(yaw: float) -> Floats:
    """(3, 3) rotation about z by `yaw` rad."""
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def rotation_from_yaw_pitch(yaw: float, pitch_down: float) -> Floats:
    """(3, 3) rotation by `yaw` rad, then by `pitch_down` rad below the horizon."""
    c, s = np.cos(pitch_down), np.sin(pitch_down)
    pitch = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
    return np.asarray(rotation_from_yaw(yaw) @ pitch, np.float64)


@kernel
def rotation_from_quaternion(quaternion: Floats) -> Floats:
    """(..., 3, 3) rotations from (..., 4) active quaternions (w, x, y, z).

    The quaternions are normalised first.
    """
    q = np.asarray(quaternion, np.float64)
    w, x, y, z = np.moveaxis(q / np.linalg.norm(q, axis=-1, keepdims=True), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


@kernel
def quaternion_from_rotation(rotation: Floats) -> Floats:
    """(..., 4) active quaternions (w, x, y, z), w >= 0, of (..., 3, 3) rotations.

    Shepperd (J. Guidance and Control 1978): divides by the largest component, which avoids dividing by a small one.
    """
    matrix = np.asarray(rotation, np.float64)
    trace = np.trace(matrix, axis1=-2, axis2=-1)
    # Products of the components, times four: row k is the quaternion times four of its k-th component.
    products = matrix + np.swapaxes(matrix, -1, -2)
    differences = np.stack([matrix[..., i, j] - matrix[..., j, i] for i, j in ((2, 1), (0, 2), (1, 0))], axis=-1)
    rows = np.empty((*matrix.shape[:-2], 4, 4))
    rows[..., 1:, 1:], rows[..., 0, 1:], rows[..., 1:, 0] = products, differences, differences
    rows[..., 0, 0] = 1.0 + trace
    for k in range(3):
        rows[..., k + 1, k + 1] = 1.0 - trace + 2.0 * matrix[..., k, k]
    largest = np.argmax(np.diagonal(rows, axis1=-2, axis2=-1), axis=-1)
    q = np.take_along_axis(rows, largest[..., None, None], axis=-2)[..., 0, :]
    q /= np.linalg.norm(q, axis=-1, keepdims=True)
    return np.where(q[..., :1] < 0.0, -q, q)


def scalar_last_quaternions(yaw: Floats) -> Floats:
    """(n, 4) x y z w, the order of many file formats, of rotations about the vertical by yaw (n,)."""
    zero = np.zeros_like(yaw)
    return np.stack([zero, zero, np.sin(yaw / 2), np.cos(yaw / 2)], axis=1)


def states_to_world(states: ObjectStates, origin: Floats, rotation: Floats) -> ObjectStates:
    """Transform states from a frame of reference to the world frame.

    origin: (3,) m; rotation: (4,) active quaternion of that frame

    Sizes are unchanged; the frame's heading is added to yaw.
    """
    if _is_world(origin, rotation):
        return states
    if rotation.tolist() == _NO_TURN:
        return states.with_(position=states.position + origin, yaw=wrap_angle(states.yaw))
    matrix = rotation_from_quaternion(rotation)
    jacobian = np.eye(9)
    jacobian[0:3, 0:3] = jacobian[6:9, 6:9] = matrix
    return states.with_(
        position=to_world(states.position, origin, matrix),
        velocity=states.velocity @ matrix.T,
        yaw=wrap_angle(states.yaw + heading(matrix)),
        covariance=jacobian @ states.covariance @ jacobian.T,
    )


def tracks_in_world(body: Mapping[str, NDArray[Any]]) -> ObjectStates:
    """The tracks in the columns of a `tracks` message, in the world frame."""
    return states_to_world(ObjectStates.from_columns(body), body["origin"], body["rotation"])


def states_to_local(states: ObjectStates, origin: Floats, rotation: Floats) -> ObjectStates:
    """Transform states from the world to a frame of reference, see `states_to_world`."""
    if _is_world(origin, rotation):
        return states
    matrix = rotation_from_quaternion(rotation)
    w, x, y, z = rotation
    return states_to_world(states, -origin @ matrix, np.array([w, -x, -y, -z]))


def _is_world(origin: Floats, rotation: Floats) -> bool:
    """Whether a frame of reference is the world frame, as for most tracks."""
    return rotation.tolist() == _NO_TURN and not any(origin.tolist())


def heading(rotation: Floats) -> Floats:
    """Heading (...,) rad of (..., 3, 3) rotations: of the x axis, on the ground."""
    return np.arctan2(rotation[..., 1, 0], rotation[..., 0, 0])


def angles_of(vectors: Floats) -> tuple[Floats, Floats]:
    """Azimuth (...,) and elevation (...,) rad of (..., 3) vectors."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    return np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))


def unit_vectors(azimuth: Floats, elevation: Floats) -> Floats:
    """(..., 3) unit vectors with these angles, rad, which are broadcast; see `angles_of`."""
    flat = np.cos(elevation)
    return np.stack(np.broadcast_arrays(flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)), axis=-1)


def to_world(points: Floats, position: Floats, rotation: Floats) -> Floats:
    """Transform (n, 3) points from a body frame to the world frame.

    position (3,), rotation (3, 3): of the body
    """
    return points @ rotation.T + position


def to_local(points: Floats, position: Floats, rotation: Floats) -> Floats:
    """Transform (n, 3) points from the world to a body frame; inverse of `to_world`."""
    return (points - position) @ rotation


def distance_along(points: Floats) -> Floats:
    """Distance (k,) m along a polyline, of each of its points (k, >= 2) m from the first one, seen from above."""
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points[:, :2], axis=0).T))])


def along_and_across(offset: Floats, yaw: Floats) -> Floats:
    """(n, 2) m ahead and to the left, in boxes with headings (n,), of offsets (n, >= 2) m from their centres."""
    c, s = np.cos(yaw), np.sin(yaw)
    return np.stack([c * offset[:, 0] + s * offset[:, 1], c * offset[:, 1] - s * offset[:, 0]], axis=1)


def box_corners(position: Floats, size: Floats, yaw: Floats) -> Floats:
    """Corners (n, 8, 3) m of upright boxes.

    position (n, 3): centre; size (n, 3): l w h; yaw (n,)
    """
    signs = np.array([[sx, sy, sz] for sz in (-1, 1) for sx, sy in ((1, 1), (-1, 1), (-1, -1), (1, -1))]) / 2
    local = signs[None] * np.asarray(size)[:, None, :]
    c, s = np.cos(yaw)[:, None], np.sin(yaw)[:, None]
    x = c * local[..., 0] - s * local[..., 1]
    y = s * local[..., 0] + c * local[..., 1]
    return np.stack([x, y, local[..., 2]], axis=-1) + np.asarray(position)[:, None, :]


def within_range(position: Floats, centre: Floats, radius: float) -> Bools:
    """Whether (n, 3) positions are within `radius` m of `centre` (3,) on the ground."""
    dx, dy = position[:, 0] - centre[0], position[:, 1] - centre[1]
    return np.asarray(dx * dx + dy * dy <= radius * radius)
