"""What passengers find comfortable: the bounds of nuPlan."""

from __future__ import annotations

import numpy as np

from mast_zenoh.arrays.states import Bools, Floats

#: Bounds of comfort by name: the least and the greatest m/s^2, m/s^3, rad/s or rad/s^2. Source: the comfort metric of
#: nuPlan (Caesar et al., NuPlan: A closed-loop ML-based planning benchmark for autonomous vehicles, 2021).
COMFORT = {
    "braking": (-4.05, np.inf),
    "acceleration": (-np.inf, 2.40),
    "lateral_acceleration": (-4.89, 4.89),
    "jerk": (-8.37, 8.37),
    "longitudinal_jerk": (-4.13, 4.13),
    "yaw_rate": (-0.95, 0.95),
    "yaw_acceleration": (-1.93, 1.93),
}
#: m/s^2; harder braking is not comfortable.
HARD_BRAKING_MPS2 = -COMFORT["braking"][0]


def uncomfortable(name: str, values: Floats) -> Bools:
    """Whether values of any shape are beyond a bound of COMFORT."""
    least, most = COMFORT[name]
    return np.asarray((values < least) | (values > most))
