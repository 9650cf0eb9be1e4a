"""False objects that resemble the victim's own.

Noise, misses, covariance, score and identity are imitated.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from dataclasses import dataclass
from math import erf, sqrt
from statistics import median

import numpy as np

from mast_zenoh.arrays.geometry import wrap_angle
from mast_zenoh.arrays.states import Floats, Ints, ObjectStates
from mast_zenoh.attacks.surroundings import Coverage
from mast_zenoh.kernels import kernel
from mast_zenoh.streams import stream
from mast_zenoh.tracking.view import SensorView

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


#: Standard deviations [x y z l w h vx vy vz] and score of a false object if the victim has no rows to imitate.
DEFAULT_STD: Floats = np.array([0.5, 0.5, 0.5, 0.2, 0.2, 0.2, 1.0, 1.0, 0.5])
DEFAULT_SCORE = 0.9
#: Rows whose covariance exceeds this multiple of the median belong to new tracks and are not typical.
TYPICAL_FACTOR = 3.0
#: Largest error of a size, relative to it.
MAX_SIZE_ERROR = 0.3
#: Columns of the noise: position, size, velocity, yaw, and the score's rank.
_COLUMNS = 11
#: Number of frames whose noise is drawn at once.
_BLOCK = 32


class Imitation(ABC):
    """Base class of imitations: the appearance of false objects on one wire."""

    def bind(self, seed: int, scene: str, name: str) -> None:  # noqa: B027 (a hook: without random numbers it needs no streams)
        """Set the random streams, named by (seed, scene, name, "imitation", frame)."""

    def observe(self, real: ObjectStates, time_ns: int, victim: Floats) -> None:  # noqa: B027 (a hook)
        """Learn from the victim's objects of one message.

        real: in canonical order; victim: (3,) m, its position
        """

    @abstractmethod
    def show(
        self, frame: int, false: ObjectStates, real: ObjectStates, coverage: Coverage, view: SensorView
    ) -> ObjectStates:
        """The false objects as they appear in the victim's rows, without missed ones.

        real: the victim's objects of this frame, in canonical order; coverage, view: the victim's coverage
        """


class Exact(Imitation):
    """Shows false objects without noise or misses, as in the paper.

    They appear in every frame and at any position.

    Covariance and score are typical of the victim's objects in this frame: the covariance with the median trace (new
    tracks would inflate a mean), and the median score.
    """

    def show(
        self, frame: int, false: ObjectStates, real: ObjectStates, coverage: Coverage, view: SensorView
    ) -> ObjectStates:
        return typical(false, real)


def typical(false: ObjectStates, real: ObjectStates) -> ObjectStates:
    """False objects with typical covariance and score of real ones, see Exact.

    real: in canonical order
    """
    if len(false) == 0:
        return false
    covariance, score = np.diag(DEFAULT_STD**2), DEFAULT_SCORE
    if len(real):
        by_trace = np.argsort(np.trace(real.covariance, axis1=1, axis2=2), kind="stable")
        covariance = real.covariance[by_trace[(len(real) - 1) // 2]]
        score = median(real.score.tolist())
    return false.with_(covariance=np.repeat(covariance[None], len(false), 0), score=np.full(len(false), score))


@dataclass(kw_only=True, eq=False)
class VictimLike(Imitation):
    """Gives false objects the noise, misses and scores of the victim's own rows.

    A false object is shown only if the victim could see it: in its sensor's view, not occluded by a wall or an object,
    and outside buildings and other objects. It is missed as often as a real object at its range. Its errors have the
    standard deviations of the victim's row nearest in range and the temporal correlation of the victim's rows. Its
    score has a rank among the victim's scores that varies with the same correlation.

    misses, noise: whether to simulate them
    """

    misses: bool = True
    noise: bool = True

    def __post_init__(self) -> None:
        self._statistics = VictimStatistics()
        self._numbers: Ints = np.zeros(0, np.int64)
        self._errors = np.zeros((0, _COLUMNS))
        self._block: tuple[tuple[int, int], Floats, Floats] | None = None  # (block, objects), noise, luck
        self._seed, self._scene, self._name = 0, "", ""

    def bind(self, seed: int, scene: str, name: str) -> None:
        self._seed, self._scene, self._name = seed, scene, name

    def observe(self, real: ObjectStates, time_ns: int, victim: Floats) -> None:
        if not self._statistics.complete:
            self._statistics.observe(real, time_ns, victim)

    def show(
        self, frame: int, false: ObjectStates, real: ObjectStates, coverage: Coverage, view: SensorView
    ) -> ObjectStates:
        if len(false) == 0:
            return false
        independent, miss_draws = self._draws(
            frame, len(false)
        )  # for every object, so that visibility does not shift the draws
        errors = self._next_errors(false.id, independent)
        offset = false.position - view.position
        range_m = np.sqrt(offset[:, 0] * offset[:, 0] + offset[:, 1] * offset[:, 1])
        false = self._resemble_victim(false, errors, real, range_m, view)
        visible = coverage.plausible(false, real, view)
        if self.misses:
            visible &= miss_draws < self._statistics.share_detected(range_m)
        return false if visible.all() else false.select(visible)

    def _draws(self, frame: int, n: int) -> tuple[Floats, Floats]:
        """(n, _COLUMNS) standard normal and (n,) uniform draws of a frame."""
        block = (frame // _BLOCK, n)
        if self._block is None or self._block[0] != block:
            rng = stream(self._seed, self._scene, self._name, "imitation", *block)
            self._block = (block, rng.standard_normal((_BLOCK, n, _COLUMNS)), rng.random((_BLOCK, n)))
        return self._block[1][frame % _BLOCK], self._block[2][frame % _BLOCK]

    def _next_errors(self, numbers: Ints, independent: Floats) -> Floats:
        """Errors (k, _COLUMNS) in units of σ.

        For the same objects, correlated with the errors in the previous frame.
        """
        correlation = self._statistics.correlation
        errors = independent
        if correlation > 0.0 and len(self._numbers):
            innovation = sqrt(1.0 - correlation * correlation)
            if np.array_equal(numbers, self._numbers):
                errors = correlation * self._errors + innovation * independent
            else:
                k, before = (numbers[:, None] == self._numbers).nonzero()
                errors = independent.copy()
                errors[k] = correlation * self._errors[before] + innovation * independent[k]
        self._numbers, self._errors = numbers, errors
        return errors

    def _resemble_victim(
        self, false: ObjectStates, errors: Floats, real: ObjectStates, range_m: Floats, view: SensorView
    ) -> ObjectStates:
        position, covariance, score, has_velocity = real.position, real.covariance, real.score, real.velocity.any()
        if len(real) == 0:
            position, covariance, score = view.position[None], np.diag(DEFAULT_STD**2)[None], np.array([DEFAULT_SCORE])
        columns = imitate_rows(
            (false.position, false.velocity, false.size, false.yaw),
            errors if self.noise else np.concatenate([np.zeros((len(false), 10)), errors[:, 10:]], axis=1),
            range_m,
            (position, covariance, score, view.position),
            self._statistics.std,
            bool(has_velocity),  # detections show no velocity
            (TYPICAL_FACTOR, MAX_SIZE_ERROR),
        )
        return ObjectStates(false.id, *columns, false.class_id)


@kernel
def imitate_rows(
    false: tuple[Floats, Floats, Floats, Floats],
    errors: Floats,
    range_m: Floats,
    real: tuple[Floats, Floats, Floats, Floats],
    default_std: tuple[float, float, float],
    has_velocity: bool,
    limits: tuple[float, float],
) -> tuple[Floats, Floats, Floats, Floats, Floats, Floats]:
    """The columns of k false objects that resemble n >= 1 rows of the victim.

    The columns are position, velocity, size, yaw, covariance and score.

    false:     (k, 3) m, (k, 3) m/s, (k, 3) m, (k,) rad: position, velocity, size, yaw without errors
    errors:    (k, _COLUMNS) in units of sigma, with their final correlation
    range_m:   (k,) m, of the false objects
    real:      the victim's rows: position (n, 3) m, covariance (n, 9, 9), score (n,); and its sensor's position (3,)
    default_std: of position for rows without covariance, of size (m), and of yaw (rad)
    has_velocity: whether the rows have velocities
    limits:    TYPICAL_FACTOR, MAX_SIZE_ERROR

    The covariance comes from the typical row nearest in range; the score is drawn by rank from the typical rows.
    """
    position, velocity, size, yaw = false
    positions, covariance, score, sensor_position = real
    trace = np.einsum("nii->n", covariance)
    typical = (trace <= limits[0] * np.sort(trace)[(len(trace) - 1) // 2]).nonzero()[0]
    offset = positions[typical, :2] - sensor_position[:2]
    row_range = np.sqrt((offset * offset).sum(axis=1))
    nearest = typical[np.abs(range_m[:, None] - row_range).argmin(axis=1)]
    quantiles = np.array([0.5 + 0.5 * erf(z / sqrt(2.0)) for z in errors[:, 10].tolist()])
    rank = np.minimum(quantiles * len(typical), len(typical) - 1).astype(np.int64)

    reported_std = np.sqrt(np.maximum(np.einsum("nii->ni", covariance[nearest]), 0.0))
    noisy_position = position + errors[:, :3] * np.where(reported_std[:, :3] > 0.0, reported_std[:, :3], default_std[0])
    noisy_velocity = velocity + errors[:, 6:9] * reported_std[:, 6:9] if has_velocity else velocity.copy()
    limit = limits[1] * size
    noisy_size = size + np.minimum(np.maximum(errors[:, 3:6] * default_std[1], -limit), limit)
    noisy_yaw = wrap_angle(yaw + errors[:, 9] * default_std[2])
    return noisy_position, noisy_velocity, noisy_size, noisy_yaw, covariance[nearest], np.sort(score[typical])[rank]


class ForgedIds:
    """Track ids for false objects: one per target, never one that the victim uses.

    Ids start `gap` above the victim's highest id, so that the victim's own numbering does not reach them soon. If it
    does, the false object takes a new id at once.
    """

    def __init__(self, gap: int) -> None:
        self._gap = gap
        self._highest = -1
        self._next = 0
        self._of_target: dict[int, int] = {}

    def observe(self, seen: Ints) -> None:
        """Record the victim's ids (n,) of one message; colliding ids are dropped."""
        if len(seen):
            self._highest = max(self._highest, int(seen.max()))
            used = set(self._of_target.values()).intersection(seen.tolist())
            if used:
                self._of_target = {number: id for number, id in self._of_target.items() if id not in used}

    def of(self, targets: Ints) -> Ints:
        """(k,) int64 ids of the false objects with these target numbers."""
        for number in sorted(set(targets.tolist()) - self._of_target.keys()):
            self._next = max(self._next, self._highest + self._gap)
            self._of_target[number] = self._next
            self._next += 1
        return np.array([self._of_target[number] for number in targets.tolist()], np.int64)
