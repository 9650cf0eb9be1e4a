"""Rules that change messages: clock and pose errors of the sender, flipped bits."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.states import Floats
from mast_zenoh.links.base import NANOSECONDS, Passage, Rule, expect, expect_probability

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
    draws = True
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


class Corrupt(Rule):
    """Flips bits of some messages at random positions.

    probability: that a message is corrupted; flips: number of bits.
    """

    fate = "corrupted"
    draws = True

    def __init__(self, probability: float, flips: int = 1, at: float = 0.0, until: float | None = None) -> None:
        super().__init__(at, until)
        expect_probability("probability", probability)
        expect("flips", flips, 1 <= flips <= MAX_FLIPS, f"1 to {MAX_FLIPS}")
        self.probability = probability
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
