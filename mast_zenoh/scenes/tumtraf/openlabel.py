"""Reads the OpenLABEL files of TUMTraf-V2X: cuboids of the registered point cloud."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mast_zenoh.arrays.geometry import rotation_from_quaternion
from mast_zenoh.arrays.states import CLASS_INDEX, Floats
from mast_zenoh.errors import SceneError
from mast_zenoh.scenes.files.elements import Element, read_json
from mast_zenoh.scenes.making.labels import read_point, read_size
from mast_zenoh.scenes.tumtraf.coordinates import Coordinates

MAX_FILES = 100_000
_MAX_TIME_S = 9e9  # the year 2255; more nanoseconds are no 64 bit number
_MAX_LENGTH_ERROR = 1e-3  # of a quaternion
_SIDES = ("labels_point_clouds", "_labels_point_clouds")
_REGISTERED = "s110_lidar_ouster_south_and_vehicle_lidar_robosense_registered"

#: Classes by type, in lower case; all others are unknown.
_TYPES = {
    "car": ("car", "van"),
    "truck": ("truck", "trailer"),
    "bus": ("bus",),
    "motorcycle": ("motorcycle",),
    "bicycle": ("bicycle",),
    "pedestrian": ("pedestrian",),
}
CLASS_OF_TYPE = {kind: CLASS_INDEX[name] for name, kinds in _TYPES.items() for kind in kinds}


@dataclass(frozen=True, eq=False)
class Cuboid:
    """A labelled object in a coordinate system.

    system: its name; None: that of all labels;  position: (3,) m, middle;  rotation: (3, 3) active;  size: (3,) m l w h
    """

    track: str
    class_id: int
    system: str | None
    position: Floats
    rotation: Floats
    size: Floats


@dataclass(frozen=True, eq=False)
class Frame:
    """A labelled frame. properties: where it is in the file, for messages."""

    time_ns: int
    properties: Element
    coordinates: Coordinates
    cuboids: list[Cuboid]


def find_labels(path: Path) -> Path:
    """The folder with the label files at `path`, which is that folder, or a folder of a split of the data set."""
    if not path.is_dir():
        raise SceneError(f"{path}: no such folder")
    for folder in (path, *(path / side / _REGISTERED for side in _SIDES)):
        if any(folder.glob("*.json")):
            return folder
    raise SceneError(f"{path}: found no label files *.json, expected them there or in {_SIDES[0]}/{_REGISTERED}")


def read_frames(folder: Path) -> list[Frame]:
    """All frames of the files in a folder, by the names of the files and then by number.

    Raises SceneError, also if their times do not ascend.
    """
    files = sorted(folder.glob("*.json"))
    if len(files) > MAX_FILES:
        raise SceneError(f"{folder}: found {len(files)} label files, expected at most {MAX_FILES}")
    frames: list[Frame] = []
    for file in files:
        for frame in _frames(file):
            if frames and frame.time_ns <= frames[-1].time_ns:
                frame.properties["timestamp"].fail(
                    f"a time later than {frames[-1].time_ns / 1e9} s in {frames[-1].properties.path.name}"
                )
            frames.append(frame)
    if not frames:
        raise SceneError(f"{folder}: found no frames in {len(files)} label files, expected at least one")
    return frames


def _frames(file: Path) -> Iterator[Frame]:
    openlabel = read_json(file)["openlabel"]
    numbered = [(Element(key, file, "openlabel.frames").integer(0), frame) for key, frame in _members(openlabel)]
    for _, frame in sorted(numbered, key=lambda item: item[0]):
        properties = frame["frame_properties"]
        objects = frame.get("objects")
        yield Frame(
            # Microseconds, since a number of seconds since 1970 has no more digits than that.
            round(properties["timestamp"].number(0, _MAX_TIME_S) * 1e6) * 1000,
            properties,
            Coordinates(openlabel, properties),
            [_cuboid(track, element, openlabel) for track, element in objects.members()] if objects else [],
        )


def _members(openlabel: Element) -> Iterator[tuple[str, Element]]:
    return openlabel["frames"].members()


def _cuboid(track: str, element: Element, openlabel: Element) -> Cuboid:
    """An object of a frame; its type is with it, as in TUMTraf, or in the file's objects, as in the standard."""
    data = element["object_data"]
    objects = openlabel.get("objects")
    described = objects.get(track) if objects else None
    kind = data["type"] if described is None or data.get("type") is not None else described["type"]
    cuboid = data["cuboid"]
    if isinstance(cuboid.value, list):
        (cuboid,) = cuboid.elements(1)
    value = cuboid["val"]
    value.elements(10)
    position, quaternion, size = (
        Element(value.value[a:b], value.path, f"{value.place}[{a}:{b}]") for a, b in ((0, 3), (3, 7), (7, 10))
    )
    named = next((place for place in (cuboid, data, element) if place.get("coordinate_system") is not None), None)
    return Cuboid(
        track,
        CLASS_OF_TYPE.get(kind.text().lower(), CLASS_INDEX["unknown"]),
        named["coordinate_system"].text() if named else None,
        read_point(position),
        _rotation(quaternion),
        read_size(size),
    )


def _rotation(element: Element) -> Floats:
    """(3, 3) active rotation of a quaternion x, y, z, w."""
    quaternion = np.array([value.number(-2, 2) for value in element.elements(4)])
    if abs(float(np.linalg.norm(quaternion)) - 1.0) > _MAX_LENGTH_ERROR:
        element.fail("a quaternion x, y, z, w of length 1")
    return rotation_from_quaternion(np.roll(quaternion, 1))
