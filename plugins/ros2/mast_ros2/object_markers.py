"""Objects as a MarkerArray: boxes that RViz shows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mast_ros2 import type_store
from mast_ros2.spatial import header, poses, vectors
from mast_ros2.type_store import TYPES, RosMessage, package
from mast_zenoh.arrays.geometry import scalar_last_quaternions
from mast_zenoh.arrays.states import ObjectStates

#: Values of constants of Marker.
CUBE, ADD, DELETE_ALL = 1, 0, 3
#: Of boxes: what is behind them stays visible.
_OPACITY = 0.6

_shown, _geometry, _interfaces = map(package, ("visualization_msgs", "geometry_msgs", "builtin_interfaces"))
_Colour, _Image = TYPES["std_msgs/msg/ColorRGBA"], TYPES["sensor_msgs/msg/CompressedImage"]

_NO_BYTES = np.zeros(0, np.uint8)
_NOWHERE = _geometry.Pose(_geometry.Point(0.0, 0.0, 0.0), _geometry.Quaternion(0.0, 0.0, 0.0, 1.0))


def marker_array(states: ObjectStates, colours: NDArray[np.int64], time_ns: int, frame_id: str) -> RosMessage:
    """A MarkerArray of a box for each object, after a marker that removes those of the message before.

    colours: (n, 3) red, green and blue, 0 to 255

    Raises ValueError for a time that ROS cannot express.
    """
    of_all = header(time_ns, frame_id)
    markers = [_marker(of_all, 0, DELETE_ALL, _NOWHERE, _geometry.Vector3(0.0, 0.0, 0.0), _Colour(0.0, 0.0, 0.0, 0.0))]
    for number, pose, size, colour in zip(
        states.id.tolist(),
        poses(states.position, scalar_last_quaternions(states.yaw)),
        vectors(states.size),
        (colours / 255).tolist(),
        strict=True,
    ):
        # ROS has 32 bits for the number
        markers.append(_marker(of_all, number % 2**31, ADD, pose, size, _Colour(*colour, _OPACITY)))
    return TYPES[type_store.MARKER_ARRAY](markers)


def _marker(
    of_all: RosMessage, number: int, action: int, pose: RosMessage, size: RosMessage, colour: RosMessage
) -> RosMessage:
    """A box; all fields of other markers are empty."""
    return _shown.Marker(
        header=of_all,
        ns="",
        id=number,
        type=CUBE,
        action=action,
        pose=pose,
        scale=size,
        color=colour,
        lifetime=_interfaces.Duration(0, 0),
        frame_locked=False,
        points=[],
        colors=[],
        texture_resource="",
        texture=_Image(of_all, "", _NO_BYTES),
        uv_coordinates=[],
        text="",
        mesh_resource="",
        mesh_file=_shown.MeshFile("", _NO_BYTES),
        mesh_use_embedded_materials=False,
    )
