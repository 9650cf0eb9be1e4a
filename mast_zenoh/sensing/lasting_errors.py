"""A detection model whose errors last: over several frames, as those of real detectors do."""

from __future__ import annotations

import copy
from dataclasses import replace

import numpy as np

from mast_zenoh.arrays.states import CLASSES, DETECTION_COLUMNS, Detections, Floats, Ints
from mast_zenoh.errors import ConfigurationError
from mast_zenoh.sensing.detection_model import DetectionModel, Draws
from mast_zenoh.sensing.detector import Detector
from mast_zenoh.sensing.lidar import LidarSensor, in_view

_MAX_STRENGTH = 1.5  # of an object's returns in the logit of its score, up and down
_NEVER_S = 3600.0  # time constant of what stays the same for an object: its heading's reversal, its class


class LastingErrors(DetectionModel):
    """`DetectionModel`, with errors, misses, scores and clutter that last.

    In one frame, they have the distributions of `DetectionModel`, except for the scores. From frame to frame, an
    object's errors follow a stationary first-order autoregressive process (Ornstein and Uhlenbeck 1930); an object
    that was out of view begins anew. Clutter stays where it is in the world.

    The score of an object is the logistic function of a normal number, with mean `score_at_scale` plus the logarithm of
    its returns relative to `points_scale`, limited to 1.5 up and down; that of clutter has the mean
    `clutter_score_mean`. The defaults are like the raw output of real detectors, which has many weak false detections:
    on generated junctions, a recall of 0.66 and a precision of 0.79, which is 0.92 above a score of 0.3.

    error_s:            s, time constant of position, size and yaw errors
    white_share:        share of their variance that is independent from frame to frame
    miss_s:             s, time constant of what decides whether an object is detected: misses come in episodes
    clutter_s:          s, mean duration of clutter, at the mean rate `clutter_rate`
    score_at_scale, clutter_score_mean, score_std: mean and standard deviation of the logit of scores
    parameters:         the other ones of `DetectionModel`
    """

    def __init__(
        self,
        *,
        error_s: float = 1.0,
        white_share: float = 0.4,
        miss_s: float = 0.6,
        clutter_s: float = 0.5,
        score_at_scale: float = 0.6,
        clutter_score_mean: float = -1.2,
        score_std: float = 0.8,
        clutter_rate: float = 4.0,
        position_noise_m: float = 0.28,
        points_scale: float = 30.0,
        clutter_range_m: float = 80.0,
        wrong_class: float = 0.02,
        report_covariance: bool = False,
    ) -> None:
        super().__init__(
            clutter_rate=clutter_rate,
            position_noise_m=position_noise_m,
            points_scale=points_scale,
            clutter_range_m=clutter_range_m,
            wrong_class=wrong_class,
            report_covariance=report_covariance,
        )
        for name, value in (("error_s", error_s), ("miss_s", miss_s), ("clutter_s", clutter_s)):
            if not value > 0:
                raise ConfigurationError(f"LastingErrors: {name} is {value}, expected more than 0")
        if not 0 <= white_share <= 1 or not score_std >= 0:
            found = f"white_share is {white_share} and score_std is {score_std}"
            raise ConfigurationError(f"LastingErrors: {found}, expected 0 to 1, and 0 or more")
        self.error_s = error_s
        self.white_share = white_share
        self.miss_s = miss_s
        self.clutter_s = clutter_s
        self.score_at_scale = score_at_scale
        self.clutter_score_mean = clutter_score_mean
        self.score_std = score_std
        self._forget(0.1)

    def _forget(self, period_s: float) -> None:
        """Begin anew, with a period s between frames."""
        self._period_s = period_s
        self._ids: Ints = np.zeros(0, np.int64)
        # Standard normal numbers of each object: detection, flip, wrong class, score, other class, seven of noise.
        self._constants_s = np.array([self.miss_s, _NEVER_S, _NEVER_S, self.miss_s, _NEVER_S, *[self.error_s] * 7])
        self._memory: Floats = np.zeros((0, len(self._constants_s)))
        self._standing: Detections | None = None  # clutter, world frame

    def begin(self, agent: str, sensor: str, period_s: float) -> Detector:
        mine = copy.copy(self)
        mine._forget(period_s)
        return mine

    def _draws(self, ids: Ints, random: np.random.Generator) -> Draws:
        from scipy.special import ndtr  # nodes import this module, and this takes 0.3 s

        n = len(ids)
        keep = np.exp(-self._period_s / self._constants_s)
        fresh = random.standard_normal((n, len(keep)))
        white = random.standard_normal((n, 7))
        row = np.minimum(np.searchsorted(self._ids, ids), max(len(self._ids) - 1, 0))
        known = self._ids[row] == ids if len(self._ids) else np.zeros(n, np.bool_)
        memory = fresh.copy()
        memory[known] = keep * self._memory[row[known]] + np.sqrt(1.0 - keep**2) * fresh[known]
        self._ids, self._memory = ids.copy(), memory
        uniform = ndtr(memory[:, :5])
        classes = np.minimum(1 + uniform[:, 4] * (len(CLASSES) - 1), len(CLASSES) - 1).astype(np.int64)
        noise = np.sqrt(1.0 - self.white_share) * memory[:, 5:] + np.sqrt(self.white_share) * white
        detection, flip, wrong, score = uniform[:, :4].T
        return Draws(detection, flip, wrong, score, noise, classes)

    def _scores(self, returns: Floats, draw: Floats) -> Floats:
        from scipy.special import expit, ndtri

        strength = np.clip(np.log(returns / self.points_scale), -_MAX_STRENGTH, _MAX_STRENGTH)
        scores: Floats = expit(self.score_at_scale + strength + self.score_std * ndtri(np.clip(draw, 1e-9, 1 - 1e-9)))
        return scores

    def _clutter(
        self,
        lidar: LidarSensor,
        sensor_position: Floats,
        sensor_rotation: Floats,
        ground: float,
        random: np.random.Generator,
    ) -> Detections:
        survival = np.exp(-self._period_s / self.clutter_s) if self._standing is not None else 0.0
        standing = Detections.empty() if self._standing is None else self._standing
        lasts = random.random(len(standing)) < survival
        lasts &= in_view(standing.position, sensor_position, sensor_rotation, lidar)
        lasts &= np.linalg.norm(standing.position - sensor_position, axis=1) <= self.clutter_range_m
        count = int(random.poisson(self.clutter_rate * (1.0 - survival)))
        new = self._new_clutter(count, lidar, sensor_position, sensor_rotation, ground, random)
        logit = self.clutter_score_mean + self.score_std * random.standard_normal(len(new))
        new = replace(new, score=1.0 / (1.0 + np.exp(-logit)))
        parts = [standing.select(lasts), new]
        columns = (np.concatenate([getattr(part, name) for part in parts]) for name in DETECTION_COLUMNS)
        self._standing = Detections(*columns)
        jitter = random.standard_normal((len(self._standing), 3)) * np.sqrt(self.white_share)
        jitter *= [self.position_noise_m, self.position_noise_m, self.vertical_noise_m]
        return replace(self._standing, position=self._standing.position + jitter)
