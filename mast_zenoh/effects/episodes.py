"""Which inserted objects of different frames are one object, without ids and without the adversary's help."""

from __future__ import annotations

from itertools import pairwise
from math import hypot

import numpy as np

from mast_zenoh.arrays.states import Floats, Ints
from mast_zenoh.effects.table import Effects

#: s, for which an inserted object may be left out of the messages and still be the same one.
LONGEST_GAP_S = 1.0
#: m and m/s; without an id an inserted object is found again this near to where it should be, and so much farther for
#: every second since: by what a vehicle can drive before its velocity is known, by what it can turn away after that.
NEAR_M, UNKNOWN_MPS, KNOWN_MPS = 1.5, 35.0, 8.0
#: Least gains of the filter that follows an object without an id: position, velocity.
_LEAST_GAINS = 0.3, 0.05
#: Frames over which the velocity of an object is measured, on either side.
SPAN = 4


def insertions(effects: Effects, period_s: float) -> tuple[Ints, Ints, Floats]:
    """(rows, episode, velocity) of the inserted objects of a run, by passage, episode and frame.

    rows:     (n,) of `effects`
    episode:  (n,) int64, numbered from 0: the same for the same object over time
    velocity: (n, 3) m/s, as sent, or where messages have none as measured over the neighbouring frames of the episode

    Within a passage rows of one id belong together as long as no gap is longer than LONGEST_GAP_S. Rows without an id
    continue the episode whose object, moving at constant velocity, is nearest.
    """
    rows = effects.rows("inserted")
    rows = rows[np.isfinite(effects.after[rows]).all(axis=1)]
    gap = max(1, round(LONGEST_GAP_S / period_s))
    episode = np.full(len(rows), -1, np.int64)
    first = 0
    for passage in np.unique(effects.passage[rows]).tolist():
        mine = (effects.passage[rows] == passage).nonzero()[0]
        frame, id_ = effects.frame[rows[mine]], effects.id[rows[mine]]
        if (id_ >= 0).all():
            label = _by_id(frame, id_, gap)
        else:
            label = _by_motion(frame, effects.after[rows[mine]], gap, period_s)
        episode[mine] = label + first
        first += int(label.max(initial=-1)) + 1
    order = np.lexsort((effects.frame[rows], episode))
    rows, episode = rows[order], episode[order]
    return rows, episode, _velocity(effects, rows, episode, period_s)


def _by_id(frame: Ints, id_: Ints, gap: int) -> Ints:
    """(n,) labels: rows of one id with no longer gap between them."""
    order = np.lexsort((frame, id_))
    begins = np.ones(len(frame), bool)
    begins[1:] = (np.diff(id_[order]) != 0) | (np.diff(frame[order]) > gap)
    label = np.empty(len(frame), np.int64)
    label[order] = np.cumsum(begins) - 1
    return label


class _Object:
    """An inserted object while it is followed: an alpha-beta filter with growing memory (Bar-Shalom, Li and
    Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001, section 6.5)."""

    __slots__ = ("frame", "label", "seen", "vx", "vy", "x", "y")

    def __init__(self, label: int, frame: int, x: float, y: float) -> None:
        self.label, self.frame, self.seen = label, frame, 1
        self.x, self.y, self.vx, self.vy = x, y, 0.0, 0.0

    def misfit(self, frame: int, x: float, y: float, period_s: float) -> float | None:
        """m from where it should be in a frame; None: it cannot be there."""
        elapsed = (frame - self.frame) * period_s
        apart = hypot(x - self.x - self.vx * elapsed, y - self.y - self.vy * elapsed)
        unsure = UNKNOWN_MPS if self.seen == 1 else KNOWN_MPS + UNKNOWN_MPS / self.seen
        return apart if apart <= NEAR_M + unsure * elapsed else None

    def take(self, frame: int, x: float, y: float, period_s: float) -> None:
        """It is there now."""
        elapsed, k = (frame - self.frame) * period_s, self.seen
        alpha = max(2.0 * (2 * k + 1) / ((k + 1) * (k + 2)), _LEAST_GAINS[0])
        beta = max(6.0 / ((k + 1) * (k + 2)), _LEAST_GAINS[1])
        self.x, self.y = self.x + self.vx * elapsed, self.y + self.vy * elapsed
        off_x, off_y = x - self.x, y - self.y
        self.x, self.y = self.x + alpha * off_x, self.y + alpha * off_y
        self.vx, self.vy = self.vx + beta * off_x / elapsed, self.vy + beta * off_y / elapsed
        self.frame, self.seen = frame, k + 1


def _by_motion(frame: Ints, position: Floats, gap: int, period_s: float) -> Ints:
    """(n,) labels of rows in the order of their frames: each continues the object that should be nearest to it, the
    nearest pair of a frame first."""
    label = np.full(len(frame), -1, np.int64)
    followed: list[_Object] = []
    labels = 0
    bounds = np.flatnonzero(np.diff(frame, prepend=-1, append=-1))
    for first, end in pairwise(bounds.tolist()):
        now = int(frame[first])
        places = position[first:end, :2].tolist()
        followed = [each for each in followed if now - each.frame <= gap]
        pairs = [
            (misfit, i, j)
            for i, each in enumerate(followed)
            for j, (x, y) in enumerate(places)
            if (misfit := each.misfit(now, x, y, period_s)) is not None
        ]
        taken: set[int] = set()
        free = dict(enumerate(places))
        for _, i, j in sorted(pairs):
            if i not in taken and j in free:
                taken.add(i)
                x, y = free.pop(j)
                followed[i].take(now, x, y, period_s)
                label[first + j] = followed[i].label
        for j, (x, y) in free.items():
            followed.append(_Object(labels, now, x, y))
            label[first + j] = labels
            labels += 1
    return label


def _velocity(effects: Effects, rows: Ints, episode: Ints, period_s: float) -> Floats:
    """(n, 3) m/s of rows that are sorted by episode and frame."""
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
        way = effects.after[rows[later]] - effects.after[rows[earlier]]
        measured = np.divide(way, seconds[:, None], out=np.zeros_like(way), where=seconds[:, None] > 0.0)
        velocity[unknown] = measured[unknown]
    return velocity
