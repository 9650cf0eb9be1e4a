"""Non-holonomic constraint: wheeled objects move along their heading."""

from __future__ import annotations

import numpy as np

from mast_zenoh.arrays.states import Floats
from mast_zenoh.kernels import kernel
from mast_zenoh.tracking.classes import WHEELED
from mast_zenoh.tracking.kalman import BoxFilter
from mast_zenoh.tracking.tracks import LATERAL_RESIDUAL, YAW, YAW_VARIANCE, classes_of, planar

#: m/s, lateral slip of a wheeled object, as in a tight turn about a point other than the box's centre.
SLIP = 0.5
#: Weight of a new residual in the running mean, which spans about five.
RESIDUAL_WEIGHT = 0.2
#: s: a mean lateral residual of 15 cm indicates an unmodelled lateral speed of 1 m/s.
RESIDUAL_S = 0.15
#: (m/s)^2 by class, variance that disables the constraint for objects without wheels.
_UNCONSTRAINED = np.where(WHEELED, 0.0, 1e9)


def constrain_lateral_speed(box_filter: BoxFilter, tracks: Floats, innovation: Floats) -> None:
    """Correct `tracks` by a measured lateral speed of zero.

    The variance follows from slip and heading uncertainty.

    innovation: (n, 2) m, measured minus predicted position. A persistent lateral bias indicates a wrong heading.
    """
    direction, variance = lateral_constraint(tracks, innovation, _UNCONSTRAINED, SLIP, RESIDUAL_WEIGHT, RESIDUAL_S)
    box_filter.correct_speed(tracks, direction, variance)


@kernel
def lateral_constraint(
    tracks: Floats, innovation: Floats, free: Floats, slip: float, share: float, time_s: float
) -> tuple[Floats, Floats]:
    """Lateral unit vectors (n, 2), and variances (n,) (m/s)^2 of the speed along them.

    free: by class, (m/s)^2, added variance; slip, share, time_s: SLIP, RESIDUAL_WEIGHT, RESIDUAL_S
    """
    # Planar vectors as complex numbers: multiplied by the conjugate of the heading, they are along and across it.
    heading = np.exp(1j * tracks[:, YAW])
    residual = tracks[:, LATERAL_RESIDUAL]
    residual += share * ((planar(innovation) * heading.conj()).imag - residual)
    speed = np.abs(planar(tracks[:, 6:8]))
    variance = slip**2 + (residual / time_s) ** 2 + speed * speed * tracks[:, YAW_VARIANCE]
    variance += free.take(classes_of(tracks))
    return (1j * heading).view(np.float64).reshape(len(tracks), 2), variance
