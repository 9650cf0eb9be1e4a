"""The box tracker: batched Kalman filter, gating, one-to-one assignment, and a probability that each object exists."""

from __future__ import annotations

from typing import ClassVar, NamedTuple

import numpy as np

from mast_zenoh.arrays.states import CLASSES, Detections, Floats, Ints, ObjectStates
from mast_zenoh.tracking import classes, existence, kalman, tracks
from mast_zenoh.tracking.assignment import Assignment, BipartiteAssignment
from mast_zenoh.tracking.base import Tracker
from mast_zenoh.tracking.classes import first_covariance
from mast_zenoh.tracking.duplicates import ONE_OBJECT, duplicates, overlap
from mast_zenoh.tracking.gating import Pairs, gains, near_pairs
from mast_zenoh.tracking.heading import FORWARD, TURN_LIMIT, correct_heading, settle_sense
from mast_zenoh.tracking.lateral_constraint import roll
from mast_zenoh.tracking.measured import Measured
from mast_zenoh.tracking.tracks import CONFIRMED, COVARIANCE, MEAN, ODDS, ROW, XX, YAW, YAW_VARIANCE, YY
from mast_zenoh.tracking.view import SensorView

#: m^2/s^3, spectral density of vertical acceleration: roads are nearly flat.
VERTICAL_ACCELERATION = 0.2
#: m^2/s, what a size may drift: nothing, but for what of an object is in view.
SIZE_DRIFT = 4e-4
#: rad/sqrt(s), what a heading may drift.
YAW_DRIFT = 0.3
#: m/s above which nothing on a road goes.
MAX_SPEED = 60.0
#: Share of its first odds below which a track that was never confirmed is given up: one miss in full view is not.
DOUBT = 0.05
#: m, standard deviation of the horizontal position beyond which a track is lost.
LOST_M = 3.0
#: Frames' worth of belief in the prior detection probability.
PRIOR_FRAMES = 2.0
#: How far a first report of a state is believed, against a source's transient errors.
FIRST_REPORT = 0.9
#: Parameters that are probabilities, and others that must be positive.
_PROBABILITIES = (
    "detection_probability", "report_probability", "confirm_probability", "min_probability", "jump_probability",
)  # fmt: skip
_POSITIVE = (
    "position_std_m", "vertical_std_m", "size_std_m", "yaw_std_rad", "clutter_per_m2", "birth_odds", "lifetime_s",
    "memory_s", "max_std_m", "jump_std_m", "acceleration_scale",
)  # fmt: skip

_BIPARTITE = BipartiteAssignment()


class KalmanBoxTracker3D(Tracker):
    """Tracks boxes in the plane of the road; see docs/tracking.md for the model and the sources of the numbers.

    position_std_m, vertical_std_m: of a detection's horizontal position per axis, and of its height, where it brings
        no covariance of its own
    size_std_m, yaw_std_rad: of a detection's sizes, and of its heading up to half a turn
    detection_probability: of an object in full view; each track's own record may only lower it
    report_probability: that a source of states (`step_states`) goes on reporting what is there
    clutter_per_m2: false detections per square metre and frame
    birth_odds: odds that a detection which fits no track is a new object
    lifetime_s: s, how long an object stays in view on average; memory_s: s, how long a track's record counts
    confirm_probability: of existence, to become a track; min_probability: to be reported
    max_coast_s: s without a measurement after which a track is given up, or sooner, when its position has become
        uncertain by LOST_M; until then it may come back under its id
    max_std_m: m, of the horizontal position, above which a track is not reported
    jump_probability, jump_std_m: of a sudden displacement in a frame, and its size per axis for a moving car, see
        `gating`
    acceleration_scale: factor on the accelerations in `classes`
    assignment: which detection goes to which track

    Raises ValueError for a probability outside (0, 1), and for anything else that is not positive.
    """

    filter: ClassVar[kalman.BoxFilter] = kalman.BatchedFilter()

    def __init__(
        self,
        *,
        position_std_m: float = 0.4,
        vertical_std_m: float = 0.2,
        size_std_m: float = 0.3,
        yaw_std_rad: float = 0.1,
        detection_probability: float = 0.9,
        report_probability: float = 0.98,
        clutter_per_m2: float = 5e-5,
        birth_odds: float = 0.03,
        lifetime_s: float = 30.0,
        memory_s: float = 2.0,
        confirm_probability: float = 0.95,
        min_probability: float = 0.5,
        max_coast_s: float = 3.0,
        max_std_m: float = 1.2,
        jump_probability: float = 0.01,
        jump_std_m: float = 1.5,
        acceleration_scale: float = 1.0,
        assignment: Assignment = _BIPARTITE,
    ) -> None:
        given = locals()
        for name in _PROBABILITIES:
            if not 0.0 < given[name] < 1.0:
                raise ValueError(f"{name}: found {given[name]}, expected more than 0 and less than 1")
        for name in _POSITIVE:
            if not given[name] > 0.0:
                raise ValueError(f"{name}: found {given[name]}, expected more than 0")
        self._variance = np.square([position_std_m] * 2 + [vertical_std_m] + [size_std_m] * 3)
        self._yaw_noise = yaw_std_rad**2
        self._detection_probability = detection_probability
        self._report_probability = report_probability
        self._log_clutter = float(np.log(clutter_per_m2))
        self._birth = birth_odds
        self._doubtful = birth_odds * DOUBT
        self._lifetime_s = lifetime_s
        self._memory_s = memory_s
        self._confirm = confirm_probability / (1.0 - confirm_probability)
        self._report = min_probability / (1.0 - min_probability)
        self._max_coast_s = max_coast_s
        self._max_variance = max_std_m**2
        self._jump_probability = jump_probability
        self._jump = np.square(jump_std_m * classes.JUMP)
        self._acceleration = acceleration_scale * classes.ACCELERATION
        self._assignment = assignment
        self.reset()

    def reset(self) -> None:
        self._tracks = tracks.empty(0)
        self._next_id = 0
        self._time_ns: int | None = None
        self._matched = np.zeros(0, np.int64)
        self._process_noise = (0.0, np.zeros((len(CLASSES), 9, 9)))

    @property
    def matched(self) -> Ints:
        return self._matched

    def step(self, time_ns: int, detections: Detections, view: SensorView | None = None) -> ObjectStates:
        seen = Measured.detections(detections, self._variance)
        self._advance(time_ns)
        t = self._tracks
        detected = existence.detection_probability(t, self._detection_probability, PRIOR_FRAMES)
        match = self._associate(seen, detected)
        if len(match.track):
            hit = self._hit(match, seen, detected)
            measured, R = seen.state.take(match.measurement, 0), seen.noise.take(match.measurement, 0)
            surprise = measured[:, :2] - hit[:, :2]
            self.filter.correct(hit, measured, R)
            roll(self.filter, hit, surprise)
            t[match.track] = hit
        existence.miss(t, detected, self._missed(view), self._birth)
        new = self._unexplained(match, seen)
        born = self._born(new, seen)
        if len(new):
            born[:, kalman.BOX] = seen.state[new]
            P = first_covariance(seen.noise[new], seen.yaw[new], seen.class_id[new])
            born[:, COVARIANCE] = P.reshape(len(new), 81)
            born[:, ODDS] = self._birth
        return self._finish(match, born)

    def step_states(self, time_ns: int, measured: ObjectStates) -> ObjectStates:
        seen = Measured.states(measured)
        self._advance(time_ns)
        t = self._tracks
        detected = np.full(len(t), self._report_probability)
        match = self._associate(seen, detected)
        if len(match.track):
            hit = self._hit(match, seen, detected)
            R = seen.noise.take(match.measurement, 0)
            # States that come out of filters repeat what they said before. Covariance intersection of track and
            # measurement counts nothing twice; weights by the trace of the position (Niehsen, FUSION 2002).
            own, theirs = hit[:, XX] + hit[:, YY], R[:, 0, 0] + R[:, 1, 1]
            weight = (theirs / (own + theirs))[:, None]
            hit[:, COVARIANCE] /= weight
            R /= 1.0 - weight[:, None]
            self.filter.correct(hit, seen.state.take(match.measurement, 0), R)
            settle_sense(hit, FORWARD, TURN_LIMIT)
            t[match.track] = hit
        existence.miss(t, detected, self._missed(None), self._birth)
        new = self._unexplained(match, seen)
        born = self._born(new, seen)
        if len(new):
            born[:, MEAN], born[:, COVARIANCE] = seen.state[new], seen.noise[new].reshape(len(new), 81)
            score = np.clip(FIRST_REPORT * measured.score[seen.row[new]], 0.01, 0.99)
            born[:, ODDS] = score / (1.0 - score)
        return self._finish(match, born)

    def _advance(self, time_ns: int) -> None:
        """Predict the tracks to `time_ns`."""
        before = time_ns if self._time_ns is None else self._time_ns
        if time_ns < before:
            raise ValueError(f"time_ns of a step: found {time_ns}, expected at least {before}, that of the one before")
        self._time_ns = time_ns
        t, dt = self._tracks, (time_ns - before) * 1e-9
        t[:, ROW] = -1.0
        if len(t) and dt > 0.0:
            if dt != self._process_noise[0]:
                noise = kalman.process_noise(dt, self._acceleration, VERTICAL_ACCELERATION, SIZE_DRIFT)
                self._process_noise = (dt, noise)
            self.filter.predict(t, dt, self._process_noise[1])
            t[:, YAW_VARIANCE] += YAW_DRIFT**2 * dt
            t[:, tracks.AGE] += dt
            existence.survive(t, dt, self._lifetime_s, self._memory_s)

    def _associate(self, seen: Measured, detected: Floats) -> _Match:
        """Which of m measurements is of which of n tracks; detected: (n,)."""
        t = self._tracks
        class_id = tracks.classes_of(t)
        pairs = near_pairs(t, seen.state, seen.noise, self._jump.take(class_id), self._jump_probability)
        i, j = pairs.track, pairs.measurement
        ratio, gain = gains(t, detected, seen.class_id, classes.CONFUSION, i, j, pairs.log_density, self._log_clutter)
        chosen = self._assignment.match(i, j, -gain)
        return _Match(i[chosen], j[chosen], ratio[chosen], pairs.jump[chosen], pairs, len(chosen) < len(i))

    def _hit(self, match: _Match, seen: Measured, detected: Floats) -> Floats:
        """A copy of the matched tracks, brought up to date but for mean and covariance."""
        used = match.measurement
        hit = self._tracks.take(match.track, 0)
        if np.count_nonzero(match.jump):
            hit[:, XX] += match.jump
            hit[:, YY] += match.jump
        correct_heading(hit, seen.yaw.take(used), self._yaw_noise)
        tracks.vote(hit, seen.class_id.take(used))
        existence.hit(hit, detected.take(match.track), match.log_ratio, existence.MOST)
        hit[:, tracks.AGE], hit[:, ROW] = 0.0, seen.row.take(used)
        return hit

    def _missed(self, view: SensorView | None) -> Floats:
        """(n,) how much of each track was not measured though it was to be seen: in view, and not behind another."""
        t = self._tracks
        coasts = t[:, ROW] < 0.0
        missed = coasts.astype(np.float64)
        rows = coasts.nonzero()[0]
        if view is not None and len(rows):
            screens = ((t[:, CONFIRMED] > 0.0) & (t[:, ODDS] > self._report)).nonzero()[0]
            missed[rows] = view.expects(t.take(rows, 0), t.take(screens, 0))
        return missed

    def _unexplained(self, match: _Match, seen: Measured) -> Ints:
        """Rows of the measurements that may be new objects: not matched, and not of one that was matched to another."""
        explained = np.zeros(len(seen.row), bool)
        explained[match.measurement] = True
        if match.contested:
            t, i, j = self._tracks, match.near.track, match.near.measurement
            rest = (~explained[j] & (t[i, ROW] >= 0.0)).nonzero()[0]
            if len(rest):
                mean, j = t[i[rest]], j[rest]
                state = seen.state[j]
                offset = state[:, :2] - mean[:, :2]
                same = overlap(offset, mean[:, 3:6], mean[:, YAW], state[:, 3:6], seen.yaw[j], ONE_OBJECT)
                explained[j[same]] = True
        return (~explained).nonzero()[0]

    def _born(self, new: Ints, seen: Measured) -> Floats:
        """Tracks for the measurements at `new`, but for mean, covariance and odds."""
        born = tracks.empty(len(new))
        if len(new):
            born[:, tracks.ID] = np.arange(self._next_id, self._next_id + len(new))
            self._next_id += len(new)
            born[:, YAW], born[:, YAW_VARIANCE], born[:, tracks.TURN] = seen.yaw[new], self._yaw_noise, 1.0
            born[:, tracks.HITS], born[:, ROW] = 1.0, seen.row[new]
            tracks.vote(born, seen.class_id[new])
        return born

    def _finish(self, match: _Match, born: Floats) -> ObjectStates:
        """Give up tracks, take in the `born` ones, report."""
        t = self._tracks
        keep, report = existence.kept(
            t, self._confirm, self._report, self._doubtful, self._max_coast_s, LOST_M**2, MAX_SPEED, self._max_variance
        )
        if match.contested:
            # Two tracks of one object are near the same measurements.
            keep &= ~duplicates(t)
        report &= keep
        reported = t.take(report.nonzero()[0], 0)
        t = t if np.count_nonzero(keep) == len(t) else t[keep]
        self._tracks = np.concatenate([t, born]) if len(born) else t
        self._matched = reported[:, ROW].astype(np.int64)
        return tracks.to_states(reported)


class _Match(NamedTuple):
    """k tracks, their measurements, ln of density over clutter, variance of a jump; and all pairs that were near.

    contested: whether there are other pairs than the chosen ones
    """

    track: Ints
    measurement: Ints
    log_ratio: Floats
    jump: Floats
    near: Pairs
    contested: bool
