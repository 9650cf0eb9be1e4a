"""Which inserted objects of different frames are one object, without ids and without the adversary's help."""

from __future__ import annotations

import numpy as np

from mast_zenoh.effects.table import Effects
from mast_zenoh.matching import greedy
from mast_zenoh.metrics.boxes import pairs_in_groups
from mast_zenoh.states import Floats, Ints

#: s, for which an inserted object may be left out of the messages and still be the same one.
LONGEST_GAP_S = 1.0
#: m and m/s; without an id an inserted object is found again this near to where it should be, and so much farther for
#: every second since: by what a vehicle can drive before its velocity is known, by what it can turn away after that.
NEAR_M, UNKNOWN_MPS, KNOWN_MPS = 1.5, 35.0, 8.0
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


def _by_motion(frame: Ints, position: Floats, gap: int, period_s: float) -> Ints:
    """(n,) labels: each row continues the object that should be nearest to it, the nearest pair first.

    Rows of consecutive frames are joined first; then ends of episodes with beginnings that are 2, 3, … frames later.
    """
    n = len(frame)
    following, before = np.full(n, -1, np.int64), np.full(n, -1, np.int64)
    velocity, known = np.zeros((n, 2)), np.zeros(n, bool)
    steps = [1, 1, *range(2, gap + 1)]  # twice: once all velocities are known, what is nearest is known better
    for turn, step in enumerate(steps):
        if turn == 1:
            known = before >= 0
            velocity[known] = (position[known] - position[before[known]])[:, :2] / period_s
            following[:], before[:] = -1, -1
        elif turn > 1:
            linked = before >= 0
            way = (position[linked] - position[before[linked]])[:, :2]
            velocity[linked] = way / ((frame[linked] - frame[before[linked]]) * period_s)[:, None]
            known = linked
        ends, begins = (following < 0).nonzero()[0], (before < 0).nonzero()[0]
        expected = position[ends, :2] + velocity[ends] * (step * period_s)
        i, j = _within(frame[ends] + step, expected, frame[begins], position[begins, :2], step * period_s)
        apart = np.hypot(*(expected[i] - position[begins[j], :2]).T)
        reach = NEAR_M + np.where(known[ends[i]], KNOWN_MPS, UNKNOWN_MPS) * (step * period_s)
        near = (apart <= reach).nonzero()[0]
        i, j, apart = i[near], j[near], apart[near]
        chosen = greedy(i, j, apart)
        following[ends[i[chosen]]], before[begins[j[chosen]]] = begins[j[chosen]], ends[i[chosen]]
    label = np.full(n, -1, np.int64)
    heads = (before < 0).nonzero()[0]
    label[heads] = np.arange(len(heads))
    row = heads
    while len(row):
        follower = following[row]
        row = row[follower >= 0]
        label[following[row]] = label[row]
        row = following[row]
    return label


def _within(a_frame: Ints, a: Floats, b_frame: Ints, b: Floats, seconds: float) -> tuple[Ints, Ints]:
    """Pairs of places of one frame that a vehicle may have covered in so many seconds."""
    if not len(a) or not len(b):
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    flat = [np.column_stack([place, np.zeros(len(place))]) for place in (a, b)]
    return pairs_in_groups(a_frame, flat[0], b_frame, flat[1], NEAR_M + UNKNOWN_MPS * seconds)


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
