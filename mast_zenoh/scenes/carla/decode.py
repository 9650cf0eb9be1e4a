"""Decodes the JSON of the CARLA multi-agent layout.

Nested objects are JSON strings.
Only the fields in use are decoded. The layout's quaternions are passive (they convert components from the parent's
frame to the body's), whereas rotations here are active, so the vector part changes sign.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from mast_zenoh.arrays.geometry import heading, rotation_from_quaternion
from mast_zenoh.arrays.states import Floats
from mast_zenoh.errors import SceneError
from mast_zenoh.scenes.files.class_names import class_of
from mast_zenoh.scenes.files.json_lines import reason, reject_constant

#: Values of `occlusion` of an object that a sensor does not see: invalid and complete. 0, 1 and 2 mean none, partial
#: and most, 99 means unknown.
_HIDDEN = (-1, 3)


@dataclass(frozen=True, eq=False)
class ObjectState:
    """One object or agent in the world.

    position: (3,) m of its reference point; rotation: (3, 3) active, body to world
    velocity: (3,) m/s; None: not stored
    centre: (3,) m of its box; size: (3,) m l w h; yaw: rad of the box; all None without a box (a pole)
    """

    id: int
    kind: str
    position: Floats
    rotation: Floats
    velocity: Floats | None
    centre: Floats | None
    size: Floats | None
    yaw: float | None

    @property
    def class_id(self) -> int:
        """Index into CLASSES."""
        return class_of(self.kind)


def read_objects(path: Path, frame: int) -> tuple[float, list[ObjectState]]:
    """Time s and states in a file of `objects/`.

    Raises SceneError with the file and the index of the object.
    """
    time, texts = _container(path, frame)
    states = []
    for index, text in enumerate(texts):
        try:
            states.append(_object_state(_decode(text)["objectstate"]))
        except (ValueError, KeyError, TypeError, IndexError) as error:
            raise SceneError(f"{path}: data[{index}]: {reason(error)}") from error
    return time, states


def read_seen(path: Path, frame: int) -> dict[int, float | None]:
    """Ids in a file of `objects_sensor/` with visible fractions (None: not stored).

    Completely occluded objects are left out.
    """
    seen: dict[int, float | None] = {}
    _, texts = _container(path, frame)
    for index, text in enumerate(texts):
        try:
            state = _decode(text)["objectstate"]
            fraction = state.get("visible_fraction")
            if fraction is not None and not 0.0 <= float(fraction) <= 1.0:
                raise ValueError(f"visible_fraction is {fraction}, expected 0 to 1")
            if fraction is not None and float(fraction) > 0.0:
                seen[int(state["ID"])] = float(fraction)
            elif fraction is None and int(state["occlusion"]) not in _HIDDEN:
                seen[int(state["ID"])] = None
        except (ValueError, KeyError, TypeError) as error:
            raise SceneError(f"{path}: data[{index}]: {reason(error)}") from error
    return seen


@dataclass(frozen=True, eq=False)
class Calibration:
    """The pose of a sensor in the world; image size and focal length of a camera.

    position: (3,) m;  rotation: (3, 3) active, sensor to world;  focal, width, height: px, None for a lidar
    """

    position: Floats
    rotation: Floats
    focal: float | None
    width: int | None
    height: int | None


def read_calibration(path: Path) -> Calibration:
    """Read a `calib-…` file. Raises SceneError with its path."""
    data = _read(path)
    try:
        calibration = data["calibration"]
        position, rotation = _pose(calibration["reference"])
        if "img_shape" not in calibration:
            return Calibration(position, rotation, None, None, None)
        height, width = (int(size) for size in calibration["img_shape"][:2])
        return Calibration(position, rotation, float(calibration["P"][0][0]), width, height)
    except (ValueError, KeyError, TypeError, IndexError) as error:
        raise SceneError(f"{path}: {reason(error)}") from error


def _object_state(data: dict[str, Any]) -> ObjectState:
    point, frame = _referenced(data["position"], "position")
    attitude, _ = _referenced(data["attitude"], "attitude")
    velocity = None
    if data.get("velocity") is not None:
        velocity_data, velocity_frame = _referenced(data["velocity"], "velocity")
        velocity = velocity_frame[1] @ _vector(velocity_data["x"], 3)
    rotation = frame[1] @ _active(attitude["qw"], attitude["qv"])
    centre = size = yaw = None
    if data.get("box") is not None:
        box = _decode(data["box"])["box3d"]
        corner, box_frame = _referenced(box["position"], "position")
        box_attitude, attitude_frame = _referenced(box["attitude"], "attitude")
        box_rotation = attitude_frame[1] @ _active(box_attitude["qw"], box_attitude["qv"])
        height, width, length = _vector(box["hwl"], 3)
        if min(height, width, length) <= 0:
            raise ValueError(f"hwl is {box['hwl']}, expected more than 0")
        centre = box_frame[0] + box_frame[1] @ _vector(corner["x"], 3)
        if box["where_is_t"] == "bottom":
            centre = centre + box_rotation[:, 2] * height / 2
        elif box["where_is_t"] != "center":
            raise ValueError(f"where_is_t is {box['where_is_t']!r}, expected 'bottom' or 'center'")
        size, yaw = np.array([length, width, height]), float(heading(box_rotation))
    position = frame[0] + frame[1] @ _vector(point["x"], 3)
    return ObjectState(int(data["ID"]), str(data["obj_type"]), position, rotation, velocity, centre, size, yaw)


def _referenced(text: str, name: str) -> tuple[dict[str, Any], tuple[Floats, Floats]]:
    """A position, velocity or attitude, and the pose of its reference frame."""
    data = _decode(text)[name]
    return data, _pose(data["reference"])


@lru_cache(maxsize=256)
def _pose(reference: str) -> tuple[Floats, Floats]:
    """Position (3,) m and active rotation (3, 3) of a reference frame in the world.

    Resolved through all its parents.
    """
    data = _decode(reference)["reference"]
    position, rotation = _vector(data["x"], 3), _active(data["qw"], data["qv"])
    if data["reference"] is None:
        return position, rotation
    parent_position, parent_rotation = _pose(data["reference"])
    return parent_position + parent_rotation @ position, parent_rotation @ rotation


def _active(qw: Any, qv: Any) -> Floats:
    """(3, 3) active rotation of a passive quaternion."""
    quaternion = np.concatenate([_vector([qw], 1), -_vector(qv, 3)])
    if abs(float(np.linalg.norm(quaternion)) - 1.0) > 1e-3:
        raise ValueError(f"quaternion {[qw, *qv]} does not have length 1")
    return rotation_from_quaternion(quaternion)


def _vector(values: Sequence[Any], length: int) -> Floats:
    vector = np.array([float(value) for value in values])
    if len(vector) != length:
        raise ValueError(f"{list(values)} has {len(vector)} numbers, expected {length}")
    if not np.isfinite(vector).all():
        raise ValueError(f"{list(values)} contains a number that is not finite")
    return vector


def _container(path: Path, frame: int) -> tuple[float, list[str]]:
    data = _read(path)
    try:
        container = data["datacontainer"]
        if int(container["frame"]) != frame:
            raise ValueError(f"frame is {container['frame']}, but {frame} in the name of the file")
        return float(container["timestamp"]), list(container["data"])
    except (ValueError, KeyError, TypeError) as error:
        raise SceneError(f"{path}: datacontainer: {reason(error)}") from error


def _read(path: Path) -> Any:
    try:
        return _decode(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise SceneError(f"{path}: {reason(error)}") from error


def _decode(text: str) -> Any:
    return json.loads(text, parse_constant=reject_constant)
