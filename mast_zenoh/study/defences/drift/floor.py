"""The least delay with which any detector can notice a displaced object. Pure.

A witness is an honest agent that sees the object. The differences between two agents' tracks of one object have a
standard deviation of TRACK_SD_M in each direction, and change so slowly that a second has INDEPENDENT_PER_S
independent ones (both measured on unattacked runs). A sequential test with one false alarm per hour must collect the
logarithm of the number of independent samples in an hour. Each sample of an offset of d metres adds
d^2 / (2 TRACK_SD_M^2) on average.

Several witnesses shorten the delay by the cube root of their number. For a drift this holds if the liar's own track is
exact. For a constant offset it is close to the factor 2 J / (J + 1) of J witnesses and a liar with the same noise: for
two to four witnesses, the two differ by 6 % at most.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from mast_zenoh.arrays.states import Floats

#: m, standard deviation in each direction of the difference between two honest tracks of one object.
TRACK_SD_M = 0.29
#: Independent differences per second.
INDEPENDENT_PER_S = 1.1
#: One false alarm per hour: what the sum of log-likelihood ratios must reach.
EVIDENCE = math.log(3600.0 * INDEPENDENT_PER_S)


def offset_floor_s(offset_m: float) -> float:
    """s until one witness can know of a constant offset; raises ValueError unless it is positive."""
    _check("offset_m", offset_m)
    return EVIDENCE / (INDEPENDENT_PER_S * offset_m**2 / (2.0 * TRACK_SD_M**2))


def drift_floor_s(rate_mps: float) -> float:
    """s until one witness can know of an offset that grows by `rate_mps`; raises ValueError unless it is positive.

    The evidence after t s is the integral of that of the offset: INDEPENDENT_PER_S rate^2 t^3 / (6 TRACK_SD_M^2).
    """
    _check("rate_mps", rate_mps)
    return math.cbrt(6.0 * TRACK_SD_M**2 * EVIDENCE / (INDEPENDENT_PER_S * rate_mps**2))


def speed_up(witnesses: ArrayLike) -> Floats:
    """(...) factor by which several witnesses shorten the delay; 0 without any, as nobody can ever know."""
    factor: Floats = np.cbrt(np.asarray(witnesses, np.float64))
    return factor


def _check(name: str, value: float) -> None:
    if not 0.0 < value < math.inf:
        raise ValueError(f"{name}: found {value}, expected more than 0")
