"""The box tracker: Kalman filter, gating, assignment, existence probabilities."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.states import CLASSES, Bools, Detections, Floats, Ints, ObjectStates
from mast_zenoh.kernels import kernel
from mast_zenoh.tracking import classes, existence, kalman, tracks
from mast_zenoh.tracking.association import (
    Assignment,
    AssociationModel,
    BipartiteAssignment,
    Match,
    MeasurementBatch,
    gaussian,
    near_pairs,
)
from mast_zenoh.tracking.base import Innovations, Tracker
from mast_zenoh.tracking.classes import first_covariance
from mast_zenoh.tracking.existence import FIRST_DUE, ScoreEvidence, add_scores, report_columns, update_detected
from mast_zenoh.tracking.kalman import constrain_lateral_speed
from mast_zenoh.tracking.tracks import (
    AGE,
    CONFIRMED,
    COVARIANCE,
    FORWARD,
    LASTING,
    ODDS,
    ROW,
    SCORE,
    TURN_LIMIT,
    XX,
    XY,
    YX,
    YY,
    correct_heading,
    duplicated,
    duplicates,
    resolve_headings_and_store,
    update_class,
)
from mast_zenoh.tracking.view import SensorView

#: Number of pairs over which the estimate averages, and weight of the default in pairs.
MEMORY, PRIOR = 1000.0, 200.0
#: Ratio to the default variance up to which the default is used: half as much again in standard deviation.
TOLERANCE = 1.5**2
#: Largest ratio to the default variance.
LARGEST = 5.0**2


class DetectionNoise:
    """Variances of the detections of one source that gives no covariances.

    The mean squared innovation of a filter is the variance of its prediction plus that of the measurement, so their
    difference estimates the latter (covariance matching: Mehra, IEEE Transactions on Automatic Control, 1972). Only the
    horizontal position is estimated, the same for both axes.

    The default is kept to the bit while the estimate is near or below it: errors that last are in the tracks too, and
    their innovations are too small. Above, the estimate is used, up to a limit.

    variance: (6,) m^2, of x y z l w h, currently used
    """

    def __init__(self, default: Floats) -> None:
        self._default = self.variance = default
        self._sum, self._weight = PRIOR * float(default[0]), PRIOR

    def learn(self, excess: float, count: int) -> None:
        """Learn from `count` matched pairs; excess: m^2, see `excess_sum`."""
        if count == 0:
            return
        keep = math.exp(-count / MEMORY)
        self._sum, self._weight = max(keep * self._sum + 0.5 * excess, 0.0), keep * self._weight + count
        ratio = self._sum / (self._weight * float(self._default[0]))
        self.variance = self._default
        if ratio > TOLERANCE:
            self.variance = self._default.copy()
            self.variance[:2] *= min(ratio, LARGEST)


@kernel
def new_tracks(
    explained: Bools,
    measured: tuple[Any, ...],
    first_id: int,
    constants: tuple[float, float, float],
    speed: tuple[Floats, Floats, float],
) -> Floats:
    """New tracks (k, WIDTH) for the measurements that are not explained (m,).

    measured: the fields of `MeasurementBatch`
    constants: yaw_variance, odds and FIRST_DUE; speed: `classes.FIRST_SPEED`, where velocities are not measured
    """
    row, state, noise, yaw, class_id, score = (column[~explained] for column in measured)
    new = tracks.empty(len(row))
    new[:, : state.shape[1]] = state
    P = noise if state.shape[1] == 9 else first_covariance(noise, yaw, class_id)
    new[:, tracks.COVARIANCE] = P.reshape(len(row), 81)
    new[:, tracks.ID] = np.arange(first_id, first_id + len(row))
    new[:, tracks.YAW_VARIANCE], new[:, tracks.ODDS], new[:, tracks.DUE] = constants
    new[:, tracks.TURN] = new[:, tracks.HITS] = 1.0
    new[:, tracks.YAW], new[:, tracks.ROW], new[:, tracks.SCORE] = yaw, row, score
    tracks.update_class(new, class_id)
    return new


@kernel
def matched_tracks(
    tracks: Floats,
    match: tuple[Ints, Ints, Floats, Floats],
    detected: Floats,
    measured: tuple[Any, ...],
    yaw_variance: float,
    most: float,
    correlated: bool,
) -> tuple[Floats, Floats, Floats, Floats, tuple[float, int], tuple[float, int]]:
    """The k matched ones of n tracks and their measurements, ready for the Kalman correction.

    match: rows of the tracks and of the measurements, log density ratios to clutter, and variances of jumps m^2: (k,)
    detected: (n,) detection probabilities; measured: the fields of `MeasurementBatch`
    yaw_variance: rad^2, of a measured heading; most: upper limit of the odds
    correlated: whether the errors of measured full states are those of the tracks: covariances are wider, see `widen`

    Returns a copy (k, WIDTH) of the tracks, updated by their measurements except for mean and covariance; the states
    and noises of the measurements; innovations (k, 2) m; `innovation_sum` and `excess_sum`.
    """
    track, measurement, log_ratio, jump = match
    row, state, noise, yaw, class_id, score = (column.take(measurement, 0) for column in measured)
    updated = tracks.take(track, 0)
    updated[:, XX] += jump
    updated[:, YY] += jump
    correct_heading(updated, yaw, yaw_variance)
    update_class(updated, class_id)
    update_detected(updated, detected.take(track), log_ratio, most)
    add_scores(updated, score)
    updated[:, AGE], updated[:, ROW] = 0.0, row
    if correlated and state.shape[1] == 9:
        widen(updated, noise)
    innovation = state[:, :2] - updated[:, :2]
    steady = jump == 0.0
    sums = innovation_sum(updated, innovation, noise, steady), excess_sum(updated, innovation, steady)
    return updated, state, noise, innovation, *sums


def widen(tracks: Floats, noise: Floats) -> None:
    """Widen the covariances of k tracks and of their measurements (k, 9, 9) so that correlated errors count once.

    Successive outputs of a filter are correlated. Covariance intersection of track and measurement avoids double
    counting; weights by the trace of the position covariance (Niehsen, FUSION 2002).
    """
    track_variance, measured_variance = tracks[:, XX] + tracks[:, YY], noise[:, 0, 0] + noise[:, 1, 1]
    weight = (measured_variance / (track_variance + measured_variance))[:, None]
    tracks[:, COVARIANCE] /= weight
    noise /= 1.0 - weight[:, None]


def innovation_sum(tracks: Floats, innovation: Floats, noise: Floats, steady: Bools) -> tuple[float, int]:
    """Sum of normalised innovations squared of k matched pairs, and how many they are.

    Of the horizontal position; pairs with a sudden displacement are left out.
    tracks: (k, WIDTH) predicted; innovation: (k, 2) m; noise: (k, m, m), the first two rows and columns are x and y
    steady: (k,) whether there is no sudden displacement
    """
    a, b, c = tracks[:, XX] + noise[:, 0, 0], tracks[:, XY] + noise[:, 0, 1], tracks[:, YY] + noise[:, 1, 1]
    distance = gaussian(innovation[:, 0], innovation[:, 1], a, b, c)[1]
    return float(distance[steady].sum()), int(np.count_nonzero(steady))


def excess_sum(tracks: Floats, innovation: Floats, steady: Bools) -> tuple[float, int]:
    """Squared innovations of confirmed tracks beyond the variances of their predictions, m^2, and how many they are.

    See `innovation_sum`. The velocity of tracks that are not confirmed is not known yet.
    """
    rows = (steady & (tracks[:, CONFIRMED] > 0.0)).nonzero()[0]
    innovation, t = innovation.take(rows, 0), tracks.take(rows, 0)
    return float(np.square(innovation).sum() - t[:, XX].sum() - t[:, YY].sum()), len(rows)


def set_lasting(tracks: Floats, noise: Floats, share: float) -> None:
    """Remember the part of the variance of k tracks' newest measurements that lasts.

    noise: (k, m, m) of the measurements; share: of the variance of their horizontal positions

    An error that stays with an object, or wanders slower than the filter follows, is in the track as it is in the
    measurement: the mean of many measurements still has it, so the covariance of the filter is too small by it.
    """
    np.multiply(noise[:, 0, :2], share, tracks[:, LASTING][:, :2])
    np.multiply(noise[:, 1, 1], share, tracks[:, LASTING][:, 2])


def with_lasting(tracks: Floats) -> Floats:
    """The tracks (n, WIDTH), their covariances with what lasts of the errors of their measurements."""
    lasting, tracks = tracks[:, LASTING], tracks.copy()
    for column, part in ((XX, 0), (XY, 1), (YX, 1), (YY, 2)):
        tracks[:, column] += lasting[:, part]
    return tracks


#: rad/sqrt(s), drift of a heading.
YAW_DRIFT = 0.3
#: m/s, upper limit for road users; faster tracks are dropped.
MAX_SPEED = 60.0
#: Fraction of the birth odds below which an unconfirmed track is dropped: more than one miss in full view.
DROP_FRACTION = 0.05
#: m, standard deviation of the horizontal position beyond which a track is lost.
LOST_M = 3.0
#: Weight of the prior detection probability, in frames.
PRIOR_FRAMES = 2.0
#: Factor on the score of a newly reported state, to allow for transient errors of the source.
FIRST_REPORT = 0.9
_BIPARTITE = BipartiteAssignment()
#: Parameters that must be probabilities, and others that must be positive.
PROBABILITIES = (
    "detection_probability", "report_probability", "confirm_probability", "min_probability", "jump_probability",
)  # fmt: skip
POSITIVE = (
    "position_std_m", "vertical_std_m", "size_std_m", "yaw_std_rad", "clutter_per_m2", "birth_odds", "lifetime_s",
    "memory_s", "max_std_m", "jump_std_m", "acceleration_scale",
)  # fmt: skip


class KalmanBoxTracker3D(Tracker):
    """Tracks boxes in the plane of the road with a Kalman filter.

    See docs/explanation-tracking-and-fusion.md for the model and the sources of the numbers.

    position_std_m, vertical_std_m: standard deviation of a detection's horizontal position per axis, and of its height,
        unless it has its own covariance; the former is estimated where none has one, see `detection_noise`
    size_std_m, yaw_std_rad: standard deviation of a detection's sizes, and of its heading modulo half a turn
    lasting_share: share of the variance of a detection's horizontal position that lasts, so that the filter does not
        average it away: it is added to the variance that a track reports; 0: all errors are new in each frame
    detection_probability: probability of detecting an object in full view, unless the sensor's view has its own; a
        track's own hit rate can only lower it
    report_probability: probability that a source of states (`step_states`) continues to report an existing object
    clutter_per_m2: false detections per square metre and frame
    birth_odds: odds that a detection without a matching track is a new object
    lifetime_s: s, average time that an object stays in view; memory_s: s, time constant of a track's hit rate
    confirm_probability, min_probability: existence probabilities above which a track is confirmed, and reported
    max_coast_s: s without a measurement after which a track is dropped (earlier if its position uncertainty exceeds
        LOST_M); until then it may be recovered under the same id
    max_std_m: m, standard deviation of the horizontal position above which a track is not reported; `innovations`
        counts the steps in which none is for that reason
    jump_probability, jump_std_m: probability of a sudden displacement in a frame, and its standard deviation per axis
        for a moving car, see `gating`
    acceleration_scale: factor on the accelerations in `classes`
    independent_states: whether the errors of full states (`step_states`) count as independent of each other and of the
        tracks', as in a Kalman filter that takes tracks for measurements; they are not, so it becomes too certain
    assignment: how detections are assigned to tracks

    Raises ValueError for a probability outside (0, 1), for a share outside [0, 1] and for any other
    parameter, except max_coast_s, that is not positive.
    """

    filter: kalman.BoxFilter = kalman.BatchedFilter()

    def __init__(
        self,
        *,
        position_std_m: float = 0.4,
        vertical_std_m: float = 0.2,
        size_std_m: float = 0.3,
        yaw_std_rad: float = 0.1,
        lasting_share: float = 0.4,
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
        independent_states: bool = False,
        assignment: Assignment = _BIPARTITE,
    ) -> None:
        parameters = locals()
        check("more than 0 and less than 1", **{name: parameters[name] for name in PROBABILITIES})
        check("more than 0", **{name: parameters[name] for name in POSITIVE})
        check("0 to 1", lasting_share=lasting_share)
        self._lasting_share = lasting_share
        self._variance = np.square([position_std_m] * 2 + [vertical_std_m] + [size_std_m] * 3)
        self._yaw_noise = yaw_std_rad**2
        self._detection_probability = detection_probability
        self._report_probability = report_probability
        self._birth_odds = birth_odds
        self._lifetime_s = lifetime_s
        self._memory_s = memory_s
        self._min_probability = min_probability
        self._report_odds = min_probability / (1.0 - min_probability)
        confirm_odds, drop_odds = confirm_probability / (1.0 - confirm_probability), birth_odds * DROP_FRACTION
        limits = confirm_odds, self._report_odds, drop_odds, max_coast_s, LOST_M**2, MAX_SPEED, max_std_m**2
        self._status_limits = limits
        self._model = AssociationModel(
            np.square(jump_std_m * classes.JUMP),
            math.log(jump_probability),
            float(np.log(clutter_per_m2)),
            classes.CONFUSION,
        )
        self._acceleration = acceleration_scale * classes.ACCELERATION
        self.independent_states = independent_states
        self._assignment = assignment
        self.reset()

    def reset(self) -> None:
        self.innovations: Innovations = Innovations()
        self._tracks = tracks.empty(0)
        self._evidence = ScoreEvidence()
        self._noise = DetectionNoise(self._variance)
        self._next_id = 0
        self._time_ns: int | None = None
        self._matched = np.zeros(0, np.int64)
        self._process_noise = (0.0, np.zeros((len(CLASSES), 9, 9)))

    @property
    def matched(self) -> Ints:
        return self._matched

    @property
    def measured(self) -> tuple[Ints, Ints]:
        """Ids (k,) of the tracks that the last step measured, reported or not, and their rows in its input."""
        t = self._tracks[self._tracks[:, ROW] >= 0.0]
        return t[:, tracks.ID].astype(np.int64), t[:, ROW].astype(np.int64)

    def step(self, time_ns: int, detections: Detections, view: SensorView | None = None) -> ObjectStates:
        measurements = MeasurementBatch.detections(detections, self._noise.variance)
        self._advance(time_ns)
        t = self._tracks
        of_sensor = None if view is None else view.detection_probability
        prior = self._detection_probability if of_sensor is None else of_sensor
        detected = existence.detection_probability(t, prior, PRIOR_FRAMES)
        match = self._associate(measurements, detected)
        if len(match.track):
            matched, state, noise, innovation, excess = self._matched_tracks(match, measurements, detected)
            if not np.count_nonzero(detections.covariance):
                self._noise.learn(*excess)
            self.filter.correct(matched, state, noise)
            constrain_lateral_speed(self.filter, matched, innovation)
            if self._lasting_share:
                set_lasting(matched, noise, self._lasting_share)
            resolve_headings_and_store(t, match.track, matched, FORWARD, TURN_LIMIT)
        self._update_missed(detected, view)
        new_tracks = self._created(match, measurements)
        if self._lasting_share:
            set_lasting(new_tracks, tracks.covariances(new_tracks), self._lasting_share)
        reported = self._finish(match, new_tracks)
        self._evidence.learn(self._tracks, measurements.score, self._report_odds)
        doubtful = self._evidence.doubtful(reported)
        if np.count_nonzero(doubtful):
            reported = reported[~doubtful]
        return self._states(reported, self._evidence.probability(reported), self._min_probability)

    def step_states(self, time_ns: int, measured: ObjectStates) -> ObjectStates:
        measurements = MeasurementBatch.states(measured)
        self._advance(time_ns)
        t = self._tracks
        detected = np.full(len(t), self._report_probability)
        match = self._associate(measurements, detected)
        if len(match.track):
            matched, state, noise, _, _ = self._matched_tracks(match, measurements, detected)
            self.innovations.at_most = not self.independent_states
            self.filter.correct(matched, state, noise)
            resolve_headings_and_store(t, match.track, matched, FORWARD, TURN_LIMIT)
        self._update_missed(detected, None)
        new_tracks = self._created(match, measurements)
        if len(new_tracks):
            # The tempered score is the prior: the source's own odds count successive frames as independent
            # evidence, although their errors last (`tempered_probability`).
            score = np.clip(FIRST_REPORT * new_tracks[:, SCORE], 0.01, 0.99)
            new_tracks[:, ODDS] = score / (1.0 - score)
        reported = self._finish(match, new_tracks)
        return self._states(reported, np.clip(reported[:, SCORE], 0.0, 1.0), -math.inf)

    def _advance(self, time_ns: int) -> None:
        """Predict the tracks to `time_ns`."""
        before = time_ns if self._time_ns is None else self._time_ns
        if time_ns < before:
            raise ValueError(
                f"time_ns of a step: found {time_ns}, expected at least {before}, the time of the previous step"
            )
        self._time_ns = time_ns
        t, dt = self._tracks, (time_ns - before) * 1e-9
        existence.begin_step(t, dt, YAW_DRIFT**2, self._lifetime_s, self._memory_s)
        if len(t) and dt > 0.0:
            if dt != self._process_noise[0]:
                noise = kalman.process_noise(dt, self._acceleration, classes.VERTICAL_ACCELERATION, classes.SIZE_DRIFT)
                self._process_noise = (dt, noise)
            self.filter.predict(t, dt, self._process_noise[1])

    def _associate(self, measurements: MeasurementBatch, detected: Floats) -> Match:
        """Assign m measurements to n tracks; detected: (n,) detection probabilities."""
        pairs = near_pairs(self._tracks, detected, measurements, self._model)
        chosen = self._assignment.match(pairs.track, pairs.measurement, pairs.cost)
        contested = len(chosen) < len(pairs.track)
        i, j, log_ratio, jump = pairs.track, pairs.measurement, pairs.log_ratio, pairs.jump
        if contested:
            i, j, log_ratio, jump = i[chosen], j[chosen], log_ratio[chosen], jump[chosen]
        return Match(i, j, log_ratio, jump, pairs, contested)

    def _matched_tracks(
        self, match: Match, measurements: MeasurementBatch, detected: Floats
    ) -> tuple[Floats, Floats, Floats, Floats, tuple[float, int]]:
        """The matched tracks before the Kalman correction, and their measurements, see `matched_tracks`."""
        pairs, correlated = (match.track, match.measurement, match.log_ratio, match.jump), not self.independent_states
        matched, state, noise, innovation, total, excess = matched_tracks(
            self._tracks, pairs, detected, measurements, self._yaw_noise, existence.MAX_ODDS, correlated
        )
        self.innovations.add(*total, len(matched))
        return matched, state, noise, innovation, excess

    def _update_missed(self, detected: Floats, view: SensorView | None) -> None:
        """Update the tracks that were not measured by how far they were visible."""
        coasting, boxes, occluders = existence.coasting_tracks(self._tracks, self._report_odds)
        seen = np.ones(len(boxes)) if view is None else view.visible_fraction(boxes, occluders)
        existence.update_missed(self._tracks, detected, coasting, seen, self._birth_odds)

    def _created(self, match: Match, measurements: MeasurementBatch) -> Floats:
        """New tracks for the measurements that neither match nor duplicate a matched object."""
        explained = np.zeros(len(measurements.row), bool)
        explained[match.measurement] = True
        if match.contested:
            i, j = match.near.track, match.near.measurement
            explained[j[duplicated(self._tracks, measurements.state, measurements.yaw, i, j, explained)]] = True
        constants = self._yaw_noise, self._birth_odds, FIRST_DUE
        created = new_tracks(explained, measurements, self._next_id, constants, classes.FIRST_SPEED)
        self._next_id += len(created)
        return created

    def _states(self, reported: Floats, weight: Floats | None, least: float) -> ObjectStates:
        """The tracks to report that are likely to exist or established, with scores that rank them.

        weight: (k,) factors on their scores and probabilities, which must exceed `least`; None: report all, factors 1
        """
        if weight is None:
            weight, least = np.ones(len(reported)), -math.inf
        if self._lasting_share:
            reported = with_lasting(reported)
        columns, self._matched = report_columns(reported, weight, least)
        return ObjectStates(*columns)

    def _finish(self, match: Match, new_tracks: Floats) -> Floats:
        """Drop tracks and add the new ones; the tracks (k, WIDTH) to report."""
        t = self._tracks
        keep, report = existence.track_status(t, *self._status_limits)
        if match.contested:
            # Duplicate tracks of one object share nearby measurements.
            keep &= ~duplicates(t)
        self._tracks, reported = tracks.next_table(t, keep, report, new_tracks)
        if len(reported) == 0:
            likely = keep & (t[:, CONFIRMED] > 0.0) & (t[:, ODDS] > self._report_odds)
            self.innovations.silent += bool((t[likely, ROW] >= 0.0).any())
        return reported


if TYPE_CHECKING:
    from filterpy.kalman import KalmanFilter


class FilterpyFilter(kalman.BoxFilter):
    """One filterpy filter per track and call."""

    def predict(self, t: Floats, dt: float, noise: Floats) -> None:
        transition = np.eye(9)
        transition[kalman.POSITION, kalman.VELOCITY] = dt * np.eye(3)
        for row, Q in zip(t, noise[tracks.classes_of(t)], strict=True):
            box_filter = _filter(row, 1)
            box_filter.predict(F=transition, Q=Q)
            _store(box_filter, row)

    def correct(self, t: Floats, measured: Floats, noise: Floats) -> None:
        m = measured.shape[1]
        for row, z, R in zip(t, measured, noise, strict=True):
            box_filter = _filter(row, m)
            box_filter.update(z, R=R, H=np.eye(9)[:m])
            _store(box_filter, row)

    def correct_speed(self, t: Floats, direction: Floats, noise: Floats) -> None:
        for row, (x, y), variance in zip(t, direction, noise, strict=True):
            observation = np.zeros((1, 9))
            observation[0, 6:8] = x, y
            box_filter = _filter(row, 1)
            box_filter.update(np.zeros(1), R=np.array([[variance]]), H=observation)
            _store(box_filter, row)


class FilterpyBoxTracker3D(KalmanBoxTracker3D):
    """`KalmanBoxTracker3D` with `filterpy.kalman.KalmanFilter`, one track at a time."""

    filter = FilterpyFilter()


def _filter(track: Floats, measured: int) -> KalmanFilter:
    # Imported here because filterpy imports matplotlib, which takes half a second.
    from filterpy.kalman import KalmanFilter

    box_filter = KalmanFilter(dim_x=9, dim_z=measured)
    box_filter.x, box_filter.P = track[tracks.MEAN].copy(), track[tracks.COVARIANCE].reshape(9, 9).copy()
    return box_filter


def _store(box_filter: KalmanFilter, track: Floats) -> None:
    track[tracks.MEAN], track[tracks.COVARIANCE] = box_filter.x, box_filter.P.ravel()
