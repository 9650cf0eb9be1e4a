"""The data sets of the family: what is different in each."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from mast_zenoh.arrays.states import CLASS_INDEX, Floats
from mast_zenoh.sensing import LidarSensor

_CLASSES = {
    "car": ("car", "policecar", "longvehicle", "van"),
    "truck": ("truck", "concretetruck", "pickuptruck", "semitruck"),
    "bus": ("bus",),
    "motorcycle": ("motorcycle", "motorcylerider", "motorcyclerider"),
    "bicycle": ("bicycle", "bicyclerider", "cycle"),
    "pedestrian": ("pedestrian", "child", "roadworker"),
}
_CLASS_OF_CATEGORY = {category: CLASS_INDEX[name] for name, group in _CLASSES.items() for category in group}
#: Categories of objects that are not road users.
LEFT_OUT = ("constructioncart", "firehydrant", "trashcan")

#: The car of all agents of OPV2V and V2XSet, a Lincoln MKZ; its size is in the annotation example of OpenCOOD.
_LINCOLN = np.array([4.902, 2.128, 1.511])


def category_key(text: str) -> str:
    """A category in lower case without spaces, hyphens and underscores."""
    return "".join(letter for letter in text.lower() if letter not in " -_")


def class_of(category: str) -> int:
    """The class of a category, as written by `category_key`; 0 (unknown) if it is not known."""
    return _CLASS_OF_CATEGORY.get(category, 0)


def _lidar(low: float, high: float, max_range_m: float) -> LidarSensor:
    return LidarSensor(
        mount_position=np.zeros(3),
        azimuth_step_deg=0.36,  # 1.3 million beams/s of 64 channels at 20 Hz
        elevation_min_deg=low,
        elevation_max_deg=high,
        max_range_m=max_range_m,
    )


@dataclass(frozen=True, eq=False)
class Variant:
    """Conventions of a data set.

    left_handed:    y is to the right, as in CARLA; it is inverted, and with it yaw and roll
    objects:        key of the objects in an agent's file
    objects_in:     the frame of their places: "world", or the agent's "lidar"
    category:       key of an object's category; None: all are cars
    associated:     ids are those of one agent's labels; `ass_id` is the id that agents share
    body:           key of the pose of a car's body on the ground; None: the car is where its lidar is
    car, pole:      lidars of the agents, without their mount
    disagreement_m: how far apart the places of one object may be in the files of two agents
    own_size:       (3,) m of a car that no other agent ever lists, and
    own_centre:     (3,) m the middle of its box in the frame of the agent
    """

    left_handed: bool
    objects: str = "vehicles"
    objects_in: Literal["world", "lidar"] = "world"
    category: str | None = None
    associated: bool = False
    body: str | None = None
    car: LidarSensor = field(default_factory=lambda: _lidar(-25.0, 2.0, 120.0))
    pole: LidarSensor = field(default_factory=lambda: _lidar(-40.0, 0.0, 120.0))
    disagreement_m: float = 5.0
    own_size: Floats = field(default_factory=_LINCOLN.copy)
    own_centre: Floats = field(default_factory=lambda: np.array([0.0, 0.0, _LINCOLN[2] / 2]))


def _under_lidar() -> Floats:
    """The middle of a car's box in the frame of a lidar that is 1.9 m above the ground."""
    return np.array([0.0, 0.0, _LINCOLN[2] / 2 - 1.9])


OPV2V = Variant(left_handed=True, body="true_ego_pos", disagreement_m=0.5)
MULTI_V2X = Variant(
    left_handed=True,
    objects="objects",
    category="category",
    body="true_ego_pos",
    car=_lidar(-30.0, 10.0, 120.0),
    disagreement_m=0.5,
)
V2X_REAL = Variant(
    left_handed=True,
    category="obj_type",
    car=_lidar(-25.0, 15.0, 200.0),
    pole=_lidar(-45.0, 15.0, 200.0),
    own_centre=_under_lidar(),
)
V2V4REAL = Variant(
    left_handed=False,
    objects_in="lidar",
    category="obj_type",
    associated=True,
    car=_lidar(-25.0, 15.0, 200.0),
    own_centre=_under_lidar(),
)
