"""The heading of tracks: measured up to half a turn, smoothed, its sense decided by evidence."""

from __future__ import annotations

import numpy as np

from mast_zenoh.states import Floats
from mast_zenoh.tracking.tracks import TURN, YAW, YAW_VARIANCE

#: m/s along its axis above which an object is taken to move forward.
FORWARD = 2.0

#: How much evidence for one sense is remembered, in measurements.
TURN_LIMIT = 5.0


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


def settle_sense(tracks: Floats, along: Floats) -> None:
    """Let the speed (n,) `along` the heading, if more than FORWARD m/s, vote on which end is the front.

    What is outvoted is turned round.
    """
    turn = tracks[:, TURN]
    turn += along > FORWARD
    turn -= along < -FORWARD
    tracks[:, YAW] += np.pi * (turn < 0.0)
    tracks[:, TURN] = np.minimum(np.abs(turn), TURN_LIMIT)
