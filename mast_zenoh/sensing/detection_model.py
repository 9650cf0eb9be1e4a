"""Detectors: one without errors, and statistical models whose detections follow from lidar visibility.

Random numbers of objects for the errors of one sensor, which go on from frame to frame.
"""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.geometry import wrap_angle
from mast_zenoh.arrays.states import CLASS_INDEX, CLASSES, Bools, Detections, Floats, Ints, ObjectStates
from mast_zenoh.sensing.sensors import LidarSensor, in_view, to_sensor
from mast_zenoh.streams import stream


class Detector(ABC):
    """Generates detections from the objects that a lidar sees."""

    def begin(self, agent: str, sensor: str, period_s: float) -> Detector:
        """The detector for one sensor of an agent, from its first measurement on.

        Its `detect` is called for every measurement in order. A detector whose errors last returns a new object here,
        with a memory of its own; by default, all sensors share one without.
        period_s: s, between two measurements
        """
        return self

    @abstractmethod
    def detect(
        self,
        objects: ObjectStates,
        points: NDArray[np.int32],
        lidar: LidarSensor,
        sensor_position: Floats,
        sensor_rotation: Floats,
        ground: float,
        random: np.random.Generator,
    ) -> tuple[Detections, Ints]:
        """Detections of one sensor in one frame, and their truth ids (n,).

        Detections are in the sensor frame, best score first.

        objects: n objects in the world frame. points: (n,) lidar returns of each at this sensor.
        sensor_position (3,) m, sensor_rotation (3, 3) active: pose of the lidar in the world.
        ground: m, z of the ground at the sensor. random: the random stream of this sensor and frame.
        The id of clutter is -1; ids are for scoring only.
        """


@dataclass(kw_only=True, eq=False)
class CleanDetector(Detector):
    """Reports every object with enough points exactly; for tests and upper bounds.

    No noise, misses or clutter.

    min_points: minimum number of lidar returns of a detected object
    """

    min_points: int = 5

    def detect(
        self,
        objects: ObjectStates,
        points: NDArray[np.int32],
        lidar: LidarSensor,
        sensor_position: Floats,
        sensor_rotation: Floats,
        ground: float,
        random: np.random.Generator,
    ) -> tuple[Detections, Ints]:
        """Detections in the order of the objects, all scores one."""
        seen = objects.select(points >= self.min_points)
        n = len(seen)
        detections = Detections(seen.position, seen.size, seen.yaw, np.ones(n), seen.class_id, np.zeros((n, 3, 3)))
        return to_sensor(detections, sensor_position, sensor_rotation), seen.id


#: Of clutter: the classes, their probabilities and typical sizes (l, w, h) m.
_CLUTTER_CLASSES = np.array([CLASS_INDEX[name] for name in ("car", "truck", "pedestrian")], np.uint8)
_CLUTTER_SHARES = (0.7, 0.1, 0.2)
_CLUTTER_SIZES = np.array([(4.5, 1.8, 1.5), (8.0, 2.4, 3.0), (0.6, 0.6, 1.7)])

#: Candidate positions per clutter detection; the field of view covers well over a tenth of the disc around a sensor.
_CLUTTER_CANDIDATES = 64


@dataclass(frozen=True, eq=False)
class Draws:
    """What is random about n objects in one frame.

    detection, flip, wrong, score: (n,) uniform, 0 to 1;  noise: (n, 7) standard normal, of x, y, z, l, w, h, yaw
    other_class: (n,) index into CLASSES, which a wrong class is
    """

    detection: Floats
    flip: Floats
    wrong: Floats
    score: Floats
    noise: Floats
    other_class: Ints


def independent_draws(count: int, random: np.random.Generator) -> Draws:
    """Draws that have nothing to do with those of other frames."""
    detection, flip, wrong, score = random.random((4, count))
    noise = random.standard_normal((count, 7))
    return Draws(detection, flip, wrong, score, noise, random.integers(1, len(CLASS_INDEX), count))


_UNIFORMS, _NOISES = 5, 7  # numbers of an object: those of `Draws` that are uniform, and its noise
_SMALLEST_VIEW_DEG = 30.0
_NEVER_S = 3600.0  # time constant of what stays the same for an object: its heading's reversal, its class


class _Viewpoint(NamedTuple):
    """A sensor in one frame; see `Detector.detect`."""

    lidar: LidarSensor
    position: Floats
    rotation: Floats
    ground: float

    def in_view(self, position: Floats) -> Bools:
        """(n,) whether positions (n, 3) m in the world are in the field of view."""
        return in_view(position, self.position, self.rotation, self.lidar)


@dataclass(eq=False)
class _ClutterKind:
    """Clutter that stays where it is in the world, until it ends by chance.

    share: of all clutter of a frame; survival: probability that one is there in the next frame, too
    standing: that of the last frame, world frame; None before the first
    """

    share: float
    survival: float
    standing: Detections | None = None


@dataclass(kw_only=True, eq=False)
class DetectionModel(Detector):
    """A statistical detector: misses, noise, wrong classes and clutter, which last as those of real detectors do.

    They are drawn from the number of lidar returns.

    An object with n >= min_points returns is detected with probability 1 - exp(-n / points_scale). Errors are normal,
    with the standard deviations below times

        sqrt(1 + (range / range_scale_m)^2 + few_points / n)

    along the axes of the world; size errors are limited to 30 % of the size. Clutter is Poisson, uniform over the
    ground in view up to `clutter_range_m`.

    With `white`, nothing lasts. Without, the default, an error of position, size or yaw is the sum of three parts:

    * one that stays with the object and the angle from which it is seen: a smooth random function of that angle, fixed
      to the object and the sensor. It turns with the object (share `view_share` of the variance);
    * one that wanders: a stationary first-order autoregressive process with the time constant `error_s` (the rest);
    * one that is new in each frame (`white_share`).

    What decides whether an object is detected, and its score, wander as well. A wrong class and a reversed heading stay
    with the object. What wanders begins anew for an object that was out of view. Clutter stays where it is in the
    world, except for the part of the error that is new in each frame, and ends by chance: most is there for a moment,
    some lasts.

    The defaults approximate lidar detectors on two real cooperative data sets (0.3 to 0.6 m error per axis,
    about two false positives a frame, a precision of about 0.8, a recall of about 0.65). Errors, misses and clutter
    last as long as in the published detections of V2V4Real's two cars (Xu et al. 2023). docs/how-to-scenes.md compares
    them.

    min_points:        an object with fewer returns is not detected
    points_scale:      number of returns at which 63 % of objects are detected
    position_noise_m:  x and y; vertical_noise_m: z; size_noise_m: each of l, w, h; yaw_noise_deg: yaw
    range_scale_m, few_points: range and number of returns at which the noise has grown by a factor of sqrt(2)
    flip_probability:  of a reversed heading
    wrong_class:       probability of a random class
    clutter_rate:      false detections per frame, mean
    clutter_range_m:   m, maximum distance of clutter
    score, clutter_score: (low, high), uniform
    report_covariance: whether detections have a position covariance
    white:             whether everything is independent from frame to frame; the parameters below have no effect then
    view_share:        share of the errors' variance that stays with the object and the viewing angle
    view_angle_deg:    difference of viewing angles at which that part correlates by 0.6; 30 to 360
    white_share:       share of the errors' variance that is new in each frame
    error_s:           s, time constant of the part that wanders
    miss_s:            s, time constant of what decides whether an object is detected: misses come in episodes
    clutter_s:         s, mean duration of clutter that lasts
    blip_s:            s, mean duration of the other clutter
    lasting_clutter:   share of a frame's clutter that lasts
    """

    min_points: int = 5
    points_scale: float = 25.0
    position_noise_m: float = 0.28
    vertical_noise_m: float = 0.1
    size_noise_m: float = 0.1
    yaw_noise_deg: float = 3.0
    range_scale_m: float = 60.0
    few_points: float = 10.0
    flip_probability: float = 0.0
    wrong_class: float = 0.02
    clutter_rate: float = 2.5
    clutter_range_m: float = 80.0
    score: tuple[float, float] = (0.6, 1.0)
    clutter_score: tuple[float, float] = (0.3, 0.8)
    report_covariance: bool = True
    white: bool = False
    view_share: float = 0.45
    view_angle_deg: float = 40.0
    white_share: float = 0.35
    error_s: float = 1.5
    miss_s: float = 0.22
    clutter_s: float = 0.8
    blip_s: float = 0.085
    lasting_clutter: float = 0.44

    def __post_init__(self) -> None:
        scales = "points_scale", "range_scale_m"
        check("more than 0 and at most 1000", **{name: getattr(self, name) for name in scales})
        noises = "position_noise_m", "vertical_noise_m", "size_noise_m", "yaw_noise_deg", "few_points"
        numbers = "min_points", "clutter_rate", "clutter_range_m"
        check("0 to 1000", **{name: getattr(self, name) for name in (*noises, *numbers)})
        shares = "flip_probability", "wrong_class", "view_share", "white_share", "lasting_clutter"
        check("0 to 1", **{name: getattr(self, name) for name in shares})
        check("True or False", white=self.white)
        times = "error_s", "miss_s", "clutter_s", "blip_s"
        check("more than 0, finite", **{name: getattr(self, name) for name in times})
        if not _SMALLEST_VIEW_DEG <= self.view_angle_deg <= 360.0:
            raise ValueError(f"view_angle_deg: found {self.view_angle_deg}, expected {_SMALLEST_VIEW_DEG:g} to 360")
        if self.view_share + self.white_share > 1.0:
            found = f"{self.view_share} and {self.white_share}"
            raise ValueError(f"view_share, white_share: found {found}, expected a sum of at most 1")
        for name, (low, high) in (("score", self.score), ("clutter_score", self.clutter_score)):
            if not 0 <= low <= high <= 1:
                raise ValueError(f"{name}: found {(low, high)}, expected 0 <= low <= high <= 1")
        self._begin_anew(0.1)

    def _begin_anew(self, period_s: float) -> None:
        """Forget all frames. period_s: s, between two"""
        # Standard normal numbers of each object: detection, flip, wrong class, score, other class, seven of noise.
        constants = [self.miss_s, _NEVER_S, _NEVER_S, self.miss_s, _NEVER_S, *[self.error_s] * _NOISES]
        self._wandering = WanderingNumbers(np.exp(-period_s / np.array(constants)))
        self._view = ViewErrors(_NOISES, float(np.radians(self.view_angle_deg)))
        self._clutter_kinds = [
            _ClutterKind(share, float(np.exp(-period_s / duration_s)))
            for share, duration_s in (
                (self.lasting_clutter, self.clutter_s),
                (1.0 - self.lasting_clutter, self.blip_s),
            )
        ]

    def begin(self, agent: str, sensor: str, period_s: float) -> Detector:
        if self.white:
            return self
        mine = copy.copy(self)
        mine._begin_anew(period_s)
        return mine

    def detect(
        self,
        objects: ObjectStates,
        points: NDArray[np.int32],
        lidar: LidarSensor,
        sensor_position: Floats,
        sensor_rotation: Floats,
        ground: float,
        random: np.random.Generator,
    ) -> tuple[Detections, Ints]:
        # Random numbers are drawn in the order of the ids, so that the order of the rows makes no difference.
        order = np.argsort(objects.id, kind="stable")
        order = order[points[order] > 0]
        seen, returns = objects.select(order), points[order].astype(np.float64)
        detected, detected_id = self._true_detections(seen, returns, sensor_position, random)
        clutter = self._clutter(_Viewpoint(lidar, sensor_position, sensor_rotation, ground), random)
        both = Detections.joined([detected, clutter])
        best_first = np.argsort(-both.score, kind="stable")
        ids = np.concatenate([detected_id, np.full(len(clutter), -1, np.int64)])[best_first]
        return to_sensor(both.select(best_first), sensor_position, sensor_rotation), ids

    def _true_detections(
        self, seen: ObjectStates, returns: Floats, sensor_position: Floats, random: np.random.Generator
    ) -> tuple[Detections, Ints]:
        n = len(seen)
        # Draws are made for every object, detected or not, so that changing a parameter does not shift other draws.
        draws = independent_draws(n, random) if self.white else self._lasting_draws(seen, sensor_position, random)
        keep = (returns >= self.min_points) & (draws.detection < 1.0 - np.exp(-returns / self.points_scale))
        range_m = np.linalg.norm(seen.position - sensor_position, axis=1)
        growth = np.sqrt(1.0 + (range_m / self.range_scale_m) ** 2 + self.few_points / np.maximum(returns, 1.0))
        sigma = growth[:, None] * [self.position_noise_m, self.position_noise_m, self.vertical_noise_m]
        size_error = np.clip(
            draws.noise[:, 3:6] * (self.size_noise_m * growth)[:, None], -0.3 * seen.size, 0.3 * seen.size
        )
        flipped = draws.flip < self.flip_probability
        yaw_error = draws.noise[:, 6] * np.radians(self.yaw_noise_deg) * growth + np.pi * flipped
        covariance = np.zeros((n, 3, 3))
        if self.report_covariance:
            covariance[:, [0, 1, 2], [0, 1, 2]] = sigma**2
        detections = Detections(
            seen.position + draws.noise[:, :3] * sigma,
            seen.size + size_error,
            wrap_angle(seen.yaw + yaw_error),
            self._scores(returns, draws.score),
            np.where(draws.wrong < self.wrong_class, draws.other_class, seen.class_id).astype(np.uint8),
            covariance,
        )
        return detections.select(keep), seen.id[keep]

    def _lasting_draws(self, seen: ObjectStates, sensor_position: Floats, random: np.random.Generator) -> Draws:
        """The draws for objects in the order of their ids."""
        from scipy.special import ndtr  # nodes import this module, and this takes 0.3 s

        n = len(seen)
        fresh = random.standard_normal((n, _UNIFORMS + _NOISES))
        white = random.standard_normal((n, _NOISES))
        numbers = self._wandering.step(seen.id, fresh)
        uniform = ndtr(numbers[:, :_UNIFORMS])
        classes = np.minimum(1 + uniform[:, 4] * (len(CLASSES) - 1), len(CLASSES) - 1).astype(np.int64)
        wandering_share = max(1.0 - self.white_share - self.view_share, 0.0)
        noise = np.sqrt(wandering_share) * numbers[:, _UNIFORMS:] + np.sqrt(self.white_share) * white
        if self.view_share > 0.0:
            noise += np.sqrt(self.view_share) * self._view_errors(seen, sensor_position, random)
        detection, flip, wrong, score = uniform[:, :4].T
        return Draws(detection, flip, wrong, score, noise, classes)

    def _view_errors(self, seen: ObjectStates, sensor_position: Floats, random: np.random.Generator) -> Floats:
        """(n, 7) standard normal numbers that stay with an object and the angle from which it is seen; x, y: world."""
        to_viewer = sensor_position - seen.position
        errors = self._view.at(seen.id, np.arctan2(to_viewer[:, 1], to_viewer[:, 0]) - seen.yaw, random)
        forward, left = errors[:, 0].copy(), errors[:, 1].copy()
        errors[:, 0] = np.cos(seen.yaw) * forward - np.sin(seen.yaw) * left
        errors[:, 1] = np.sin(seen.yaw) * forward + np.cos(seen.yaw) * left
        return errors

    def _scores(self, returns: Floats, draw: Floats) -> Floats:
        """(n,) scores of detected objects, from their lidar returns and uniform draws."""
        return self.score[0] + (self.score[1] - self.score[0]) * draw

    def _clutter(self, viewpoint: _Viewpoint, random: np.random.Generator) -> Detections:
        if self.white:
            return self._new_clutter(int(random.poisson(self.clutter_rate)), viewpoint, random)
        clutter = Detections.joined([self._standing_clutter(kind, viewpoint, random) for kind in self._clutter_kinds])
        jitter = random.standard_normal((len(clutter), 3)) * np.sqrt(self.white_share)
        jitter *= [self.position_noise_m, self.position_noise_m, self.vertical_noise_m]
        return replace(clutter, position=clutter.position + jitter)

    def _standing_clutter(self, kind: _ClutterKind, viewpoint: _Viewpoint, random: np.random.Generator) -> Detections:
        """The clutter of a kind in the next frame, world frame: what stays from the frame before, and what is new."""
        before = Detections.empty() if kind.standing is None else kind.standing
        survival = 0.0 if kind.standing is None else kind.survival
        lasts = random.random(len(before)) < survival
        lasts &= viewpoint.in_view(before.position)
        lasts &= np.linalg.norm(before.position - viewpoint.position, axis=1) <= self.clutter_range_m
        count = int(random.poisson(self.clutter_rate * kind.share * (1.0 - survival)))
        new = self._new_clutter(count, viewpoint, random)
        kind.standing = Detections.joined([before.select(lasts), self._scored_clutter(new, random)])
        return kind.standing

    def _scored_clutter(self, new: Detections, random: np.random.Generator) -> Detections:
        """New clutter with its scores; here the uniform ones that it has already."""
        return new

    def _new_clutter(self, n: int, viewpoint: _Viewpoint, random: np.random.Generator) -> Detections:
        """Up to n false detections in view, world frame."""
        if n == 0:
            return Detections.empty()
        kind = random.choice(len(_CLUTTER_SHARES), size=n, p=_CLUTTER_SHARES)
        size = _CLUTTER_SIZES[kind] * random.uniform(0.9, 1.1, (n, 3))
        yaw = random.uniform(-np.pi, np.pi, n)
        score = random.uniform(*self.clutter_score, n)
        # Uniform over the disc: the first of several candidates that is in view.
        radius = self.clutter_range_m * np.sqrt(random.random((n, _CLUTTER_CANDIDATES)))
        bearing = random.uniform(-np.pi, np.pi, (n, _CLUTTER_CANDIDATES))
        position = np.empty((n, _CLUTTER_CANDIDATES, 3))
        position[..., 0] = viewpoint.position[0] + radius * np.cos(bearing)
        position[..., 1] = viewpoint.position[1] + radius * np.sin(bearing)
        position[..., 2] = viewpoint.ground + size[:, 2:] / 2
        visible = viewpoint.in_view(position.reshape(-1, 3)).reshape(n, _CLUTTER_CANDIDATES)
        rows, first = np.arange(n), visible.argmax(axis=1)
        chosen = position[rows, first]
        covariance = np.zeros((n, 3, 3))
        if self.report_covariance:
            distance = np.linalg.norm(chosen - viewpoint.position, axis=1)
            growth = 1.0 + (distance / self.range_scale_m) ** 2 + self.few_points / self.points_scale
            variance = np.array([self.position_noise_m, self.position_noise_m, self.vertical_noise_m]) ** 2
            covariance[:, [0, 1, 2], [0, 1, 2]] = growth[:, None] * variance
        clutter = Detections(chosen, size, yaw, score, _CLUTTER_CLASSES[kind], covariance)
        return clutter.select(visible[rows, first])


_MAX_STRENGTH = 1.5  # of an object's returns in the logit of its score, up and down


@dataclass(kw_only=True, eq=False)
class LastingErrors(DetectionModel):
    """`DetectionModel`, with misses and clutter that last longer, errors that only wander, and weak scores.

    In one frame, errors and misses have the distributions of a `DetectionModel` with the same parameters. No part of an
    error stays with the object and the viewing angle, and there are no blips.

    The score of an object is the logistic function of a normal number, with mean `score_at_scale` plus the logarithm of
    its returns relative to `points_scale`, limited to 1.5 up and down; that of clutter has the mean
    `clutter_score_mean`. The defaults are like the raw output of real detectors, which has many weak false detections;
    docs/how-to-scenes.md has recall and precision.

    score_at_scale, clutter_score_mean, score_std: mean and standard deviation of the logit of scores
    The other parameters are those of `DetectionModel`, except for `white` and the scores.
    """

    points_scale: float = 30.0
    clutter_rate: float = 4.0
    report_covariance: bool = False
    white: bool = field(default=False, init=False)
    score: tuple[float, float] = field(default=(0.0, 1.0), init=False)
    clutter_score: tuple[float, float] = field(default=(0.0, 1.0), init=False)
    view_share: float = 0.0
    white_share: float = 0.4
    error_s: float = 1.0
    miss_s: float = 0.6
    clutter_s: float = 0.5
    lasting_clutter: float = 1.0
    score_at_scale: float = 0.6
    clutter_score_mean: float = -1.2
    score_std: float = 0.8

    def __post_init__(self) -> None:
        super().__post_init__()
        check("0 or more", score_std=self.score_std)

    def _scores(self, returns: Floats, draw: Floats) -> Floats:
        from scipy.special import expit, ndtri

        strength = np.clip(np.log(returns / self.points_scale), -_MAX_STRENGTH, _MAX_STRENGTH)
        scores: Floats = expit(self.score_at_scale + strength + self.score_std * ndtri(np.clip(draw, 1e-9, 1 - 1e-9)))
        return scores

    def _scored_clutter(self, new: Detections, random: np.random.Generator) -> Detections:
        logit = self.clutter_score_mean + self.score_std * random.standard_normal(len(new))
        return replace(new, score=1.0 / (1.0 + np.exp(-logit)))


#: Harmonics of an error over the viewing angle, besides its mean: enough for angles of 30 degrees and more.
_HARMONICS = 6


class WanderingNumbers:
    """Standard normal numbers of objects, each a stationary first-order autoregressive process.

    Uhlenbeck and Ornstein, On the theory of the Brownian motion, 1930. An object that was out of view begins anew.

    keep: (k,) correlation of each number with that of the frame before
    """

    def __init__(self, keep: Floats) -> None:
        self._keep = keep
        self._ids: Ints = np.zeros(0, np.int64)
        self._numbers: Floats = np.zeros((0, len(keep)))

    def step(self, ids: Ints, fresh: Floats) -> Floats:
        """The numbers (n, k) in the next frame. ids: (n,) ascending; fresh: (n, k) independent standard normal"""
        row = np.minimum(np.searchsorted(self._ids, ids), max(len(self._ids) - 1, 0))
        known = self._ids[row] == ids if len(self._ids) else np.zeros(len(ids), np.bool_)
        numbers = fresh.copy()
        numbers[known] = self._keep * self._numbers[row[known]] + np.sqrt(1.0 - self._keep**2) * fresh[known]
        self._ids, self._numbers = ids.copy(), numbers
        return numbers


class ViewErrors:
    """Standard normal numbers of objects that are smooth functions of the viewing angle, each object with its own.

    At two viewing angles, they correlate by about exp(-(difference / width)^2 / 2).

    count: numbers of an object; width_rad: rad
    """

    def __init__(self, count: int, width_rad: float) -> None:
        self._count = count
        order = np.arange(_HARMONICS + 1)
        power = np.exp(-((order * width_rad) ** 2) / 2.0) * np.where(order == 0, 1.0, 2.0)
        self._amplitude = np.sqrt(power / power.sum())
        self._key: int | None = None
        self._functions: dict[int, Floats] = {}

    def at(self, ids: Ints, angle: Floats, random: np.random.Generator) -> Floats:
        """The numbers (n, count) of objects with `ids` (n,), seen at an `angle` (n,) rad. random: of the frame

        An object has the same function whenever it is seen: it follows from its id and the `random` of the first frame.
        """
        if self._key is None:
            self._key = int(random.spawn(1)[0].integers(2**63))  # spawned, so that no other draw is another one
        known = self._functions
        self._functions = {each: known[each] if each in known else self._function(each) for each in ids.tolist()}
        if not len(ids):
            return np.zeros((0, self._count))
        phase = np.arange(_HARMONICS + 1) * angle[:, None]
        waves = np.concatenate([self._amplitude * np.cos(phase), self._amplitude * np.sin(phase)], axis=1)
        return np.asarray(np.einsum("ncw,nw->nc", np.stack(list(self._functions.values())), waves))

    def _function(self, number: int) -> Floats:
        """(count, waves) coefficients of an object."""
        assert self._key is not None
        return stream(self._key, number).standard_normal((self._count, 2 * (_HARMONICS + 1)))
