"""Rules that change what is in messages: times, poses, bits and detections."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.geometry import heading, rotation_from_yaw, wrap_angle
from mast_zenoh.arrays.states import CLASS_INDEX, Detections, Floats
from mast_zenoh.errors import nearest
from mast_zenoh.links.base import NANOSECONDS, Passage, RandomRule, Rule, Sensed, expect, expect_probability
from mast_zenoh.sensing import sensor_pose, to_sensor

MAX_FLIPS = 1000
MAX_ERROR_M = 1e5


class ClockSkew(Rule):
    """An error of the sender's clock, and so of the time in its messages' headers.

    offset_s: s, positive if it is ahead; drift: s per s, growth of the offset since `at`.
    """

    fate = "altered"

    def __init__(self, offset_s: float, drift: float = 0.0, at: float = 0.0, until: float | None = None) -> None:
        super().__init__(at, until)
        expect("offset_s", offset_s, abs(offset_s) <= 1e6, "at most 1e6 s either way")
        expect("drift", drift, abs(drift) <= 1.0, "-1 to 1")
        self.offset_s, self.drift = offset_s, drift

    def restamps_s(self, duration_s: float) -> float:
        return abs(self.offset_s) + abs(self.drift) * duration_s

    def apply(self, passage: Passage, row: Sequence[float]) -> tuple[Passage, ...]:
        ahead = round(self.offset_s * NANOSECONDS + self.drift * (passage.time_ns - self._from_ns))
        return (passage._replace(skew_ns=passage.skew_ns + ahead),)


class PoseError(Rule):
    """An error of the sender's own pose, and so of the place of its tracks and of its view.

    position_std_m, yaw_std_rad: m and rad, standard deviations of the errors in x and y and in heading, drawn for each
                                 frame
    bias_m, bias_yaw_rad:        m (x, y) and rad, a constant error

    Tracks and views of a frame are moved alike: turned about the sender, then shifted. Other messages pass unchanged.
    """

    fate = "altered"
    of_sender = True
    needs_position = True
    needs_frame = True

    def __init__(
        self,
        position_std_m: float = 0.0,
        yaw_std_rad: float = 0.0,
        bias_m: tuple[float, float] = (0.0, 0.0),
        bias_yaw_rad: float = 0.0,
        at: float = 0.0,
        until: float | None = None,
    ) -> None:
        super().__init__(at, until)
        expect("position_std_m", position_std_m, 0.0 <= position_std_m <= MAX_ERROR_M, f"0 to {MAX_ERROR_M:g} m")
        expect("yaw_std_rad", yaw_std_rad, 0.0 <= yaw_std_rad <= math.tau, "0 to 2 pi")
        expect("bias_m", bias_m, all(abs(b) <= MAX_ERROR_M for b in bias_m), f"at most {MAX_ERROR_M:g} m either way")
        expect("bias_yaw_rad", bias_yaw_rad, abs(bias_yaw_rad) <= math.tau, "at most 2 pi either way")
        self._std = np.array([position_std_m, position_std_m, yaw_std_rad])
        self._bias = np.array([*bias_m, bias_yaw_rad])

    def sample(self, rng: np.random.Generator, count: int) -> Floats:
        """Errors (count, 3) in m, m, rad."""
        return self._bias + self._std * rng.standard_normal((count, 3))

    def apply(self, passage: Passage, row: Sequence[float]) -> tuple[Passage, ...]:
        if not passage.referenced:
            return (passage,)
        x, y = passage.shift
        return (passage._replace(shift=(x + row[0], y + row[1]), turn=passage.turn + row[2]),)


class Corrupt(RandomRule):
    """Flips bits of some messages at random positions.

    probability: that a message is corrupted; flips: number of bits.
    """

    fate = "corrupted"

    def __init__(self, probability: float, flips: int = 1, at: float = 0.0, until: float | None = None) -> None:
        super().__init__(probability, at, until)
        expect("flips", flips, 1 <= flips <= MAX_FLIPS, f"1 to {MAX_FLIPS}")
        self.flips = flips

    def sample(self, rng: np.random.Generator, count: int) -> Floats:
        """Uniform random numbers (count, 1 + flips): whether to flip, and the positions."""
        return rng.random((count, 1 + self.flips))

    def apply(self, passage: Passage, row: Sequence[float]) -> tuple[Passage, ...]:
        if row[0] >= self.probability:
            return (passage,)
        return (passage._replace(flips=(*passage.flips, *row[1:])),)


def flipped(payload: bytes, positions: Sequence[float]) -> bytes:
    """Flip one bit at each position, a fraction (0 to 1) of the length."""
    data = bytearray(payload)
    for position in positions if data else ():
        bit = min(int(position * 8 * len(data)), 8 * len(data) - 1)
        data[bit // 8] ^= 1 << bit % 8
    return bytes(data)


def has_frame(body: Mapping[str, NDArray[Any]]) -> bool:
    """Whether columns are relative to the sender's pose: a frame of reference, or a sensor's position and rotation."""
    return "rotation" in body and ("origin" in body or body["position"].shape == (3,))


def displaced(
    body: Mapping[str, NDArray[Any]], shift: tuple[float, float], turn: float, pivot: Floats | None = None
) -> dict[str, NDArray[Any]]:
    """Columns of a sender that believes to be (x, y) m farther, and turned by rad about z.

    body:  tracks with their frame of reference, or a view with its sensor's position (see `has_frame`)
    pivot: (3,) m, true position of the sender, about which it is turned; None: about the frame's own origin

    All messages of one sender are moved alike: the views stay where the tracks are.
    """
    c, s = math.cos(turn / 2.0), math.sin(turn / 2.0)
    w, x, y, z = body["rotation"]
    rotation = np.array([c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w])
    name = "origin" if "origin" in body else "position"
    place = body[name] + np.array([*shift, 0.0])
    if pivot is not None:
        east, north = (body[name] - pivot)[:2]
        c, s = math.cos(turn) - 1.0, math.sin(turn)
        place = place + np.array([c * east - s * north, s * east + c * north, 0.0])
    return {**body, name: place, "rotation": rotation}


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
