"""Groups inserted objects into episodes: the same object over several frames."""

from __future__ import annotations

from itertools import pairwise
from math import hypot

import numpy as np

from mast_zenoh.arrays.states import Floats, Ints
from mast_zenoh.effects.table import Effects

#: s, longest gap between insertions of the same object.
MAX_GAP_S = 1.0
#: m and m/s; gate for matching objects without ids by predicted position, and its growth per second: before the
#: velocity is known, and after.
NEAR_M, UNKNOWN_MPS, KNOWN_MPS = 1.5, 35.0, 8.0
#: Lower limits of the filter gains for objects without ids: position, velocity.
_MIN_GAINS = 0.3, 0.05
#: Number of frames on either side over which velocities are measured.
SPAN = 4


def insertions(effects: Effects, period_s: float) -> tuple[Ints, Ints, Floats]:
    """Rows, episodes and velocities of the inserted objects of a run.

    Sorted by passage, episode and frame.

    rows:     (n,) rows of `effects`
    episode:  (n,) int64, from 0: the same number for the same object over time
    velocity: (n, 3) m/s, as sent, or, without a velocity, measured over neighbouring frames of the episode

    Within a passage, rows with the same id belong to the same episode if no gap is longer than MAX_GAP_S. Rows without
    ids continue the episode whose object, predicted at constant velocity, is nearest.
    """
    rows = effects.rows("inserted")
    rows = rows[np.isfinite(effects.after[rows]).all(axis=1)]
    gap = max(1, round(MAX_GAP_S / period_s))
    episode = np.full(len(rows), -1, np.int64)
    first = 0
    for passage in np.unique(effects.passage[rows]).tolist():
        in_passage = (effects.passage[rows] == passage).nonzero()[0]
        frame, id_ = effects.frame[rows[in_passage]], effects.id[rows[in_passage]]
        if (id_ >= 0).all():
            label = _by_id(frame, id_, gap)
        else:
            label = _by_motion(frame, effects.after[rows[in_passage]], gap, period_s)
        episode[in_passage] = label + first
        first += int(label.max(initial=-1)) + 1
    order = np.lexsort((effects.frame[rows], episode))
    rows, episode = rows[order], episode[order]
    return rows, episode, _velocity(effects, rows, episode, period_s)


def _by_id(frame: Ints, id_: Ints, gap: int) -> Ints:
    """(n,) labels: rows with the same id and without a longer gap."""
    order = np.lexsort((frame, id_))
    starts = np.ones(len(frame), bool)
    starts[1:] = (np.diff(id_[order]) != 0) | (np.diff(frame[order]) > gap)
    label = np.empty(len(frame), np.int64)
    label[order] = np.cumsum(starts) - 1
    return label


class _TrackedObject:
    """A tracked inserted object: an alpha-beta filter with growing memory.

    Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001, section 6.5.
    """

    __slots__ = ("frame", "label", "seen", "vx", "vy", "x", "y")

    def __init__(self, label: int, frame: int, x: float, y: float) -> None:
        self.label, self.frame, self.seen = label, frame, 1
        self.x, self.y, self.vx, self.vy = x, y, 0.0, 0.0

    def distance_to(self, frame: int, x: float, y: float, period_s: float) -> float | None:
        """Distance, m, from the predicted position in a frame; None: outside the gate."""
        elapsed = (frame - self.frame) * period_s
        distance = hypot(x - self.x - self.vx * elapsed, y - self.y - self.vy * elapsed)
        gate_growth = UNKNOWN_MPS if self.seen == 1 else KNOWN_MPS + UNKNOWN_MPS / self.seen
        return distance if distance <= NEAR_M + gate_growth * elapsed else None

    def update(self, frame: int, x: float, y: float, period_s: float) -> None:
        """Update the object by a position."""
        elapsed, k = (frame - self.frame) * period_s, self.seen
        alpha = max(2.0 * (2 * k + 1) / ((k + 1) * (k + 2)), _MIN_GAINS[0])
        beta = max(6.0 / ((k + 1) * (k + 2)), _MIN_GAINS[1])
        self.x, self.y = self.x + self.vx * elapsed, self.y + self.vy * elapsed
        off_x, off_y = x - self.x, y - self.y
        self.x, self.y = self.x + alpha * off_x, self.y + alpha * off_y
        self.vx, self.vy = self.vx + beta * off_x / elapsed, self.vy + beta * off_y / elapsed
        self.frame, self.seen = frame, k + 1


def _by_motion(frame: Ints, position: Floats, gap: int, period_s: float) -> Ints:
    """Labels (n,) of rows in frame order, by nearest predicted object.

    The nearest pairs are matched first.
    """
    label = np.full(len(frame), -1, np.int64)
    objects: list[_TrackedObject] = []
    labels = 0
    bounds = np.flatnonzero(np.diff(frame, prepend=-1, append=-1))
    for first, end in pairwise(bounds.tolist()):
        this_frame = int(frame[first])
        positions = position[first:end, :2].tolist()
        objects = [obj for obj in objects if this_frame - obj.frame <= gap]
        pairs = [
            (distance, i, j)
            for i, obj in enumerate(objects)
            for j, (x, y) in enumerate(positions)
            if (distance := obj.distance_to(this_frame, x, y, period_s)) is not None
        ]
        matched: set[int] = set()
        free = dict(enumerate(positions))
        for _, i, j in sorted(pairs):
            if i not in matched and j in free:
                matched.add(i)
                x, y = free.pop(j)
                objects[i].update(this_frame, x, y, period_s)
                label[first + j] = objects[i].label
        for j, (x, y) in free.items():
            objects.append(_TrackedObject(labels, this_frame, x, y))
            label[first + j] = labels
            labels += 1
    return label


def _velocity(effects: Effects, rows: Ints, episode: Ints, period_s: float) -> Floats:
    """Velocities (n, 3) m/s of rows sorted by episode and frame."""
    velocity = effects.velocity[rows].copy()
    unknown = np.isnan(velocity[:, 0])
    if unknown.any():
        n = len(rows)
        bounds = np.flatnonzero(np.diff(episode, prepend=-1, append=-1))
        begin = np.repeat(bounds[:-1], np.diff(bounds))
        end = np.repeat(bounds[1:], np.diff(bounds)) - 1
        earlier = np.maximum(np.arange(n) - SPAN, begin)
        later = np.minimum(np.arange(n) + SPAN, end)
        seconds = (effects.frame[rows[later]] - effects.frame[rows[earlier]]) * period_s
        displacement = effects.after[rows[later]] - effects.after[rows[earlier]]
        measured = np.divide(
            displacement, seconds[:, None], out=np.zeros_like(displacement), where=seconds[:, None] > 0.0
        )
        velocity[unknown] = measured[unknown]
    return velocity
