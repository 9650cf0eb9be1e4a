"""What stations perceive, for tests of generation rules."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from mast_zenoh.arrays.states import CLASS_INDEX, ObjectStates
from mast_zenoh.v2x import Generation, HeardObjects, Perception

FRAME_NS = 100_000_000


def objects(*ids: int, x: float | Sequence[float] = 0.0, v: Any = (0.0, 0.0), cls: str = "car") -> ObjectStates:
    """Objects at (x, 10 id, 0) m with velocity v m/s, all of one class."""
    position = np.zeros((len(ids), 3))
    position[:, 0], position[:, 1] = x, np.array(ids) * 10.0
    velocity = np.zeros((len(ids), 3))
    velocity[:, :2] = v
    classes = np.full(len(ids), CLASS_INDEX[cls], np.uint8)
    return ObjectStates.of(position, id=np.array(ids, np.int64), velocity=velocity, class_id=classes)


def perceived(frame: int, states: ObjectStates, **others: Any) -> Perception:
    """A perception in a frame of 100 ms."""
    return Perception.of(frame * FRAME_NS, states, **others)


def sent_ids(generation: Generation, states: ObjectStates) -> list[int]:
    """The ids in a message, in its order."""
    ids: list[int] = states.id[generation.rows].tolist()
    return ids


def reports(
    states: ObjectStates, frame: int = 0, sender_position: tuple[float, float, float] = (0, 0, 0)
) -> HeardObjects:
    """Objects heard from one other station."""
    n = len(states)
    times = np.full(n, frame * FRAME_NS, np.int64)
    return HeardObjects(times, states.position, states.velocity, np.tile(np.array(sender_position, float), (n, 1)))
