"""Noise and miss rates of the victim's rows, as estimated by an adversary."""

from __future__ import annotations

from collections import deque
from math import sqrt

import numpy as np

from mast_zenoh.arrays.geometry import wrap_angle
from mast_zenoh.arrays.states import Floats, ObjectStates

#: m, width and number of the bins of range; the last one is open.
BIN_M, BINS = 20.0, 5
#: m, maximum motion of an object in two frames; and maximum error of its interpolated position.
STEP_M, BETWEEN_M = 5.0, 2.0
#: Number of objects seen in three consecutive frames after which estimation stops.
SUFFICIENT = 400
#: Weight of the prior, in objects: fraction of detections and of tracks present in a frame; σ of position, size (m) and
#: yaw (rad).
PRIOR_WEIGHT = 10.0
PRIOR_DETECTED, PRIOR_TRACKED = 0.8, 1.0
PRIOR_STD = (0.3, 0.1, 0.05)
#: rad; a larger difference of two yaws is a reversed heading, not noise.
MAX_YAW_NOISE_RAD = 0.5
#: Upper limit on the correlation of the noise of two frames.
MAX_CORRELATION = 0.98


class VictimStatistics:
    """Noise and miss rates of one victim, from triples of consecutive messages.

    An object present in the first and the last message was present in the middle one: the fraction of missing rows
    there is the miss rate at that range. The noise is the difference between the middle row and the mean of the others;
    for independent errors of variance σ², it has the variance 1.5 σ².
    """

    def __init__(self) -> None:
        self._recent: deque[tuple[int, ObjectStates]] = deque(maxlen=3)
        self._seen, self._present = np.zeros(BINS), np.zeros(BINS)
        self._prior_fraction = PRIOR_DETECTED
        self._squares = PRIOR_WEIGHT * 1.5 * np.array(PRIOR_STD) ** 2
        self._count = PRIOR_WEIGHT
        self._variance_sum, self._variance_count = 0.0, 0

    @property
    def complete(self) -> bool:
        """Whether there is enough data."""
        return self._count > SUFFICIENT

    def observe(self, objects: ObjectStates, time_ns: int, victim: Floats) -> None:
        """Add the objects of one message, in canonical order; victim: (3,) m."""
        self._recent.append((time_ns, objects))
        if len(objects):
            self._prior_fraction = PRIOR_TRACKED if objects.id[0] >= 0 else PRIOR_DETECTED
        if len(self._recent) < 3:
            return
        (t0, before), (t1, middle_objects), (t2, after) = self._recent
        if t1 - t0 != t2 - t1 or min(len(before), len(middle_objects), len(after)) == 0:
            return
        positions = [states.position[:, 0] + 1j * states.position[:, 1] for states in (before, middle_objects, after)]
        distance = np.abs(positions[0][:, None] - positions[2])
        a, c = np.arange(len(before)), distance.argmin(axis=1)
        matched = ((distance.argmin(axis=0)[c] == a) & (distance[a, c] < STEP_M)).nonzero()[0]
        if len(matched) == 0:
            return
        c = c[matched]
        midpoint = 0.5 * (positions[0][matched] + positions[2][c])
        distance = np.abs(midpoint[:, None] - positions[1])
        b = distance.argmin(axis=1)
        seen = distance[np.arange(len(matched)), b] < BETWEEN_M
        bins = np.minimum(np.abs(midpoint - complex(victim[0], victim[1])) / BIN_M, BINS - 1).astype(np.int64)
        self._present += np.bincount(bins, minlength=BINS)
        self._seen += np.bincount(bins[seen], minlength=BINS)
        a, b, c = matched[seen], b[seen], c[seen]
        error = midpoint[seen] - positions[1][b]
        size = middle_objects.size.take(b, 0) - 0.5 * (before.size.take(a, 0) + after.size.take(c, 0))
        yaw = wrap_angle(after.yaw.take(c) - before.yaw.take(a))
        yaw = yaw[np.abs(yaw) < MAX_YAW_NOISE_RAD]
        # Two yaws differ by 2 σ², the other differences by 1.5 σ².
        self._squares += [
            0.5 * float((error.real**2 + error.imag**2).sum()),
            float((size * size).sum()) / 3.0,
            0.75 * float((yaw * yaw).sum()),
        ]
        self._count += len(b)
        variance = middle_objects.covariance[:, 0, 0].take(b) + middle_objects.covariance[:, 1, 1].take(b)
        self._variance_sum += 0.5 * float(variance.sum())
        self._variance_count += len(b)

    def share_detected(self, range_m: Floats) -> Floats:
        """(n,) probability that an object in view at these ranges is in a message."""
        share = (self._seen + PRIOR_WEIGHT * self._prior_fraction) / (self._present + PRIOR_WEIGHT)
        return np.asarray(share[np.minimum(range_m / BIN_M, BINS - 1).astype(np.int64)])

    @property
    def std(self) -> tuple[float, float, float]:
        """σ of independent errors: position per axis (m), size (m), yaw (rad)."""
        position, size, yaw = np.sqrt(self._squares / (1.5 * self._count)).tolist()
        return position, size, yaw

    @property
    def correlation(self) -> float:
        """Correlation of the errors of consecutive frames.

        0 for detections, near 1 for filtered tracks.

        Derived from the variance that the rows report and that of their differences, 1.5 - 2 ρ + 0.5 ρ² times it.
        """
        reported = self._variance_sum / self._variance_count if self._variance_count else 0.0
        if reported <= 0.0:
            return 0.0
        ratio = float(self._squares[0]) / self._count / reported
        return min(max(2.0 - sqrt(1.0 + 2.0 * ratio), 0.0), MAX_CORRELATION)
