"""Prediction of other trackers' states: messages that arrive late describe where objects were."""

from __future__ import annotations

from mast_zenoh.arrays.states import ObjectStates, propagate
from mast_zenoh.tracking.classes import ACCELERATION, SIZE_DRIFT, VERTICAL_ACCELERATION
from mast_zenoh.tracking.kalman import process_noise


def predicted(states: ObjectStates, dt: float) -> ObjectStates:
    """n objects `dt` s later, or earlier if negative, at constant velocity.

    Their covariances grow as in the box tracker, by white acceleration of their class (Bar-Shalom, Li, Kirubarajan
    2001, section 6.2.2), in either direction of time.
    """
    if len(states) == 0 or dt == 0.0:
        return states
    noise = process_noise(abs(dt), ACCELERATION[states.class_id], VERTICAL_ACCELERATION, SIZE_DRIFT)
    moved = propagate(states, dt)
    return moved.with_(covariance=moved.covariance + noise)
