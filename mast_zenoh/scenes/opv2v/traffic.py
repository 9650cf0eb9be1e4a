"""Merges the objects that all agents list to the traffic of a scenario."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np

from mast_zenoh.arrays.states import Bools, Ints
from mast_zenoh.errors import SceneError
from mast_zenoh.scenes.making.boxes import Boxes
from mast_zenoh.scenes.opv2v.labels import Labels

_MAX_SPEED_M_S = 70.0  # of an object whose id lasts,
_MAX_STEP_M = 5.0  # in addition to this

#: The file of an agent (its column) in a frame (its row), for messages.
FileOf = Callable[[int, int], Path]


@dataclass(frozen=True, eq=False)
class Listed:
    """N objects, as the agents list them. frame (N,): row of the frame; agent (N,): column of the agent."""

    frame: Ints
    agent: Ints
    labels: Labels

    @classmethod
    def of(cls, labels: Sequence[Sequence[Labels]]) -> Listed:
        """The objects in the files of each agent, for each frame."""
        parts = [part for frame in labels for part in frame]
        rows = np.array([len(part) for part in parts], np.int64)
        count = len(labels[0])
        joined = Labels(*(np.concatenate([getattr(part, each.name) for part in parts]) for each in fields(Labels)))
        place = np.repeat(np.arange(len(parts)), rows)
        return cls(place // count, place % count, joined)

    def with_id(self, number: Ints) -> Listed:
        """The same objects with other ids (N,)."""
        return replace(self, labels=replace(self.labels, id=number))

    def merged(self, limit_m: float, file_of: FileOf) -> tuple[Boxes, Bools]:
        """One box for each object and frame, by frame and id, and whether each agent (column) lists it.

        limit_m: how far apart the agents may place an object; that of the first agent counts

        Raises SceneError if they are further apart, and for an object that an agent lists twice.
        """
        number, position = self.labels.id, self.labels.position
        order = np.lexsort((self.agent, number, self.frame))
        key = np.stack([self.frame[order], number[order]], axis=1)
        first = np.ones(len(order), np.bool_)
        first[1:] = (np.diff(key, axis=0) != 0).any(axis=1)
        group = np.cumsum(first) - 1
        repeated = ~first[1:] & (np.diff(self.agent[order]) == 0)
        if repeated.any():
            row = order[1:][repeated][0]
            file = file_of(int(self.frame[row]), int(self.agent[row]))
            raise SceneError(f"{file}: found object {number[row]} twice, expected it once")
        chosen = order[first]
        apart = np.linalg.norm(position[order] - position[chosen][group], axis=1)
        if (apart > limit_m).any():
            worst = int(apart.argmax())
            row, other = order[worst], chosen[group[worst]]
            raise SceneError(
                f"{file_of(int(self.frame[row]), int(self.agent[row]))}: object {number[row]} is {apart[worst]:.2f} m "
                f"from where agent {file_of(int(self.frame[other]), int(self.agent[other])).parent.name} lists it, "
                f"expected at most {limit_m:g} m"
            )
        agents = int(self.agent.max(initial=-1)) + 1
        seen = np.zeros((len(chosen), agents), np.bool_)
        seen[group, self.agent[order]] = True
        return self._boxes(chosen), seen

    def _boxes(self, rows: Ints) -> Boxes:
        labels = self.labels.select(rows)
        return Boxes(
            frame=self.frame[rows],
            id=labels.id,
            position=labels.position,
            size=labels.size,
            yaw=labels.yaw,
            class_id=labels.class_id,
            velocity=np.full_like(labels.position, np.nan),
        )


def check_ids_last(boxes: Boxes, times_ns: Ints, file_of: Callable[[int], Path]) -> None:
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
    pair = np.stack([listed.agent, listed.labels.id], axis=1)
    own = np.unique(pair, axis=0, return_inverse=True)[1].reshape(-1).astype(np.int64)
    shared = listed.labels.associated.copy()
    pairs = np.unique(np.stack([own, shared], axis=1)[shared >= 0], axis=0)
    objects, index, count = np.unique(pairs[:, 0], return_index=True, return_counts=True)
    known = dict(zip(objects[count == 1].tolist(), pairs[index[count == 1], 1].tolist(), strict=True))
    taken = set(zip(listed.frame.tolist(), listed.agent.tolist(), shared.tolist(), strict=True))
    for row in np.flatnonzero(shared < 0).tolist():
        candidate = known.get(int(own[row]), -1)
        place = (int(listed.frame[row]), int(listed.agent[row]), candidate)
        if candidate >= 0 and place not in taken:
            shared[row] = candidate
            taken.add(place)
    return np.where(shared >= 0, shared, own + 1 + shared.max(initial=-1))
