"""Velocity, covariance and class of boxes, from the recorded messages and the scene: objects.parquet lacks them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.states import Floats
from mast_zenoh.errors import MastError
from mast_zenoh.messagelog.reader import read
from mast_zenoh.messages import codec
from mast_zenoh.messages.schemas import Body
from mast_zenoh.report.playback.boxes import BoxTable, row_keys
from mast_zenoh.scenes.recording import Recording

#: Messages that hold tracks.
_MESSAGES = ("tracks", "picture")
#: m, greatest standard deviation that is kept: more is not drawn.
_MOST_M = 300.0


@dataclass(frozen=True, eq=False)
class Motion:
    """What is known of m boxes besides their geometry.

    known:    (m,) bool;  the other columns are 0 where it is False
    velocity: (m, 2) m/s, world frame
    spread:   (m, 3) standard deviations in m of x and of y, and their correlation; 0: exact, or not known
    kind:     (m,) index into CLASSES
    """

    known: NDArray[np.bool_]
    velocity: Floats
    spread: Floats
    kind: NDArray[np.int64]


def recorded_motion(boxes: BoxTable, folder: Path, recording: Recording | None) -> Motion:
    """The motion of all boxes of a run; of tracks only if it was recorded."""
    try:
        return motion_of(boxes, _recorded(folder), recording)
    except (MastError, OSError):
        return motion_of(boxes, (), recording)


def motion_of(boxes: BoxTable, tracks: Iterable[tuple[int, Body]], recording: Recording | None) -> Motion:
    """The motion of all boxes.

    tracks: frame and columns of the messages that hold the tracks, on every leg of their wires
    """
    rows = len(boxes.frame)
    motion = Motion(np.zeros(rows, bool), np.zeros((rows, 2)), np.zeros((rows, 3)), np.zeros(rows, np.int64))
    if recording is not None:
        frames = np.repeat(np.arange(len(recording)), np.diff(recording.truth_start))
        states = recording.truth
        _fill(motion, boxes.truth, _key(boxes, positions=False), row_keys(frames, states.id), states.velocity[:, :2])
        _fill_kinds(motion, boxes.truth, _key(boxes, positions=False), row_keys(frames, states.id), states.class_id)
    keys, velocity, spread, kind = _columns(tracks)
    own = _key(boxes, positions=True)
    _fill(motion, ~boxes.truth, own, keys, velocity, spread)
    _fill_kinds(motion, ~boxes.truth, own, keys, kind)
    return motion


def _key(boxes: BoxTable, *, positions: bool) -> NDArray[np.uint64]:
    parts = (boxes.geometry[:, :2],) if positions else ()
    return row_keys(boxes.frame, boxes.id, *parts)


def _rows(own: NDArray[np.uint64], keys: NDArray[np.uint64]) -> tuple[NDArray[np.bool_], NDArray[np.int64]]:
    """Which of the `own` keys are among `keys`, and where."""
    if not len(keys):
        return np.zeros(len(own), bool), np.zeros(len(own), np.int64)
    order = np.argsort(keys, kind="stable")
    place = order[np.minimum(np.searchsorted(keys, own, sorter=order), len(keys) - 1)]
    return keys[place] == own, place


def _fill(
    motion: Motion,
    wanted: NDArray[np.bool_],
    own: NDArray[np.uint64],
    keys: NDArray[np.uint64],
    velocity: Floats,
    spread: Floats | None = None,
) -> None:
    found, place = _rows(own, keys)
    found &= wanted
    motion.known[found] = True
    motion.velocity[found] = velocity[place[found]]
    if spread is not None:
        motion.spread[found] = spread[place[found]]


def _fill_kinds(
    motion: Motion,
    wanted: NDArray[np.bool_],
    own: NDArray[np.uint64],
    keys: NDArray[np.uint64],
    kind: NDArray[np.uint8],
) -> None:
    found, place = _rows(own, keys)
    motion.kind[found & wanted] = kind[place[found & wanted]]


def _recorded(folder: Path) -> Iterator[tuple[int, Body]]:
    """Frame and columns of all recorded tracks."""
    for message in read(folder):
        if not message.malformed and message.message in _MESSAGES:
            yield message.frame, codec.decode_lazily(message.payload, message.type).body


def _columns(
    tracks: Iterable[tuple[int, Body]],
) -> tuple[NDArray[np.uint64], Floats, Floats, NDArray[np.uint8]]:
    """Keys, velocities, spreads and classes of all tracks."""
    keys, velocity, spread, kind = [], [], [], []
    for frame, body in tracks:
        position, covariance = body["position"], body["covariance"]
        keys.append(row_keys(np.full(len(position), frame), body["id"], position[:, :2]))
        velocity.append(body["velocity"][:, :2])
        x, y, both = covariance[:, 0, 0], covariance[:, 1, 1], covariance[:, 0, 1]
        deviations = np.sqrt(np.maximum(np.stack([x, y], axis=1), 0.0))
        product = np.maximum(deviations.prod(axis=1), 1e-12)
        correlation = np.clip(both / product, -1.0, 1.0)
        spread.append(np.column_stack([np.minimum(deviations, _MOST_M), correlation]))
        kind.append(body["class_id"])
    if not keys:
        return np.zeros(0, np.uint64), np.zeros((0, 2)), np.zeros((0, 3)), np.zeros(0, np.uint8)
    return tuple(map(np.concatenate, (keys, velocity, spread, kind)))  # type: ignore[return-value]
