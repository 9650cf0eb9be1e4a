"""Effects of interposers on the objects in messages."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.effects.rows import UNCHANGED, Changes, compare, has_objects
from mast_zenoh.messages.schemas import Body
from mast_zenoh.metrics.manipulations import INSERTED, REMOVED

#: Columns with the frame of reference of all positions: in the world or in the agent's frame.
_REFERENCES = (("origin", "rotation"), ("mount_position", "mount_rotation"))
_WORLD = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])


class ChangedMessage(NamedTuple):
    """A changed message.

    seq: its number; step: the frame in which it was received; before, after: its bodies
    """

    frame: int
    seq: int
    step: int
    before: Body
    after: Body


class ObjectChanges(NamedTuple):
    """Effects on k objects in messages of one passage.

    frame, seq, step: (k,) of the message, and the frame of the run in which the interposer received it
    effect:   (k,) index into KINDS; UNCHANGED: the object moves with the frame of reference of its message
    columns:  (k,) object, names of the columns that were changed, separated by spaces
    id:       (k,) of the object in the message, -1: messages of this type have no ids
    before, after: (k, 3) m, the object's position in the received and in the sent message; NaN: absent
    velocity: (k, 3) m/s, as sent, or as received for a removed object; NaN: messages have none
    references: (2, k, 7) frames of reference of `before`, and of `after` and `velocity`: origin m, active quaternion
              w x y z
    of_agent: whether these are relative to the agent (the mount of a sensor) instead of the world
    whole:    (k,) bool, the whole message was withheld, delayed, forged or reframed
    frames_late: (k,) delay of the message in frames
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


def changed_objects(
    message: str, messages: Sequence[ChangedMessage]
) -> tuple[ObjectChanges, tuple[tuple[str, ...], ...]]:
    """Changed objects in messages of one type, and their other changed columns.

    The latter are names for each message.
    If the frame of reference of a message was changed, all its objects count.
    """
    bodies = [item.before for item in messages], [item.after for item in messages]
    changes = compare(message, *bodies)
    reframed = np.array([any(name in pair for name in names for pair in _REFERENCES) for names in changes.others], bool)
    message_row = changes.message
    rows = np.flatnonzero((changes.effect != UNCHANGED) | reframed[message_row]) if len(message_row) else message_row
    message_row = message_row[rows]
    ids, before, after, velocity = _positions(changes, rows)
    return ObjectChanges(
        frame=np.array([item.frame for item in messages], np.int64)[message_row],
        seq=np.array([item.seq for item in messages], np.int64)[message_row],
        step=np.array([item.step for item in messages], np.int64)[message_row],
        effect=changes.effect[rows],
        columns=_bit_names(changes.columns[rows], changes.names),
        id=ids,
        before=before,
        after=after,
        velocity=velocity,
        references=np.stack([np.stack([_reference(body) for body in side])[message_row] for side in bodies]),
        of_agent=_of_agent(bodies[0][0]),
        whole=changes.effect[rows] == UNCHANGED,
        frames_late=np.zeros(len(rows), np.int64),
    ), changes.others


def _positions(changes: Changes, rows: Ints) -> tuple[Ints, Floats, Floats, Floats]:
    """Ids, positions before and after, and velocities of the changes in `rows`."""
    positions, velocity = np.full((2, len(rows), 3), np.nan), np.full((len(rows), 3), np.nan)
    ids = np.full(len(rows), -1, np.int64)
    for side in (0, 1):
        columns, row = changes.sides[side].columns, (changes.before, changes.after)[side][rows]
        present = np.flatnonzero(row >= 0)
        if len(present):
            positions[side, present] = columns["position"][row[present]]
            velocity[present] = columns["velocity"][row[present]] if "velocity" in columns else np.nan
            unset = present[ids[present] < 0]  # the id as received takes precedence
            ids[unset] = columns["id"][row[unset]] if "id" in columns else -1
    return ids, positions[0], positions[1], velocity


def whole_message(
    message: str, frame: int, seq: int, step: int, *, received: Body | None, sent: Body | None, frames_late: int = 0
) -> ObjectChanges:
    """All objects of a message that was not sent on in time, or not received.

    received, sent: its bodies; None: not received, or not sent in time
    """
    body, effect = (received, REMOVED) if sent is None else (sent, INSERTED)
    assert body is not None
    n = len(body["position"]) if has_objects(message) else 0
    nowhere, reference = np.full((n, 3), np.nan), np.empty((2, n, len(_WORLD)))
    reference[:] = _reference(body)
    position = body["position"].copy() if n else nowhere
    return ObjectChanges(
        frame=np.full(n, frame, np.int64),
        seq=np.full(n, seq, np.int64),
        step=np.full(n, step, np.int64),
        effect=np.full(n, effect, np.int64),
        columns=np.full(n, "", object),
        id=body["id"].copy() if n and "id" in body else np.full(n, -1, np.int64),
        before=position if effect == REMOVED else nowhere,
        after=position if effect == INSERTED else nowhere,
        velocity=body["velocity"].copy() if n and "velocity" in body else nowhere,
        references=reference,
        of_agent=_of_agent(body),
        whole=np.ones(n, bool),
        frames_late=np.full(n, frames_late, np.int64),
    )


def _reference(body: Body) -> Floats:
    for pair in _REFERENCES:
        if _has(body, pair):
            return np.concatenate([body[name] for name in pair])
    return _WORLD


def _of_agent(body: Body) -> bool:
    return _has(body, _REFERENCES[1])


def _has(body: Body, reference: tuple[str, str]) -> bool:
    """Whether a message states its coordinate frame.

    A user's message type may have only one of these columns, or other shapes.
    """
    origin, rotation = reference
    return origin in body and rotation in body and body[origin].shape == (3,) and body[rotation].shape == (4,)


def _bit_names(bits: Ints, names: tuple[str, ...]) -> np.ndarray:
    """(k,) object: the names of the set bits."""
    masks, index = np.unique(bits, return_inverse=True)
    strings = np.empty(len(masks), object)
    strings[:] = [" ".join(name for bit, name in enumerate(names) if mask >> bit & 1) for mask in masks.tolist()]
    return strings[index.reshape(-1)]
