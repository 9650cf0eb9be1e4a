"""Decodes the file of an agent in one frame: its pose, and the objects that it lists."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.geometry import heading
from mast_zenoh.arrays.states import CLASS_INDEX, Floats, Ints
from mast_zenoh.scenes.files.elements import Element
from mast_zenoh.scenes.opv2v.poses import numbers, pose, positions, rotations
from mast_zenoh.scenes.opv2v.variants import LEFT_OUT, Variant, category_key, class_of

_MAX_OBJECTS = 20_000  # in one file
_MAX_ID = 10**12
_MAX_EXTENT_M = 1000.0


@dataclass(frozen=True, eq=False)
class Labels:
    """n objects of one file, in the world frame.

    id: (n,);  associated: (n,) id that agents share, -1 if there is none;  position: (n, 3) m middle of the box
    size: (n, 3) m l w h;  yaw: (n,) rad;  class_id: (n,)
    """

    id: Ints
    associated: Ints
    position: Floats
    size: Floats
    yaw: Floats
    class_id: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.id)

    def select(self, rows: NDArray[np.intp] | NDArray[np.bool_]) -> Labels:
        """The objects of the given rows, in that order."""
        return Labels(*(getattr(self, field.name)[rows] for field in fields(self)))


@dataclass(frozen=True, eq=False)
class AgentPose:
    """Where an agent is: position (3,) m of its body, lidar (3,) m, and rotation (3, 3) of its lidar, in the world."""

    position: Floats
    lidar: Floats
    rotation: Floats


def read_pose(content: Element, variant: Variant, is_pole: bool) -> AgentPose:
    """The pose of an agent in a file."""
    lidar, rotation = pose(content["lidar_pose"], variant.left_handed)
    if variant.body is None or is_pole:
        return AgentPose(lidar, lidar, rotation)
    body, _ = pose(content[variant.body], variant.left_handed)
    return AgentPose(body, lidar, rotation)


def read_labels(content: Element, variant: Variant, agent: AgentPose | None) -> Labels:
    """The objects in a file, without those that are not road users.

    agent: whose file it is; needed if places are in the frame of its lidar
    """
    listed = content[variant.objects]
    if listed.value is None or listed.value == []:  # as PyYAML may write none
        listed = Element({}, listed.path, listed.place)
    ids: list[int] = []
    associated: list[int] = []
    classes: list[int] = []
    rows: list[list[float]] = []
    for key, each in listed.members():
        if len(ids) == _MAX_OBJECTS:
            listed.fail(f"at most {_MAX_OBJECTS} objects")
        number = Element(key, listed.path, each.place).integer(0, _MAX_ID)
        category = _category(each, variant)
        if category in LEFT_OUT:
            continue
        extent = numbers(each["extent"], 3)
        if not 0 < min(extent) <= max(extent) <= _MAX_EXTENT_M:
            each["extent"].fail(f"3 numbers above 0, at most {_MAX_EXTENT_M:g}")
        shared = each.get("ass_id") if variant.associated else None
        ids.append(number)
        associated.append(-1 if shared is None else shared.integer(-1, _MAX_ID))
        classes.append(CLASS_INDEX["car"] if category is None else class_of(category))
        rows.append([*numbers(each["location"], 3), *numbers(each["center"], 3), *extent, *numbers(each["angle"], 3)])
    _check_unique(ids, listed)
    table = np.array(rows, np.float64).reshape(-1, 12)
    position = positions(table[:, :3] + table[:, 3:6], variant.left_handed)
    rotation = rotations(table[:, 9:], variant.left_handed)
    if variant.objects_in == "lidar" and agent is not None:
        position = agent.lidar + position @ agent.rotation.T
        rotation = agent.rotation @ rotation
    return Labels(
        np.array(ids, np.int64),
        np.array(associated, np.int64),
        position,
        2.0 * table[:, 6:9],
        heading(rotation),
        np.array(classes, np.uint8),
    )


def read_visible(content: Element, known: Ints) -> dict[int, int]:
    """Lidar returns by object, from a file of what an agent sees.

    known: (n,) ids of the objects in that frame
    """
    visible: dict[int, int] = {}
    objects = set(known.tolist())
    for each in content["visible_objects"].elements():
        number = each["object_id"].integer(0, _MAX_ID)
        if number in visible:
            each["object_id"].fail("each object once")
        category = each.get("category")
        if category is not None and category_key(category.text()) in LEFT_OUT:
            continue
        if number not in objects:
            each["object_id"].fail("an object that the map has in this frame")
        visible[number] = each["visible_points"].integer(0, 2**31 - 1)
    return visible


def _category(each: Element, variant: Variant) -> str | None:
    """The category of an object; None: the data set has none."""
    return None if variant.category is None else category_key(each[variant.category].text())


def _check_unique(ids: list[int], listed: Element) -> None:
    if len(set(ids)) != len(ids):
        twice = next(number for number in ids if ids.count(number) > 1)
        Element(twice, listed.path, listed.place).fail("each object once")
