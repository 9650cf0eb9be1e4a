"""What interposers did to the objects in messages: no more of the messages than is needed to say it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.effects.rows import UNCHANGED, Changes, compare, has_objects
from mast_zenoh.messages.schemas import Body
from mast_zenoh.metrics.manipulations import INSERTED, REMOVED

#: Columns that say what the frame of reference of all positions is: in the world, or in the agent's frame.
_REFERENCES = (("origin", "rotation"), ("mount_position", "mount_rotation"))
_WORLD = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])


class Passed(NamedTuple):
    """A message that was sent on changed: its frame, its number, the frame in which it was received, both bodies."""

    frame: int
    seq: int
    step: int
    before: Body
    after: Body


class ObjectChanges(NamedTuple):
    """What happened to k objects of some messages of one passage.

    frame, seq, step: (k,) of the message, and the frame of the run in which the interposer received it
    effect:   (k,) index into KINDS; UNCHANGED: the object moves with the frame of reference of its message
    columns:  (k,) object, names of the columns that were changed, separated by blanks
    id:       (k,) of the object in the message, -1: messages of this type have no ids
    before, after: (k, 3) m, where the object was in the message received and in the message sent; NaN: it was not
    velocity: (k, 3) m/s, as it was sent, or as it was received if it was removed; NaN: messages have none
    references: (2, k, 7) frames of reference of `before`, and of `after` and `velocity`: origin m, active quaternion
              w x y z
    of_agent: whether these are given in the frame of the agent, as the mount of a sensor is, or else in the world frame
    whole:    (k,) bool, the message was withheld, held up, forged or reframed as a whole
    frames_late: (k,) by how many frames it was held up, 0 unless it was
    """

    frame: Ints
    seq: Ints
    step: Ints
    effect: Ints
    columns: np.ndarray
    id: Ints
    before: Floats
    after: Floats
    velocity: Floats
    references: Floats
    of_agent: bool
    whole: Bools
    frames_late: Ints


def changed(message: str, passed: Sequence[Passed]) -> tuple[ObjectChanges, tuple[tuple[str, ...], ...]]:
    """The objects that differ in messages of one type, and of each message the names of its other columns that differ.

    Where the frame of reference of a message was changed, all its objects count.
    """
    bodies = [each.before for each in passed], [each.after for each in passed]
    changes = compare(message, *bodies)
    reframed = np.array([any(name in pair for name in names for pair in _REFERENCES) for names in changes.others], bool)
    of = changes.message
    rows = np.flatnonzero((changes.effect != UNCHANGED) | reframed[of]) if len(of) else of
    of = of[rows]
    ids, before, after, velocity = _places(changes, rows)
    return ObjectChanges(
        frame=np.array([each.frame for each in passed], np.int64)[of],
        seq=np.array([each.seq for each in passed], np.int64)[of],
        step=np.array([each.step for each in passed], np.int64)[of],
        effect=changes.effect[rows],
        columns=_named(changes.columns[rows], changes.names),
        id=ids,
        before=before,
        after=after,
        velocity=velocity,
        references=np.stack([np.stack([_reference(body) for body in side])[of] for side in bodies]),
        of_agent=_of_agent(bodies[0][0]),
        whole=changes.effect[rows] == UNCHANGED,
        frames_late=np.zeros(len(rows), np.int64),
    ), changes.others


def _places(changes: Changes, rows: Ints) -> tuple[Ints, Floats, Floats, Floats]:
    """Ids, places before and after, and velocities of some of the changes."""
    places, velocity = np.full((2, len(rows), 3), np.nan), np.full((len(rows), 3), np.nan)
    ids = np.full(len(rows), -1, np.int64)
    for side in (0, 1):
        columns, row = changes.sides[side].columns, (changes.before, changes.after)[side][rows]
        there = np.flatnonzero(row >= 0)
        if len(there):
            places[side, there] = columns["position"][row[there]]
            velocity[there] = columns["velocity"][row[there]] if "velocity" in columns else np.nan
            fresh = there[ids[there] < 0]  # an object is called what it was called when it was received
            ids[fresh] = columns["id"][row[fresh]] if "id" in columns else -1
    return ids, places[0], places[1], velocity


def whole(
    message: str, frame: int, seq: int, step: int, *, received: Body | None, sent: Body | None, frames_late: int = 0
) -> ObjectChanges:
    """All objects of a message of which nothing was sent on in time (`sent` is None), or that was not received."""
    body, effect = (received, REMOVED) if sent is None else (sent, INSERTED)
    assert body is not None
    n = len(body["position"]) if has_objects(message) else 0
    nowhere, reference = np.full((n, 3), np.nan), np.empty((2, n, len(_WORLD)))
    reference[:] = _reference(body)
    place = body["position"].copy() if n else nowhere
    return ObjectChanges(
        frame=np.full(n, frame, np.int64),
        seq=np.full(n, seq, np.int64),
        step=np.full(n, step, np.int64),
        effect=np.full(n, effect, np.int64),
        columns=np.full(n, "", object),
        id=body["id"].copy() if n and "id" in body else np.full(n, -1, np.int64),
        before=place if effect == REMOVED else nowhere,
        after=place if effect == INSERTED else nowhere,
        velocity=body["velocity"].copy() if n and "velocity" in body else nowhere,
        references=reference,
        of_agent=_of_agent(body),
        whole=np.ones(n, bool),
        frames_late=np.full(n, frames_late, np.int64),
    )


def _reference(body: Body) -> Floats:
    for origin, rotation in _REFERENCES:
        if origin in body:
            return np.concatenate([body[origin], body[rotation]])
    return _WORLD


def _of_agent(body: Body) -> bool:
    return _REFERENCES[1][0] in body


def _named(bits: Ints, names: tuple[str, ...]) -> np.ndarray:
    """(k,) object: the names of the bits that are set."""
    different, which = np.unique(bits, return_inverse=True)
    texts = np.empty(len(different), object)
    texts[:] = [" ".join(name for bit, name in enumerate(names) if each >> bit & 1) for each in different.tolist()]
    return texts[which.reshape(-1)]
