"""What an adversary learns about its victim's rows: how noisy they are, and how often an object is missed."""

from __future__ import annotations

from collections import deque
from math import sqrt

import numpy as np

from mast_zenoh.arrays.geometry import wrap_angle
from mast_zenoh.arrays.states import Floats, ObjectStates

#: m, width and number of the bins of range; the last one is open.
BIN_M, BINS = 20.0, 5
#: m, an object moves less than this in two frames; its place between two frames is known to about this.
STEP_M, BETWEEN_M = 5.0, 2.0
#: Objects met in three frames in a row after which nothing more is learned.
ENOUGH = 400
#: Objects' worth of belief in the usual values: share of detections and of tracks that are there in a frame; σ of
#: position, size (m) and yaw (rad).
PRIOR_WEIGHT = 10.0
DETECTED, TRACKED = 0.8, 1.0
USUAL_STD = (0.3, 0.1, 0.05)
#: rad; a larger difference of two yaws is a heading turned round, not noise.
TURNED_RAD = 0.5
#: Greatest correlation of the noise of two frames.
MOST_CORRELATION = 0.98


class VictimStatistics:
    """Noise and misses of one victim's rows, from objects seen in three messages in a row: before, between, after.

    An object that is there before and after was there in between: the share of those rows that are missing is the miss
    rate at their range. How far the row in between is off the mean of the two others is the noise: for independent
    errors of variance σ², that difference has the variance 1.5 σ².
    """

    def __init__(self) -> None:
        self._recent: deque[tuple[int, ObjectStates]] = deque(maxlen=3)
        self._seen, self._there = np.zeros(BINS), np.zeros(BINS)
        self._usual_share = DETECTED
        self._squares = PRIOR_WEIGHT * 1.5 * np.array(USUAL_STD) ** 2
        self._count = PRIOR_WEIGHT
        self._variance_sum, self._variance_count = 0.0, 0

    @property
    def complete(self) -> bool:
        """Whether it has learned enough."""
        return self._count > ENOUGH

    def observe(self, objects: ObjectStates, time_ns: int, victim: Floats) -> None:
        """Take the objects of one message, in canonical order; victim (3,) m is where the victim is."""
        self._recent.append((time_ns, objects))
        if len(objects):
            self._usual_share = TRACKED if objects.id[0] >= 0 else DETECTED
        if len(self._recent) < 3:
            return
        (t0, before), (t1, between), (t2, after) = self._recent
        if t1 - t0 != t2 - t1 or min(len(before), len(between), len(after)) == 0:
            return
        places = [each.position[:, 0] + 1j * each.position[:, 1] for each in (before, between, after)]
        apart = np.abs(places[0][:, None] - places[2])
        a, c = np.arange(len(before)), apart.argmin(axis=1)
        same = ((apart.argmin(axis=0)[c] == a) & (apart[a, c] < STEP_M)).nonzero()[0]
        if len(same) == 0:
            return
        c = c[same]
        middle = 0.5 * (places[0][same] + places[2][c])
        apart = np.abs(middle[:, None] - places[1])
        b = apart.argmin(axis=1)
        seen = apart[np.arange(len(same)), b] < BETWEEN_M
        bins = np.minimum(np.abs(middle - complex(victim[0], victim[1])) / BIN_M, BINS - 1).astype(np.int64)
        self._there += np.bincount(bins, minlength=BINS)
        self._seen += np.bincount(bins[seen], minlength=BINS)
        a, b, c = same[seen], b[seen], c[seen]
        off = middle[seen] - places[1][b]
        size = between.size.take(b, 0) - 0.5 * (before.size.take(a, 0) + after.size.take(c, 0))
        yaw = wrap_angle(after.yaw.take(c) - before.yaw.take(a))
        yaw = yaw[np.abs(yaw) < TURNED_RAD]
        # Two yaws differ by 2 σ², the other differences by 1.5 σ².
        self._squares += [
            0.5 * float((off.real**2 + off.imag**2).sum()),
            float((size * size).sum()) / 3.0,
            0.75 * float((yaw * yaw).sum()),
        ]
        self._count += len(b)
        variance = between.covariance[:, 0, 0].take(b) + between.covariance[:, 1, 1].take(b)
        self._variance_sum += 0.5 * float(variance.sum())
        self._variance_count += len(b)

    def share_detected(self, range_m: Floats) -> Floats:
        """(n,) probability that an object in view at these ranges is in a message."""
        share = (self._seen + PRIOR_WEIGHT * self._usual_share) / (self._there + PRIOR_WEIGHT)
        return np.asarray(share[np.minimum(range_m / BIN_M, BINS - 1).astype(np.int64)])

    @property
    def std(self) -> tuple[float, float, float]:
        """σ of independent errors from frame to frame: position per axis (m), size (m), yaw (rad)."""
        position, size, yaw = np.sqrt(self._squares / (1.5 * self._count)).tolist()
        return position, size, yaw

    @property
    def correlation(self) -> float:
        """Of the errors of two frames in a row: 0 for detections, near 1 for tracks, which a filter has smoothed.

        Follows from the variance that the rows state and that of their differences, 1.5 - 2 ρ + 0.5 ρ² times it.
        """
        stated = self._variance_sum / self._variance_count if self._variance_count else 0.0
        if stated <= 0.0:
            return 0.0
        ratio = float(self._squares[0]) / self._count / stated
        return min(max(2.0 - sqrt(1.0 + 2.0 * ratio), 0.0), MOST_CORRELATION)
