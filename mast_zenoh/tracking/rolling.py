"""What rolls moves along its heading."""

from __future__ import annotations

import numpy as np

from mast_zenoh.states import Floats
from mast_zenoh.tracking.classes import ROLLS
from mast_zenoh.tracking.heading import settle_sense
from mast_zenoh.tracking.kalman import BoxFilter
from mast_zenoh.tracking.tracks import ASIDE, YAW, YAW_VARIANCE, classes_of, planar

#: m/s, slip of a rolling object across its heading, as in a tight turn, where the box's centre is not the turning one.
SLIP = 0.5
#: Share that a new surprise has in its running mean: of about the last five.
ASIDE_SHARE = 0.2
#: s: a mean surprise of 15 cm to one side stands for a sideways speed of 1 m/s that the filter does not believe in.
ASIDE_S = 0.15
#: (m/s)^2 by class, variance that leaves the speed across to what does not roll.
_FREE = np.where(ROLLS, 0.0, 1e9)


def roll(
    box_filter: BoxFilter, tracks: Floats, mean: Floats, covariance: Floats, surprise: Floats
) -> tuple[Floats, Floats]:
    """`mean` (n, 9) and `covariance` (n, 9, 9) of `tracks` after the speed across the heading was measured as zero.

    What was measured has a slip for its error, and what the heading is off.
    surprise: (n, 2) m, measured less predicted position. If it keeps pointing to one side, the heading is wrong.
    """
    # Vectors in the plane as complex numbers: times the conjugate of the heading's, they are along and across it.
    heading = np.exp(1j * tracks[:, YAW])
    back = heading.conj()
    aside = tracks[:, ASIDE]
    aside += ASIDE_SHARE * ((planar(surprise) * back).imag - aside)
    speed = np.abs(planar(mean[:, 6:8]))
    slip = SLIP**2 + (aside * (1.0 / ASIDE_S)) ** 2 + speed * speed * tracks[:, YAW_VARIANCE]
    slip += _FREE.take(classes_of(tracks))
    across = (1j * heading).view(np.float64).reshape(len(tracks), 2)
    mean, covariance = box_filter.correct_speed(mean, covariance, across, slip)
    settle_sense(tracks, (planar(mean[:, 6:8]) * back).real)
    return mean, covariance
