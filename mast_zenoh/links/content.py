"""Rules by which messages come with other content: a wrong clock or pose of the sender, flipped bits."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.states import Floats
from mast_zenoh.links.base import NANOSECONDS, Passage, Rule, expect, expect_part

MOST_FLIPS = 1000
FARTHEST_M = 1e5


class ClockSkew(Rule):
    """The sender's clock is wrong: so is the time in its messages' headers.

    offset_s: s, by how much it is ahead; drift: s per s, by how much more with every second since `at`.
    """

    fate = "altered"

    def __init__(self, offset_s: float, drift: float = 0.0, at: float = 0.0, until: float | None = None) -> None:
        super().__init__(at, until)
        expect("offset_s", offset_s, abs(offset_s) <= 1e6, "at most 1e6 s either way")
        expect("drift", drift, abs(drift) <= 1.0, "-1 to 1")
        self.offset_s, self.drift = offset_s, drift

    def restamps_s(self, duration_s: float) -> float:
        """See `Rule.restamps_s`."""
        return abs(self.offset_s) + abs(self.drift) * duration_s

    def apply(self, passage: Passage, row: Sequence[float]) -> tuple[Passage, ...]:
        """See `Rule.apply`."""
        ahead = round(self.offset_s * NANOSECONDS + self.drift * (passage.time_ns - self._from_ns))
        return (passage._replace(skew_ns=passage.skew_ns + ahead),)


class PoseError(Rule):
    """The sender is wrong about where it is: so is the frame of reference of its tracks.

    position_std_m, yaw_std_rad: m and rad, standard deviations of an error on x and y and of one in heading, drawn for
                                 each message
    bias_m, bias_yaw_rad:        m (x, y) and rad, an error that stays

    Messages that have no frame of reference (`origin` and `rotation`) pass as they are.
    """

    fate = "altered"
    draws = True
    displaces = True

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
        expect("position_std_m", position_std_m, 0.0 <= position_std_m <= FARTHEST_M, f"0 to {FARTHEST_M:g} m")
        expect("yaw_std_rad", yaw_std_rad, 0.0 <= yaw_std_rad <= math.tau, "0 to 2 pi")
        expect("bias_m", bias_m, all(abs(b) <= FARTHEST_M for b in bias_m), f"at most {FARTHEST_M:g} m either way")
        expect("bias_yaw_rad", bias_yaw_rad, abs(bias_yaw_rad) <= math.tau, "at most 2 pi either way")
        self._std = np.array([position_std_m, position_std_m, yaw_std_rad])
        self._bias = np.array([*bias_m, bias_yaw_rad])

    def sample(self, rng: np.random.Generator, count: int) -> Floats:
        """(count, 3) m, m, rad."""
        return self._bias + self._std * rng.standard_normal((count, 3))

    def apply(self, passage: Passage, row: Sequence[float]) -> tuple[Passage, ...]:
        """See `Rule.apply`."""
        if not passage.referenced:
            return (passage,)
        x, y = passage.shift
        return (passage._replace(shift=(x + row[0], y + row[1]), turn=passage.turn + row[2]),)


class Corrupt(Rule):
    """Some messages come with flipped bits, wherever in their bytes.

    probability: that a message does; flips: how many bits.
    """

    fate = "corrupted"
    draws = True

    def __init__(self, probability: float, flips: int = 1, at: float = 0.0, until: float | None = None) -> None:
        super().__init__(at, until)
        expect_part("probability", probability)
        expect("flips", flips, 1 <= flips <= MOST_FLIPS, f"1 to {MOST_FLIPS}")
        self.probability = probability
        self.flips = flips

    def sample(self, rng: np.random.Generator, count: int) -> Floats:
        """(count, 1 + flips) uniform from 0 to 1: whether, and where."""
        return rng.random((count, 1 + self.flips))

    def apply(self, passage: Passage, row: Sequence[float]) -> tuple[Passage, ...]:
        """See `Rule.apply`."""
        if row[0] >= self.probability:
            return (passage,)
        return (passage._replace(flips=(*passage.flips, *row[1:])),)


def flipped(payload: bytes, places: Sequence[float]) -> bytes:
    """The bytes with one bit flipped at each place, a part (0 to 1) of their length."""
    data = bytearray(payload)
    for place in places if data else ():
        bit = min(int(place * 8 * len(data)), 8 * len(data) - 1)
        data[bit // 8] ^= 1 << bit % 8
    return bytes(data)


def displaced(body: Mapping[str, NDArray[Any]], shift: tuple[float, float], turn: float) -> dict[str, NDArray[Any]]:
    """Columns with their frame of reference moved by `shift` m (x, y) and turned by `turn` rad about the vertical."""
    c, s = math.cos(turn / 2.0), math.sin(turn / 2.0)
    w, x, y, z = body["rotation"]
    turned = np.array([c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w])
    return {**body, "origin": body["origin"] + np.array([*shift, 0.0]), "rotation": turned}
