"""Headings of tracks: filtered modulo half a turn; votes decide the front end."""

from __future__ import annotations

import numpy as np

from mast_zenoh.arrays.states import Floats, Ints
from mast_zenoh.kernels import kernel
from mast_zenoh.tracking.tracks import TURN, YAW, YAW_VARIANCE, planar

#: m/s along its axis above which an object is taken to move forward.
FORWARD = 2.0

#: Limit on the accumulated votes for one direction, in measurements.
TURN_LIMIT = 5.0


def correct_heading(tracks: Floats, yaw: Floats, variance: float) -> None:
    """Correct the headings by measured ones (n,) of `variance` rad^2.

    A measured heading may be reversed: its axis corrects the heading, its direction is one vote on which end is the
    front. Headings in the table may exceed a full turn.
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
def resolve_headings_and_store(table: Floats, rows: Ints, tracks: Floats, forward: float, limit: float) -> None:
    """Vote on the front ends of corrected tracks (k, WIDTH), then write them to the `rows` (k,) of the table.

    The vote is by the speed along the heading; outvoted tracks are reversed.

    forward: m/s, speed above which to vote; limit: on the accumulated votes
    """
    along = (planar(tracks[:, 6:8]) * np.exp(-1j * tracks[:, YAW])).real
    turn = tracks[:, TURN]
    turn += along > forward
    turn -= along < -forward
    tracks[:, YAW] += np.pi * (turn < 0.0)
    tracks[:, TURN] = np.minimum(np.abs(turn), limit)
    table[rows] = tracks
