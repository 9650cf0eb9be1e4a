"""Rules that change detections: a blind sector, and detections of objects that are not there."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal

import numpy as np

from mast_zenoh.arrays.geometry import heading, rotation_from_yaw, wrap_angle
from mast_zenoh.arrays.states import CLASS_INDEX, Detections, Floats
from mast_zenoh.errors import nearest
from mast_zenoh.links.base import Passage, Rule, expect, expect_probability
from mast_zenoh.links.sensed import Sensed
from mast_zenoh.sensing import sensor_pose, to_sensor

MAX_GHOSTS = 100
_MAX_M = 1e5
#: Random numbers of one ghost in one frame: whether it is detected, its score, errors of position, size and yaw.
_DRAWS = 9
#: Errors grow as those of `DetectionModel`'s false detections: sqrt(1 + (range / _RANGE_SCALE_M)^2 + _FEW_POINTS). The
#: latter is its few_points / points_scale.
_RANGE_SCALE_M, _FEW_POINTS = 60.0, 0.4


class BlindSector(Rule):
    """A sector of the sensor is blind: its detections are lost, while the agent still claims to see there.

    azimuth_min_deg: deg, at which the sector begins, in the sensor's frame
    azimuth_max_deg: deg, at which it ends, counter-clockwise from there
    """

    fate = "edited"
    needs_detections = True

    def __init__(
        self, azimuth_min_deg: float, azimuth_max_deg: float, at: float = 0.0, until: float | None = None
    ) -> None:
        super().__init__(at, until)
        for name, value in (("azimuth_min_deg", azimuth_min_deg), ("azimuth_max_deg", azimuth_max_deg)):
            expect(name, value, -360.0 <= value <= 360.0, "-360 to 360")
        width = azimuth_max_deg - azimuth_min_deg
        expect("azimuth_max_deg", azimuth_max_deg, 0.0 < width <= 360.0, "up to 360 more than azimuth_min_deg")
        self._first, self._width = math.radians(azimuth_min_deg), math.radians(width)

    def apply(self, passage: Passage, row: Sequence[float]) -> tuple[Passage, ...]:
        if passage.sensed is None:
            return (passage,)
        detections = passage.sensed.detections
        azimuth = np.arctan2(detections.position[:, 1], detections.position[:, 0])
        lost = (azimuth - self._first) % (2.0 * np.pi) < self._width
        if not lost.any():
            return (passage,)
        return (passage._replace(sensed=passage.sensed._replace(detections=detections.select(~lost))),)


class GhostDetections(Rule):
    """The sensor detects objects that are not there, always at the same places: dirt, a reflection, a sign.

    places: m, (x, y, z) of the centre of each box: x ahead and y left of the sensor, level, or in the world; z is
            always that in the world
    frame:  "sensor": the ghosts move with the sensor; "world": they stay
    probability: that a ghost is detected in a frame
    size:    m, length, width and height
    yaw_rad: rad, heading: less the sensor's, or in the world
    kind:    class
    position_noise_m, vertical_noise_m, size_noise_m, yaw_noise_deg: standard deviations at the sensor, drawn for each
            frame; they grow with range as the shipped detector's do
    score:  (low, high), uniform

    Until the pose of its agent is known, in the first frame, there are none.
    """

    fate = "edited"
    draws = True
    needs_position = True
    needs_detections = True

    def __init__(
        self,
        places: tuple[tuple[float, float, float], ...],
        frame: Literal["sensor", "world"] = "world",
        probability: float = 0.9,
        size: tuple[float, float, float] = (4.5, 1.8, 1.5),
        yaw_rad: float = 0.0,
        kind: str = "car",
        position_noise_m: float = 0.28,
        vertical_noise_m: float = 0.1,
        size_noise_m: float = 0.1,
        yaw_noise_deg: float = 3.0,
        score: tuple[float, float] = (0.6, 1.0),
        at: float = 0.0,
        until: float | None = None,
    ) -> None:
        super().__init__(at, until)
        expect("places", places, 1 <= len(places) <= MAX_GHOSTS, f"1 to {MAX_GHOSTS} places (x, y, z)")
        inside = all(abs(value) <= _MAX_M for place in places for value in place)
        expect("places", places, inside, f"at most {_MAX_M:g} m either way")
        expect_probability("probability", probability)
        expect("size", size, len(size) == 3 and all(0.0 < value <= 100.0 for value in size), "three lengths in m")
        expect("yaw_rad", yaw_rad, abs(yaw_rad) <= math.tau, "at most 2 pi either way")
        expect("kind", kind, kind in CLASS_INDEX, f"a class{nearest(kind, CLASS_INDEX)}")
        noise = (
            position_noise_m,
            position_noise_m,
            vertical_noise_m,
            *(size_noise_m,) * 3,
            math.radians(yaw_noise_deg),
        )
        expect("noise", noise, all(0.0 <= value <= 100.0 for value in noise), "0 to 100")
        expect("score", score, 0.0 <= score[0] <= score[1] <= 1.0, "low and high, 0 to 1")
        self._places, self._frame = np.array(places, np.float64), frame
        self._probability, self._score = probability, score
        self._size, self._yaw, self._class = np.array(size, np.float64), yaw_rad, CLASS_INDEX[kind]
        self._noise = np.array(noise)

    def sample(self, rng: np.random.Generator, count: int) -> Floats:
        """Random numbers (count, ghosts * _DRAWS): two uniform and seven normal ones for each ghost."""
        n = len(self._places)
        uniform, normal = rng.random((count, n, 2)), rng.standard_normal((count, n, _DRAWS - 2))
        return np.concatenate([uniform, normal], axis=2).reshape(count, n * _DRAWS)

    def apply(self, passage: Passage, row: Sequence[float]) -> tuple[Passage, ...]:
        sensed = passage.sensed
        if sensed is None or sensed.pose is None:
            return (passage,)
        ghosts = self._ghosts(sensed, passage.time_ns, np.array(row).reshape(-1, _DRAWS))
        if not len(ghosts):
            return (passage,)
        together = [
            np.concatenate([real, false])
            for real, false in zip(sensed.detections.columns().values(), ghosts.columns().values(), strict=True)
        ]
        return (passage._replace(sensed=sensed._replace(detections=Detections(*together))),)

    def _ghosts(self, sensed: Sensed, time_ns: int, draws: Floats) -> Detections:
        """The ghosts that are detected, sensor frame."""
        assert sensed.pose is not None
        position, rotation = sensor_pose(*sensed.pose.at(time_ns), sensed.mount_position, sensed.mount_rotation)
        places, yaw, turn = self._places, self._yaw, float(heading(rotation))
        if self._frame == "sensor":
            level = rotation_from_yaw(turn)
            places = np.column_stack([position[:2] + (places @ level.T)[:, :2], places[:, 2]])
            yaw += turn
        distance = np.linalg.norm(places - position, axis=1)
        noise = self._noise * np.sqrt(1.0 + (distance / _RANGE_SCALE_M) ** 2 + _FEW_POINTS)[:, None]
        error = draws[:, 2:] * noise
        n = len(places)
        covariance = np.zeros((n, 3, 3))
        covariance[:, [0, 1, 2], [0, 1, 2]] = noise[:, :3] ** 2
        ghosts = Detections(
            places + error[:, :3],
            self._size + np.clip(error[:, 3:6], -0.3 * self._size, 0.3 * self._size),
            wrap_angle(yaw + error[:, 6]),
            self._score[0] + (self._score[1] - self._score[0]) * draws[:, 1],
            np.full(n, self._class, np.uint8),
            covariance,
        )
        return to_sensor(ghosts.select(draws[:, 0] < self._probability), position, rotation)
