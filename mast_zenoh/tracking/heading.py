"""The heading of tracks: measured up to half a turn, smoothed, its sense decided by evidence."""

from __future__ import annotations

import numpy as np

from mast_zenoh.arrays.states import Floats
from mast_zenoh.kernels import kernel
from mast_zenoh.tracking.tracks import TURN, YAW, YAW_VARIANCE, planar

#: m/s along its axis above which an object is taken to move forward.
FORWARD = 2.0

#: How much evidence for one sense is remembered, in measurements.
TURN_LIMIT = 5.0


@kernel
def correct_heading(tracks: Floats, yaw: Floats, variance: float) -> None:
    """Correct the headings by measured ones (n,) of `variance` rad^2.

    A measured heading may be the wrong way round: its axis corrects the heading, its sense is one vote on which end is
    the front. Headings in the table may grow beyond a turn.
    """
    innovation = yaw - tracks[:, YAW]
    half_turns = np.rint(innovation * (1.0 / np.pi))
    innovation -= np.pi * half_turns
    before = tracks[:, YAW_VARIANCE]
    gain = before / (before + variance)
    tracks[:, YAW] += gain * innovation
    tracks[:, YAW_VARIANCE] = variance * gain
    tracks[:, TURN] += 1.0 - 2.0 * (half_turns % 2.0)


@kernel
def settle_sense(tracks: Floats, forward: float, limit: float) -> None:
    """Let the speed along the heading, if more than `forward` m/s, vote on which end is the front.

    What is outvoted is turned round. limit: how much evidence is remembered
    """
    along = (planar(tracks[:, 6:8]) * np.exp(-1j * tracks[:, YAW])).real
    turn = tracks[:, TURN]
    turn += along > forward
    turn -= along < -forward
    tracks[:, YAW] += np.pi * (turn < 0.0)
    tracks[:, TURN] = np.minimum(np.abs(turn), limit)
