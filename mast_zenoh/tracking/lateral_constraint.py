"""What rolls moves along its heading."""

from __future__ import annotations

import numpy as np

from mast_zenoh.arrays.states import Floats
from mast_zenoh.kernels import kernel
from mast_zenoh.tracking.classes import ROLLS
from mast_zenoh.tracking.heading import FORWARD, TURN_LIMIT, settle_sense
from mast_zenoh.tracking.kalman import BoxFilter
from mast_zenoh.tracking.tracks import LATERAL_RESIDUAL, YAW, YAW_VARIANCE, classes_of, planar

#: m/s, slip of a rolling object across its heading, as in a tight turn, where the box's centre is not the turning one.
SLIP = 0.5
#: Share that a new surprise has in its running mean: of about the last five.
ASIDE_SHARE = 0.2
#: s: a mean surprise of 15 cm to one side stands for a sideways speed of 1 m/s that the filter does not believe in.
ASIDE_S = 0.15
#: (m/s)^2 by class, variance that leaves the speed across to what does not roll.
_FREE = np.where(ROLLS, 0.0, 1e9)


def roll(box_filter: BoxFilter, tracks: Floats, surprise: Floats) -> None:
    """Measure the speed of `tracks` across their headings as zero, with a slip and the heading for its error.

    surprise: (n, 2) m, measured less predicted position. If it keeps pointing to one side, the heading is wrong.
    """
    box_filter.correct_speed(tracks, *across(tracks, surprise, _FREE, SLIP, ASIDE_SHARE, ASIDE_S))
    settle_sense(tracks, FORWARD, TURN_LIMIT)


@kernel
def across(
    tracks: Floats, surprise: Floats, free: Floats, slip: float, share: float, aside_s: float
) -> tuple[Floats, Floats]:
    """(n, 2) unit vectors across the headings, and (n,) (m/s)^2 how far the speed along them is from zero.

    free: by class, (m/s)^2 that are added; slip, share, aside_s: SLIP, ASIDE_SHARE, ASIDE_S
    """
    # Vectors in the plane as complex numbers: times the conjugate of the heading's, they are along and across it.
    heading = np.exp(1j * tracks[:, YAW])
    aside = tracks[:, LATERAL_RESIDUAL]
    aside += share * ((planar(surprise) * heading.conj()).imag - aside)
    speed = np.abs(planar(tracks[:, 6:8]))
    variance = slip**2 + (aside / aside_s) ** 2 + speed * speed * tracks[:, YAW_VARIANCE]
    variance += free.take(classes_of(tracks))
    return (1j * heading).view(np.float64).reshape(len(tracks), 2), variance
