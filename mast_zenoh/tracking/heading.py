"""The heading of tracks: measured up to half a turn, smoothed, its sense decided by evidence."""

from __future__ import annotations

import numpy as np

from mast_zenoh.geometry import wrap_angle
from mast_zenoh.states import Floats
from mast_zenoh.tracking.tracks import Tracks

#: How much evidence for one sense is remembered, in measurements.
TURN_LIMIT = 5.0


def correct_heading(tracks: Tracks, yaw: Floats, variance: float) -> None:
    """Correct the headings by measured ones (n,) of `variance` rad^2.

    A measured heading may be the wrong way round: its axis corrects the heading, its sense is one vote on which end is
    the front.
    """
    innovation = wrap_angle(yaw - tracks["yaw"])
    agrees = np.abs(innovation) <= 0.5 * np.pi
    innovation = np.where(agrees, innovation, innovation - np.copysign(np.pi, innovation))
    gain = tracks["yaw_variance"] / (tracks["yaw_variance"] + variance)
    tracks["yaw"] += gain * innovation
    tracks["yaw_variance"] *= 1.0 - gain
    tracks["turn"] += np.where(agrees, 1.0, -1.0)


def settle_sense(tracks: Tracks, min_speed: float) -> None:
    """Let the velocity of what moves faster than `min_speed` m/s along its axis vote on which end is the front.

    What is outvoted is turned round.
    """
    yaw, mean = tracks["yaw"], tracks["mean"]
    forward = mean[:, 6] * np.cos(yaw) + mean[:, 7] * np.sin(yaw)
    turn = tracks["turn"] + np.where(np.abs(forward) > min_speed, np.sign(forward), 0.0)
    tracks["yaw"] = wrap_angle(np.where(turn < 0.0, yaw + np.pi, yaw))
    tracks["turn"] = np.minimum(np.abs(turn), TURN_LIMIT)
