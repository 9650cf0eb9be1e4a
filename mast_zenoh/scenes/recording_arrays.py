"""The arrays of a recording: their shapes and types, in memory and in a file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.errors import SceneError

_BOX = {"position": "N,3", "size": "N,3", "yaw": "N", "class_id": "N"}
#: Shape of each array: F frames, A agents, N truth rows, D detections, B buildings, C corners of them,
#: S = F * sensors + 1, T = F + 1, U = B + 1.
SHAPES: dict[str, str] = {
    "times_ns": "F",
    "truth_start": "T",
    "points": "N,A",
    "agent_position": "F,A,3",
    "agent_rotation": "F,A,3,3",
    "agent_velocity": "F,A,3",
    "detection_start": "S",
    "detection_truth_id": "D",
    "building_height": "B",
    "building_start": "U",
    "building_corners": "C,2",
    "truth.id": "N",
    "truth.velocity": "N,3",
    **{f"truth.{name}": shape for name, shape in _BOX.items()},
    **{f"detections.{name}": shape.replace("N", "D") for name, shape in _BOX.items()},
    "detections.score": "D",
    "detections.covariance": "D,3,3",
}
#: Arrays that only some recordings have; their shapes are checked in `measurements`.
_OPTIONAL = ("measurements.age_ns", "measurements.position", "measurements.rotation")
#: Types other than float64.
_TYPES: dict[str, Any] = {
    "points": np.int32,
    "measurements.age_ns": np.int64,
    **{name: np.uint8 for name in SHAPES if name.endswith("class_id")},
    **{name: np.int64 for name in SHAPES if name.endswith(("_ns", "_start", "id")) and not name.endswith("class_id")},
}
#: Where the number of each kind comes from.
_COUNTED = {
    "F": "times_ns",
    "N": "truth.id",
    "D": "detection_truth_id",
    "B": "building_height",
    "C": "building_corners",
}


def arrays_of_file(
    place: object, arrays: Mapping[str, NDArray[Any]], agents: int, sensors: int
) -> dict[str, NDArray[Any]]:
    """The arrays of SHAPES with their types. place: of the recording, for messages; agents: A; sensors: of all agents

    Raises SceneError for an array that is missing, of another shape, or not of the numbers that it should hold.
    """
    for name in SHAPES:
        if name not in arrays:
            raise SceneError(f"{place}: {name} is missing")
    check_shapes(place, arrays, agents, sensors)
    return {name: _typed(place, name, values) for name, values in arrays.items() if name in (*SHAPES, *_OPTIONAL)}


def check_shapes(place: object, arrays: Mapping[str, NDArray[Any]], agents: int, sensors: int) -> None:
    """Raise SceneError for the first of the arrays of SHAPES, as far as they are given, with another shape."""
    counts = {"A": agents, "3": 3, "2": 2}
    counts |= {letter: max(arrays[name].shape[:1], default=0) for letter, name in _COUNTED.items() if name in arrays}
    counts |= {"T": counts["F"] + 1, "S": counts["F"] * sensors + 1, "U": counts["B"] + 1}
    for name in SHAPES:
        if name in arrays:
            expected = tuple(counts[letter] for letter in SHAPES[name].split(","))
            if arrays[name].shape != expected:
                raise SceneError(f"{place}: {name} has shape {arrays[name].shape}, expected {expected}")


def check_times(place: object, times_ns: NDArray[np.int64]) -> None:
    """Raise SceneError for a frame that is not later than the one before."""
    late = np.flatnonzero(np.diff(times_ns) <= 0)
    if len(late):
        raise SceneError(f"{place}: frame {late[0] + 1} is not later than frame {late[0]}")


def _typed(place: object, name: str, array: NDArray[Any]) -> NDArray[Any]:
    """An array with its type; raises SceneError if that would change a number."""
    wanted = np.dtype(_TYPES.get(name, np.float64))
    if array.dtype == wanted:
        return array
    kinds = "iu" if wanted.kind in "iu" else "fiu"
    limits = np.iinfo(wanted) if wanted.kind in "iu" else None
    outside = limits is not None and array.dtype.kind in "iu" and array.size > 0
    if array.dtype.kind not in kinds or (
        outside and limits is not None and (int(array.min()) < limits.min or int(array.max()) > limits.max)
    ):
        raise SceneError(f"{place}: {name} has the type {array.dtype}, expected {wanted}")
    converted: NDArray[Any] = array.astype(wanted)
    return converted
