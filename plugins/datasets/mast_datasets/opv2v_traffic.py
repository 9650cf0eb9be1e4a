"""Objects that several agents list, and the agents among them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mast_datasets.opv2v_files import Variant
from mast_zenoh.arrays.geometry import heading
from mast_zenoh.arrays.states import CLASS_INDEX, Bools, Floats, Ints
from mast_zenoh.errors import SceneError
from mast_zenoh.scenes.making.assembly import SceneBoxes

_MAX_SPEED_M_S = 70.0  # of an object whose id lasts,
_MAX_STEP_M = 5.0  # in addition to this

#: The file of an agent (its column) in a frame (its row), for messages.
FileOf = Callable[[int, int], Path]


@dataclass(frozen=True, eq=False)
class Listed:
    """N boxes, as the agents list them.

    agent: (N,) column of the agent;  associated: (N,) id that agents share, -1 if there is none
    """

    agent: Ints
    associated: Ints
    boxes: SceneBoxes

    @classmethod
    def of(cls, labels: Sequence[Sequence[tuple[SceneBoxes, Ints]]]) -> Listed:
        """The objects in the files of each agent, for each frame."""
        boxes, associated = zip(*(part for frame in labels for part in frame), strict=True)
        agent = np.arange(len(boxes)) % len(labels[0])
        return cls(np.repeat(agent, [*map(len, boxes)]), np.concatenate(associated), SceneBoxes.concatenate(boxes))

    def with_id(self, number: Ints) -> Listed:
        """The same objects with other ids (N,)."""
        return replace(self, boxes=replace(self.boxes, id=number))

    def merged(self, limit_m: float, file_of: FileOf) -> tuple[SceneBoxes, Bools]:
        """One box for each object and frame, by frame and id, and whether each agent (column) lists it.

        limit_m: how far apart the agents may place an object; that of the first agent counts

        Raises SceneError if they are further apart, and for an object that an agent lists twice.
        """
        frame, number, position = self.boxes.frame, self.boxes.id, self.boxes.position
        order = np.lexsort((self.agent, number, frame))
        key = np.stack([frame[order], number[order]], axis=1)
        first = np.ones(len(order), np.bool_)
        first[1:] = (np.diff(key, axis=0) != 0).any(axis=1)
        group = np.cumsum(first) - 1
        repeated = ~first[1:] & (np.diff(self.agent[order]) == 0)
        if repeated.any():
            row = order[1:][repeated][0]
            file = file_of(int(frame[row]), int(self.agent[row]))
            raise SceneError(f"{file}: found object {number[row]} twice, expected it once")
        chosen = order[first]
        apart = np.linalg.norm(position[order] - position[chosen][group], axis=1)
        if (apart > limit_m).any():
            worst = int(apart.argmax())
            row, other = order[worst], chosen[group[worst]]
            raise SceneError(
                f"{file_of(int(frame[row]), int(self.agent[row]))}: object {number[row]} is {apart[worst]:.2f} m "
                f"from where agent {file_of(int(frame[other]), int(self.agent[other])).parent.name} lists it, "
                f"expected at most {limit_m:g} m"
            )
        agents = int(self.agent.max(initial=-1)) + 1
        seen = np.zeros((len(chosen), agents), np.bool_)
        seen[group, self.agent[order]] = True
        return self.boxes.select(chosen), seen


def check_ids_last(boxes: SceneBoxes, times_ns: Ints, file_of: Callable[[int], Path]) -> None:
    """Raise SceneError for an id that is somewhere else a moment later: then it is another object.

    file_of: a file of a frame (row), for the message
    """
    order = np.lexsort((boxes.frame, boxes.id))
    same = np.diff(boxes.id[order]) == 0
    step = np.linalg.norm(np.diff(boxes.position[order], axis=0), axis=1)
    limit = _MAX_STEP_M + _MAX_SPEED_M_S * np.diff(times_ns[boxes.frame[order]]) / 1e9
    jumps = np.flatnonzero(same & (step > limit))
    if len(jumps):
        before, after = order[jumps[0]], order[jumps[0] + 1]
        raise SceneError(
            f"{file_of(int(boxes.frame[after]))}: object {boxes.id[after]} is {step[jumps[0]]:.1f} m from where it was "
            f"in {file_of(int(boxes.frame[before])).name}, expected at most {limit[jumps[0]]:.1f} m: "
            "an id must be that of one object"
        )


def shared_ids(listed: Listed) -> Ints:
    """(N,) ids that all agents share, of objects that have an id for each agent, and possibly an associated one.

    An associated id is kept. An object that has a single one in some frames keeps it in the others, too. All others
    get the next ids that are free, one for each object of each agent.
    """
    pair = np.stack([listed.agent, listed.boxes.id], axis=1)
    own = np.unique(pair, axis=0, return_inverse=True)[1].reshape(-1).astype(np.int64)
    shared = listed.associated.copy()
    pairs = np.unique(np.stack([own, shared], axis=1)[shared >= 0], axis=0)
    objects, index, count = np.unique(pairs[:, 0], return_index=True, return_counts=True)
    known = dict(zip(objects[count == 1].tolist(), pairs[index[count == 1], 1].tolist(), strict=True))
    taken = set(zip(listed.boxes.frame.tolist(), listed.agent.tolist(), shared.tolist(), strict=True))
    for row in np.flatnonzero(shared < 0).tolist():
        candidate = known.get(int(own[row]), -1)
        place = (int(listed.boxes.frame[row]), int(listed.agent[row]), candidate)
        if candidate >= 0 and place not in taken:
            shared[row] = candidate
            taken.add(place)
    return np.where(shared >= 0, shared, own + 1 + shared.max(initial=-1))


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
        wrong = np.flatnonzero((listed.boxes.id == car.number) & (_distance(listed, car) > _MAX_DISTANCE_M))
        if len(wrong):
            row = int(wrong[0])
            raise SceneError(
                f"{file_of(int(listed.boxes.frame[row]), int(listed.agent[row]))}: object {car.number} is "
                f"{_distance(listed, car)[row]:.2f} m from agent {car.number}, "
                f"expected at most {_MAX_DISTANCE_M:g} m: it is the same car"
            )


def claim(listed: Listed, cars: Sequence[OwnCar]) -> tuple[Listed, list[OwnCar]]:
    """Find each agent's own boxes by their places, for data sets whose ids are not the agents' numbers.

    A box of a car within 2 m of an agent is the agent's, of each file the nearest one. It keeps its id if all boxes
    with that id are the agent's; otherwise the agent's boxes get an id that no other object has.
    """
    ids = listed.boxes.id.copy()
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


def missing_boxes(boxes: SceneBoxes, car: OwnCar, variant: Variant) -> SceneBoxes:
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
    return SceneBoxes(
        frame=frames.astype(np.int64),
        id=np.full(len(frames), car.object_id, np.int64),
        position=position,
        size=np.tile(size, (len(frames), 1)),
        yaw=heading(car.rotation[frames]),
        class_id=np.full(len(frames), class_id, np.uint8),
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
    offset = listed.boxes.position[:, :2] - car.position[listed.boxes.frame, :2]
    distance: Floats = np.hypot(offset[:, 0], offset[:, 1])
    return distance


def _nearest(listed: Listed, distance: Floats) -> Ints:
    """Rows of the nearest car in each file, if it is near enough."""
    near: Bools = (distance <= _MAX_DISTANCE_M) & (listed.boxes.size[:, 0] >= _MIN_LENGTH_M)
    rows = np.flatnonzero(near & np.isin(listed.boxes.class_id, _CARS))
    rows = rows[np.lexsort((distance[rows], listed.agent[rows], listed.boxes.frame[rows]))]
    first = np.ones(len(rows), np.bool_)
    first[1:] = (np.diff(listed.boxes.frame[rows]) != 0) | (np.diff(listed.agent[rows]) != 0)
    return rows[first]
