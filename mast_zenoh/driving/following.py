"""Car following: the intelligent driver model.

Source: Treiber, Hennecke and Helbing, Congested traffic states in empirical observations and microscopic simulations,
Physical Review E 62 (2000), equations 2 and 3; the constants are those of its table I.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.states import Floats

#: m, the least gap that is divided by.
_LEAST_GAP_M = 0.05


@dataclass(frozen=True, kw_only=True)
class IntelligentDriverModel:
    """How a driver keeps its speed and its distance.

    acceleration: m/s², from a standstill;  braking: m/s², comfortable
    headway_s:    s, behind the car ahead;   gap_m: m, at a standstill
    exponent:     of the speed

    Raises ValueError for a number that is not positive.
    """

    acceleration: float = 0.73
    braking: float = 1.67
    headway_s: float = 1.6
    gap_m: float = 2.0
    exponent: float = 4.0

    def __post_init__(self) -> None:
        check("more than 0, finite", acceleration=self.acceleration, braking=self.braking, headway_s=self.headway_s)
        check("more than 0, finite", gap_m=self.gap_m, exponent=self.exponent)

    def free(self, speed: Floats, desired: Floats) -> Floats:
        """Acceleration (n,) m/s^2 on a free road; a car that is too fast brakes comfortably at most.

        speed: (n,) m/s, 0 or more; desired: (n,) m/s, more than 0
        """
        free = self.acceleration * (1.0 - (speed / desired) ** self.exponent)
        return np.asarray(np.maximum(free, -self.braking))

    def interaction(self, speed: Floats, gap: Floats, ahead: Floats) -> Floats:
        """What a car ahead adds to the acceleration, (n,) m/s^2, 0 or less.

        speed: (n,) m/s, 0 or more; gap: (n,) m, bumper to bumper, inf without a car ahead
        ahead: (n,) m/s, of the car ahead, negative: it approaches
        """
        closing = speed * (speed - ahead) / (2.0 * np.sqrt(self.acceleration * self.braking))
        wanted = self.gap_m + np.maximum(speed * self.headway_s + closing, 0.0)
        return np.asarray(-self.acceleration * (wanted / np.maximum(gap, _LEAST_GAP_M)) ** 2)
