"""A statistical detection model: detections generated from lidar visibility."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.geometry import wrap_angle
from mast_zenoh.arrays.states import CLASS_INDEX, Detections, Floats, Ints, ObjectStates
from mast_zenoh.errors import ConfigurationError
from mast_zenoh.sensing.detector import Detector
from mast_zenoh.sensing.frames import to_sensor
from mast_zenoh.sensing.lidar import LidarSensor, in_view

#: Classes of clutter, with their probabilities and typical sizes (l, w, h) m.
_CLUTTER_KINDS = (
    ("car", 0.7, (4.5, 1.8, 1.5)),
    ("truck", 0.1, (8.0, 2.4, 3.0)),
    ("pedestrian", 0.2, (0.6, 0.6, 1.7)),
)

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


class DetectionModel(Detector):
    """A statistical detector: misses, noise, wrong classes and clutter.

    They are drawn from the number of lidar returns.

    An object with n >= min_points returns is detected with probability 1 - exp(-n / points_scale). Errors are normal,
    independent from frame to frame (`LastingErrors`: not), with the standard deviations below times

        sqrt(1 + (range / range_scale_m)^2 + few_points / n)

    along the axes of the world; size errors are limited to 30 % of the size. Clutter is Poisson, uniform over the
    ground in view up to `clutter_range_m`.

    The defaults approximate lidar detectors on two real cooperative data sets (0.3 to 0.6 m error per axis,
    about two false positives a frame, a precision of about 0.8, a recall of about 0.65): on the generated junctions
    they give 0.37 m, 2.5, 0.85 and 0.70. Real errors are correlated over time; these are not, see `LastingErrors`.

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
    """

    def __init__(
        self,
        *,
        min_points: int = 5,
        points_scale: float = 25.0,
        position_noise_m: float = 0.28,
        vertical_noise_m: float = 0.1,
        size_noise_m: float = 0.1,
        yaw_noise_deg: float = 3.0,
        range_scale_m: float = 60.0,
        few_points: float = 10.0,
        flip_probability: float = 0.0,
        wrong_class: float = 0.02,
        clutter_rate: float = 2.5,
        clutter_range_m: float = 80.0,
        score: tuple[float, float] = (0.6, 1.0),
        clutter_score: tuple[float, float] = (0.3, 0.8),
        report_covariance: bool = True,
    ) -> None:
        for name, value in (("points_scale", points_scale), ("range_scale_m", range_scale_m)):
            if not value > 0:
                raise ConfigurationError(f"DetectionModel: {name} is {value}, expected more than 0")
        noises = (position_noise_m, vertical_noise_m, size_noise_m, yaw_noise_deg, few_points, clutter_rate)
        if not all(each >= 0 for each in (*noises, clutter_range_m)):  # false for NaN, too
            raise ConfigurationError("DetectionModel: a noise, a rate or a range is negative, expected 0 or more")
        for name, value in (("flip_probability", flip_probability), ("wrong_class", wrong_class)):
            if not 0 <= value <= 1:
                raise ConfigurationError(f"DetectionModel: {name} is {value}, expected 0 to 1")
        for name, (low, high) in (("score", score), ("clutter_score", clutter_score)):
            if not 0 <= low <= high <= 1:
                raise ConfigurationError(f"DetectionModel: {name} is {(low, high)}, expected 0 <= low <= high <= 1")
        self.min_points = min_points
        self.points_scale = points_scale
        self.position_noise_m = position_noise_m
        self.vertical_noise_m = vertical_noise_m
        self.size_noise_m = size_noise_m
        self.yaw_noise_deg = yaw_noise_deg
        self.range_scale_m = range_scale_m
        self.few_points = few_points
        self.flip_probability = flip_probability
        self.wrong_class = wrong_class
        self.clutter_rate = clutter_rate
        self.clutter_range_m = clutter_range_m
        self.score = score
        self.clutter_score = clutter_score
        self.report_covariance = report_covariance

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
        clutter = self._clutter(lidar, sensor_position, sensor_rotation, ground, random)
        columns = [np.concatenate([getattr(detected, name), getattr(clutter, name)]) for name in detected.columns()]
        best_first = np.argsort(-columns[3], kind="stable")
        ids = np.concatenate([detected_id, np.full(len(clutter), -1, np.int64)])[best_first]
        detections = Detections(*columns).select(best_first)
        return to_sensor(detections, sensor_position, sensor_rotation), ids

    def _true_detections(
        self, seen: ObjectStates, returns: Floats, sensor_position: Floats, random: np.random.Generator
    ) -> tuple[Detections, Ints]:
        n = len(seen)
        # Draws are made for every object, detected or not, so that changing a parameter does not shift other draws.
        draws = self._draws(seen.id, random)
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

    def _draws(self, ids: Ints, random: np.random.Generator) -> Draws:
        """The draws for objects in the order of their ids."""
        return independent_draws(len(ids), random)

    def _scores(self, returns: Floats, draw: Floats) -> Floats:
        """(n,) scores of detected objects, from their lidar returns and uniform draws."""
        return self.score[0] + (self.score[1] - self.score[0]) * draw

    def _clutter(
        self,
        lidar: LidarSensor,
        sensor_position: Floats,
        sensor_rotation: Floats,
        ground: float,
        random: np.random.Generator,
    ) -> Detections:
        n = int(random.poisson(self.clutter_rate))
        return self._new_clutter(n, lidar, sensor_position, sensor_rotation, ground, random)

    def _new_clutter(
        self,
        n: int,
        lidar: LidarSensor,
        sensor_position: Floats,
        sensor_rotation: Floats,
        ground: float,
        random: np.random.Generator,
    ) -> Detections:
        """Up to n false detections in view, world frame."""
        if n == 0:
            return Detections.empty()
        kind = random.choice(len(_CLUTTER_KINDS), size=n, p=[share for _, share, _ in _CLUTTER_KINDS])
        size = np.array([size for _, _, size in _CLUTTER_KINDS])[kind] * random.uniform(0.9, 1.1, (n, 3))
        yaw = random.uniform(-np.pi, np.pi, n)
        score = random.uniform(*self.clutter_score, n)
        # Uniform over the disc: the first of several candidates that is in view.
        radius = self.clutter_range_m * np.sqrt(random.random((n, _CLUTTER_CANDIDATES)))
        bearing = random.uniform(-np.pi, np.pi, (n, _CLUTTER_CANDIDATES))
        position = np.empty((n, _CLUTTER_CANDIDATES, 3))
        position[..., 0] = sensor_position[0] + radius * np.cos(bearing)
        position[..., 1] = sensor_position[1] + radius * np.sin(bearing)
        position[..., 2] = ground + size[:, 2:] / 2
        visible = in_view(position.reshape(-1, 3), sensor_position, sensor_rotation, lidar).reshape(
            n, _CLUTTER_CANDIDATES
        )
        first = visible.argmax(axis=1)
        covariance = np.zeros((n, 3, 3))
        if self.report_covariance:
            distance = np.linalg.norm(position[np.arange(n), first] - sensor_position, axis=1)
            growth = 1.0 + (distance / self.range_scale_m) ** 2 + self.few_points / self.points_scale
            variance = np.array([self.position_noise_m, self.position_noise_m, self.vertical_noise_m]) ** 2
            covariance[:, [0, 1, 2], [0, 1, 2]] = growth[:, None] * variance
        classes = np.array([CLASS_INDEX[name] for name, _, _ in _CLUTTER_KINDS], np.uint8)
        clutter = Detections(position[np.arange(n), first], size, yaw, score, classes[kind], covariance)
        return clutter.select(visible[np.arange(n), first])
