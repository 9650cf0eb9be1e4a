"""The agents' own cars among the objects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mast_zenoh.arrays.geometry import heading
from mast_zenoh.arrays.states import CLASS_INDEX, Bools, Floats, Ints
from mast_zenoh.errors import SceneError
from mast_zenoh.scenes.making.boxes import Boxes
from mast_zenoh.scenes.opv2v.traffic import FileOf, Listed
from mast_zenoh.scenes.opv2v.variants import Variant

_MAX_DISTANCE_M = 2.0  # on the ground, of the middle of an agent's own box
_MIN_LENGTH_M = 2.5  # of a car
_CARS = [CLASS_INDEX[name] for name in ("unknown", "car", "truck", "bus")]


@dataclass(frozen=True, eq=False)
class OwnCar:
    """A car that is an agent.

    number: of the agent;  position (F, 3) m and rotation (F, 3, 3) of the agent;  object_id: of its boxes
    """

    number: int
    position: Floats
    rotation: Floats
    object_id: int


def check_numbers(listed: Listed, cars: Sequence[OwnCar], file_of: FileOf) -> None:
    """Raise SceneError for a box with an agent's number that is not where the agent is."""
    for car in cars:
        wrong = np.flatnonzero((listed.labels.id == car.number) & (_distance(listed, car) > _MAX_DISTANCE_M))
        if len(wrong):
            row = int(wrong[0])
            raise SceneError(
                f"{file_of(int(listed.frame[row]), int(listed.agent[row]))}: object {car.number} is "
                f"{_distance(listed, car)[row]:.2f} m from agent {car.number}, "
                f"expected at most {_MAX_DISTANCE_M:g} m: it is the same car"
            )


def claim(listed: Listed, cars: Sequence[OwnCar]) -> tuple[Listed, list[OwnCar]]:
    """Find each agent's own boxes by their places, for data sets whose ids are not the agents' numbers.

    A box of a car within 2 m of an agent is the agent's, of each file the nearest one. It keeps its id if all boxes
    with that id are the agent's; otherwise the agent's boxes get an id that no other object has.
    """
    ids = listed.labels.id.copy()
    claimed: list[OwnCar] = []
    for car in cars:
        rows = _nearest(listed, _distance(listed, car))
        mine, count = np.unique(ids[rows], return_counts=True)
        complete = np.array([number for number in mine if (ids == number).sum() == count[mine == number][0]], np.int64)
        taken = {other.object_id for other in claimed}
        if len(complete):
            chosen = int(complete[np.argmax(count[np.isin(mine, complete)])])
        elif car.number not in taken and car.number not in ids:
            chosen = car.number
        else:
            chosen = max(int(ids.max(initial=0)), *taken, 0) + 1
        ids[rows] = chosen
        claimed.append(OwnCar(car.number, car.position, car.rotation, chosen))
    return listed.with_id(ids), claimed


def missing_boxes(boxes: Boxes, car: OwnCar, variant: Variant) -> Boxes:
    """Boxes of an agent's car in the frames in which nobody lists it.

    Their size and their place on the agent are those of the listed boxes; without any, the data set's usual car.
    """
    own = np.flatnonzero(boxes.id == car.object_id)
    frames = np.setdiff1d(np.arange(len(car.position)), boxes.frame[own])
    size, centre, class_id = variant.own_size, variant.own_centre, CLASS_INDEX["car"]
    if len(own):
        rotation = _upright(car.rotation[boxes.frame[own]])
        offset = boxes.position[own] - car.position[boxes.frame[own]]
        centre = np.einsum("nji,nj->ni", rotation, offset).mean(axis=0)
        size, class_id = np.median(boxes.size[own], axis=0), int(np.bincount(boxes.class_id[own]).argmax())
    position = car.position[frames] + _upright(car.rotation[frames]) @ centre
    return Boxes(
        frame=frames.astype(np.int64),
        id=np.full(len(frames), car.object_id, np.int64),
        position=position,
        size=np.tile(size, (len(frames), 1)),
        yaw=heading(car.rotation[frames]),
        class_id=np.full(len(frames), class_id, np.uint8),
        velocity=np.full_like(position, np.nan),
    )


def _upright(rotation: Floats) -> Floats:
    """(n, 3, 3) rotations with the same heading as those of lidars, which may be tilted on their cars."""
    upright = np.tile(np.eye(3), (len(rotation), 1, 1))
    yaw = heading(rotation)
    upright[:, 0, 0] = upright[:, 1, 1] = np.cos(yaw)
    upright[:, 1, 0], upright[:, 0, 1] = np.sin(yaw), -np.sin(yaw)
    return upright


def _distance(listed: Listed, car: OwnCar) -> Floats:
    """(N,) m on the ground from the agent to each box."""
    offset = listed.labels.position[:, :2] - car.position[listed.frame, :2]
    distance: Floats = np.hypot(offset[:, 0], offset[:, 1])
    return distance


def _nearest(listed: Listed, distance: Floats) -> Ints:
    """Rows of the nearest car in each file, if it is near enough."""
    near: Bools = (distance <= _MAX_DISTANCE_M) & (listed.labels.size[:, 0] >= _MIN_LENGTH_M)
    rows = np.flatnonzero(near & np.isin(listed.labels.class_id, _CARS))
    rows = rows[np.lexsort((distance[rows], listed.agent[rows], listed.frame[rows]))]
    first = np.ones(len(rows), np.bool_)
    first[1:] = (np.diff(listed.frame[rows]) != 0) | (np.diff(listed.agent[rows]) != 0)
    return rows[first]
