"""The box tracker: batched Kalman filter, gating, one-to-one assignment, and a probability that each object exists."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from mast_zenoh.states import Detections, Floats, Ints, ObjectStates
from mast_zenoh.tracking import classes, existence, kalman, tracks
from mast_zenoh.tracking.assignment import Assignment, BipartiteAssignment
from mast_zenoh.tracking.base import Tracker
from mast_zenoh.tracking.classes import first_covariance
from mast_zenoh.tracking.duplicates import duplicates, overlap
from mast_zenoh.tracking.gating import Pairs, near_pairs
from mast_zenoh.tracking.heading import correct_heading, settle_sense
from mast_zenoh.tracking.soundness import sound
from mast_zenoh.tracking.view import SensorView, unblocked

#: m^2/s^3, spectral density of vertical acceleration: roads are nearly flat.
VERTICAL_ACCELERATION = 0.2
#: m^2/s, what a size may drift: nothing, but for what of an object is in view.
SIZE_DRIFT = 4e-4
#: rad/sqrt(s), what a heading may drift.
YAW_DRIFT = 0.3
#: m/s, slip of a rolling object across its heading, as in a tight turn, where the box's centre is not the turning one.
SLIP = 0.5
#: Share that a new surprise has in its running mean: of about the last five.
ASIDE_SHARE = 0.2
#: s: a mean surprise of 15 cm to one side stands for a sideways speed of 1 m/s that the filter does not believe in.
ASIDE_S = 0.15
#: m/s along its axis above which an object is taken to move forward.
FORWARD = 2.0
#: m/s above which nothing on a road goes.
MAX_SPEED = 60.0
#: Log-odds that a track may lose from its birth until it is given up, if never confirmed: one miss in full view.
DOUBT = 3.0
#: m, standard deviation of the horizontal position beyond which a track is lost.
LOST_M = 3.0
#: Frames' worth of belief in the prior detection probability.
PRIOR_FRAMES = 2.0
#: How far a first report of a state is believed, against a source's transient errors.
FIRST_REPORT = 0.9
#: m/s from which a sudden displacement has its full size.
LANE_CHANGE_SPEED = 5.0
#: (m/s)^2, variance of a measured speed that says nothing.
NO_MEASUREMENT = 1e9

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
        for name, value in (
            ("detection_probability", detection_probability),
            ("report_probability", report_probability),
            ("confirm_probability", confirm_probability),
            ("min_probability", min_probability),
            ("jump_probability", jump_probability),
        ):
            if not 0.0 < value < 1.0:
                raise ValueError(f"{name}: found {value}, expected more than 0 and less than 1")
        for name, value in (
            ("position_std_m", position_std_m),
            ("vertical_std_m", vertical_std_m),
            ("size_std_m", size_std_m),
            ("yaw_std_rad", yaw_std_rad),
            ("clutter_per_m2", clutter_per_m2),
            ("birth_odds", birth_odds),
            ("lifetime_s", lifetime_s),
            ("memory_s", memory_s),
            ("max_std_m", max_std_m),
            ("jump_std_m", jump_std_m),
            ("acceleration_scale", acceleration_scale),
        ):
            if not value > 0.0:
                raise ValueError(f"{name}: found {value}, expected more than 0")
        std = [position_std_m, position_std_m, vertical_std_m, size_std_m, size_std_m, size_std_m]
        self._noise = np.diag(np.square(std))
        self._yaw_noise = yaw_std_rad**2
        self._detection_probability = detection_probability
        self._report_probability = report_probability
        self._log_clutter = float(np.log(clutter_per_m2))
        self._birth = float(np.log(birth_odds))
        self._doubtful = self._birth - DOUBT
        self._lifetime_s = lifetime_s
        self._memory_s = memory_s
        self._confirm = tracks.log_odds(confirm_probability)
        self._report = tracks.log_odds(min_probability)
        self._max_coast_ns = round(max_coast_s * 1e9)
        self._max_variance = max_std_m**2
        self._jump_probability = jump_probability
        self._jump_std_m = jump_std_m
        self._acceleration_scale = acceleration_scale
        self._assignment = assignment
        self.reset()

    def reset(self) -> None:
        self._tracks = tracks.empty(0)
        self._next_id = 0
        self._time_ns: int | None = None
        self._matched = np.zeros(0, np.int64)

    @property
    def matched(self) -> Ints:
        return self._matched

    def step(self, time_ns: int, detections: Detections, view: SensorView | None = None) -> ObjectStates:
        d = detections
        order = _canonical_order(d)
        seen = _Measured(order, d.position[order], d.size[order], d.yaw[order], tracks.known_class(d.class_id[order]))
        box = np.concatenate([seen.position, seen.size], axis=1)
        noise = self._detection_noise(d.covariance[order])
        self._advance(time_ns)
        detected = existence.detection_probability(self._tracks, self._detection_probability, PRIOR_FRAMES)
        match = self._associate(seen, noise, detected)
        if len(match.track):
            hit = self._hit(match, seen, detected)
            used = match.measurement
            surprise = box[used, :2] - hit["mean"][:, :2]
            mean, P = self.filter.correct(hit["mean"], hit["covariance"], kalman.BOX, box[used], noise[used])
            hit["mean"], hit["covariance"] = self._roll(mean, P, hit, surprise)
            self._store(match.track, hit)
        missed = (self._tracks["row"] < 0).nonzero()[0]
        if len(missed):
            existence.miss(self._tracks, missed, detected[missed], self._expected(missed, view), self._birth)
        new = self._unexplained(match, seen)
        born = self._born(new, seen)
        if len(new):
            born["mean"][:, kalman.BOX] = box[new]
            born["covariance"] = first_covariance(noise[new], seen.yaw[new], seen.class_id[new])
            born["odds"] = self._birth
        return self._finish(born)

    def step_states(self, time_ns: int, measured: ObjectStates) -> ObjectStates:
        order = np.lexsort((measured.id, *measured.position.T))
        s = measured.select(order)
        seen = _Measured(order, s.position, s.size, s.yaw, tracks.known_class(s.class_id))
        state = np.concatenate([s.position, s.size, s.velocity], axis=1)
        noise = sound(s.covariance)
        self._advance(time_ns)
        detected = np.full(len(self._tracks), self._report_probability)
        match = self._associate(seen, noise, detected)
        if len(match.track):
            hit = self._hit(match, seen, detected)
            P, R = hit["covariance"], noise[match.measurement]
            # States that come out of filters repeat what they said before. Covariance intersection of track and
            # measurement counts nothing twice; weights by the trace of the position (Niehsen, FUSION 2002).
            own, theirs = P[:, 0, 0] + P[:, 1, 1], R[:, 0, 0] + R[:, 1, 1]
            weight = (theirs / (own + theirs))[:, None, None]
            hit["mean"], hit["covariance"] = self.filter.correct(
                hit["mean"], P / weight, kalman.WHOLE, state[match.measurement], R / (1.0 - weight)
            )
            self._store(match.track, hit)
        missed = (self._tracks["row"] < 0).nonzero()[0]
        if len(missed):
            existence.miss(self._tracks, missed, detected[missed], np.ones(len(missed)), self._birth)
        new = self._unexplained(match, seen)
        born = self._born(new, seen)
        if len(new):
            born["mean"], born["covariance"] = state[new], noise[new]
            score = np.clip(FIRST_REPORT * s.score[new], 0.01, 0.99)
            born["odds"] = np.log(score / (1.0 - score))
        return self._finish(born)

    def _advance(self, time_ns: int) -> None:
        """Predict the tracks to `time_ns`."""
        before = time_ns if self._time_ns is None else self._time_ns
        if time_ns < before:
            raise ValueError(
                f"time_ns of a step: found {time_ns}, expected at least {before}, the time of the step before"
            )
        self._time_ns = time_ns
        t, dt = self._tracks, (time_ns - before) * 1e-9
        t["row"] = -1
        if len(t) and dt > 0.0:
            acceleration = self._acceleration_scale * classes.ACCELERATION[t["class_id"]]
            noise = kalman.process_noise(dt, acceleration, VERTICAL_ACCELERATION, SIZE_DRIFT)
            t["mean"], t["covariance"] = self.filter.predict(t["mean"], t["covariance"], dt, noise)
            t["yaw_variance"] += YAW_DRIFT**2 * dt
            existence.survive(t, dt, self._lifetime_s, self._memory_s)

    def _detection_noise(self, covariance: Floats) -> Floats:
        """(m, 6, 6) of detected boxes: of the position what the detector says (m, 3, 3), where it says something."""
        noise = np.empty((len(covariance), 6, 6))
        noise[:] = self._noise
        given = covariance.any(axis=(1, 2))
        if given.any():
            noise[given, :3, :3] = sound(covariance[given])
        return noise

    def _associate(self, seen: _Measured, noise: Floats, detected: Floats) -> _Match:
        """Which of m measurements is of which of n tracks; noise: (m, k, k), x and y first; detected: (n,)."""
        t = self._tracks
        vx, vy = t["mean"][:, 6], t["mean"][:, 7]
        # What stands does not change lanes.
        moves = np.minimum(np.sqrt(vx * vx + vy * vy) * (1.0 / LANE_CHANGE_SPEED), 1.0)
        jump = self._jump_std_m * classes.JUMP[t["class_id"]] * (0.3 + 0.7 * moves)
        pairs = near_pairs(t, seen.position, noise, jump, self._jump_probability)
        i, j = pairs.track, pairs.measurement
        ratio = pairs.log_density - self._log_clutter + classes.CONFUSION[t["class_id"][i], seen.class_id[j]]
        # Against leaving both alone: the object was missed, or is not there, and the measurement is clutter.
        gain = ratio + (np.log(detected / (1.0 - detected)) - np.log1p(np.exp(-t["odds"])))[i]
        chosen = self._assignment.match(i, j, -gain)
        return _Match(i[chosen], j[chosen], ratio[chosen], pairs.jump[chosen], pairs)

    def _hit(self, match: _Match, seen: _Measured, detected: Floats) -> tracks.Tracks:
        """A copy of the matched tracks, brought up to date but for mean and covariance."""
        used = match.measurement
        hit = self._tracks[match.track]
        hit["covariance"][:, (0, 1), (0, 1)] += match.jump[:, None]
        correct_heading(hit, seen.yaw[used], self._yaw_noise)
        tracks.vote(hit, seen.class_id[used])
        existence.hit(hit, detected[match.track], match.log_ratio)
        hit["seen"], hit["row"] = self._time_ns, seen.row[used]
        return hit

    def _roll(self, mean: Floats, covariance: Floats, hit: tracks.Tracks, surprise: Floats) -> tuple[Floats, Floats]:
        """What rolls moves along its heading: its speed across is a slip, plus what the heading is off.

        surprise: (n, 2) m, measured less predicted position. If it keeps pointing to one side, the heading is wrong.
        """
        yaw = hit["yaw"]
        across = np.empty((len(yaw), 2))
        across[:, 0], across[:, 1] = -np.sin(yaw), np.cos(yaw)
        aside = surprise[:, 0] * across[:, 0] + surprise[:, 1] * across[:, 1]
        hit["aside"] += ASIDE_SHARE * (aside - hit["aside"])
        slip = SLIP**2 + (hit["aside"] * (1.0 / ASIDE_S)) ** 2
        slip += (mean[:, 6] ** 2 + mean[:, 7] ** 2) * hit["yaw_variance"]
        return self.filter.correct_speed(
            mean, covariance, across, np.where(classes.ROLLS[hit["class_id"]], slip, NO_MEASUREMENT)
        )

    def _store(self, rows: Ints, hit: tracks.Tracks) -> None:
        settle_sense(hit, FORWARD)
        self._tracks[rows] = hit

    def _expected(self, rows: Ints, view: SensorView | None) -> Floats:
        """(k,) how much of each track at `rows` was to be seen: in the field of view, and not behind another track."""
        if view is None:
            return np.ones(len(rows))
        t = self._tracks
        missed, screens = t["mean"][rows], t["mean"][(t["confirmed"] > 0) & (t["odds"] > self._report)]
        clear = unblocked(view.position, missed[:, :3], missed[:, 3:6], screens[:, :3], screens[:, 3:6])
        return view.expects(missed[:, :3]) * clear

    def _unexplained(self, match: _Match, seen: _Measured) -> Ints:
        """Rows of the measurements that may be new objects: not matched, and not of one that was matched to another."""
        new = np.ones(len(seen.row), bool)
        new[match.measurement] = False
        t, i, j = self._tracks, match.near.track, match.near.measurement
        rest = (new[j] & (t["row"][i] >= 0)).nonzero()[0]
        if len(rest):
            i, j = i[rest], j[rest]
            mean = t["mean"][i]
            offset = seen.position[j, :2] - mean[:, :2]
            same = overlap(offset, mean[:, 3:6], t["yaw"][i], seen.size[j], seen.yaw[j])
            new[j[same]] = False
        return new.nonzero()[0]

    def _born(self, new: Ints, seen: _Measured) -> tracks.Tracks:
        """Tracks for the measurements at `new`, but for mean, covariance and odds."""
        born = tracks.empty(len(new))
        born["id"] = np.arange(self._next_id, self._next_id + len(new))
        self._next_id += len(new)
        born["yaw"], born["yaw_variance"], born["turn"] = seen.yaw[new], self._yaw_noise, 1.0
        born["record"][:, tracks.HITS], born["seen"], born["row"] = 1.0, self._time_ns, seen.row[new]
        tracks.vote(born, seen.class_id[new])
        return born

    def _finish(self, born: tracks.Tracks) -> ObjectStates:
        """Give up tracks, take in the `born` ones, report."""
        t, time_ns = self._tracks, self._time_ns
        assert time_ns is not None
        mean, P = t["mean"], t["covariance"]
        vx, vy = mean[:, 6], mean[:, 7]
        lost = (t["odds"] < self._doubtful) & (t["confirmed"] == 0)
        lost |= t["seen"] < time_ns - self._max_coast_ns
        lost |= (vx * vx + vy * vy > MAX_SPEED**2) | (P[:, 0, 0] + P[:, 1, 1] > LOST_M**2)
        if lost.any():
            t = t[~lost]
        if len(born):
            known = len(t)
            t, before = tracks.empty(known + len(born)), t
            t[:known], t[known:] = before, born
        t["confirmed"] |= t["odds"] > self._confirm
        bad = duplicates(t)
        if bad.any():
            t = t[~bad]
        self._tracks = t
        reported = (t["confirmed"] > 0) & (t["odds"] > self._report)
        reported &= t["covariance"][:, 0, 0] + t["covariance"][:, 1, 1] <= self._max_variance
        t = t[reported]
        self._matched = t["row"].copy()
        return tracks.to_states(t)


@dataclass(frozen=True, slots=True)
class _Measured:
    """m measurements in an order that does not depend on that of the input; `row`: where each was in it."""

    row: Ints
    position: Floats
    size: Floats
    yaw: Floats
    class_id: Ints


@dataclass(frozen=True, slots=True)
class _Match:
    """k tracks, their measurements, ln of density over clutter, variance of a jump; and all pairs that were near."""

    track: Ints
    measurement: Ints
    log_ratio: Floats
    jump: Floats
    near: Pairs


def _canonical_order(d: Detections) -> Ints:
    """(m,) rows in an order that does not depend on that of the input."""
    x = d.position[:, 0]
    order = x.argsort(kind="stable")
    if (x[order[1:]] == x[order[:-1]]).any():
        order = np.lexsort((d.score, d.class_id, *d.size.T, d.yaw, *d.position.T))
    return order
