"""Coordinate systems of an OpenLABEL file, and the transforms of a frame."""

from __future__ import annotations

import numpy as np

from mast_zenoh.arrays.states import Floats
from mast_zenoh.errors import SceneError, nearest
from mast_zenoh.scenes.files.elements import Element
from mast_zenoh.scenes.files.matrices import read_listed_pose

_BETWEEN = "_to_"


class Coordinates:
    """The tree of coordinate systems in one frame.

    openlabel:  the file's content, with `coordinate_systems`
    properties: the frame's `frame_properties`, with `transforms`, which take precedence

    Raises SceneError. Matrices are decoded only when they are needed, since other sensors' have other forms.
    """

    def __init__(self, openlabel: Element, properties: Element) -> None:
        self._element = properties
        self._parents: dict[str, tuple[str, Element]] = {}
        self._names: dict[str, None] = {}
        systems, transforms = openlabel.get("coordinate_systems"), properties.get("transforms")
        for name, system in systems.members() if systems else ():
            self._names[name] = None
            parent = system.get("parent")
            if parent is not None and parent.text():
                self._add(name, parent.text(), system)
        for name, transform in transforms.members() if transforms else ():
            source, target = _ends(name, transform)
            self._add(source, target, transform)

    def _add(self, name: str, parent: str, element: Element) -> None:
        self._parents[name] = parent, element
        self._names |= {name: None, parent: None}

    def locate(self, name: str) -> tuple[str, Floats, Floats]:
        """The root above a coordinate system, and its position (3,) m and rotation (3, 3) there."""
        if name not in self._names:
            known = list(self._names)
            raise SceneError(
                f"{self._element.path}: {self._element.place}: found no coordinate system {name!r}, "
                f"expected one in coordinate_systems or transforms{nearest(name, known)}"
            )
        position, rotation = np.zeros(3), np.eye(3)
        current, visited = name, {name}
        while current in self._parents:
            current, element = self._parents[current]
            if current in visited:
                raise SceneError(
                    f"{element.path}: {element.place}: found a parent {current!r} that is below {name!r} itself, "
                    "expected a tree of coordinate systems"
                )
            visited.add(current)
            offset, turn = read_listed_pose(_matrix(element))
            position, rotation = offset + turn @ position, turn @ rotation
        return current, position, rotation


def _ends(name: str, transform: Element) -> tuple[str, str]:
    """Source and target of a transform: its `src` and `dst`, otherwise from its name SRC_to_DST."""
    source, target = transform.get("src"), transform.get("dst")
    if source is not None and target is not None:
        return source.text(), target.text()
    ends = name.split(_BETWEEN)
    if len(ends) != 2:
        transform.fail("src and dst, or a name SRC_to_DST")
    return ends[0], ends[1]


def _matrix(element: Element) -> Element:
    """The matrix of a transform, or of a coordinate system's pose."""
    transform = element.get("transform_src_to_dst")
    return (transform or element["pose_wrt_parent"])["matrix4x4"]
