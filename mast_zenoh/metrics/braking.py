"""Braking rules: when a vehicle has to brake for objects in its corridor. Pure."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from mast_zenoh.arrays.states import Bools, Floats

#: m/s; a slower vehicle counts as stationary and need not brake.
STANDING_MPS = 0.3


def time_to_collision(gap_m: Floats, speed_mps: Floats, ahead_mps: Floats) -> Floats:
    """Time (n,) s until gaps close at constant speeds; inf if they do not."""
    closing = speed_mps - ahead_mps
    return np.where(closing > 1e-9, gap_m / np.maximum(closing, 1e-9), np.inf)


class BrakingRule(ABC):
    """Base class of braking rules."""

    @abstractmethod
    def brakes(self, gap_m: Floats, speed_mps: Floats, ahead_mps: Floats) -> Bools:
        """(n,) bool, whether to brake for each of n objects.

        gap_m:     (n,) m along the path, from the vehicle's front to the object, 0 or more
        speed_mps: (n,) m/s, of the vehicle along its path, 0 or more
        ahead_mps: (n,) m/s, of the object along the vehicle's path; negative: it approaches
        """


class SafeDistance(BrakingRule):
    """Brake below the minimum safe longitudinal distance.

    The distance is defined by Responsibility-Sensitive Safety.

    Source: Shalev-Shwartz, Shammah and Shashua, On a Formal Model of Safe and Scalable Self-driving Cars (2017),
    Definition 1: the vehicle accelerates for its response time, then brakes with at least its minimum deceleration; the
    object ahead brakes with its maximum deceleration. Approaching objects count as stationary.

    response_s: s, response time;  acceleration: m/s2, maximum during the response time
    braking:    m/s2, minimum of the vehicle after it;  braking_ahead: m/s2, maximum of the object ahead
    """

    def __init__(
        self,
        *,
        response_s: float = 0.5,
        acceleration: float = 2.0,
        braking: float = 4.0,
        braking_ahead: float = 8.0,
    ) -> None:
        for name, value in (("response_s", response_s), ("acceleration", acceleration)):
            if not 0.0 <= value < np.inf:
                raise ValueError(f"{name}: found {value}, expected 0 or more")
        for name, value in (("braking", braking), ("braking_ahead", braking_ahead)):
            if not 0.0 < value < np.inf:
                raise ValueError(f"{name}: found {value}, expected more than 0")
        self.response_s, self.acceleration = response_s, acceleration
        self.braking, self.braking_ahead = braking, braking_ahead

    def brakes(self, gap_m: Floats, speed_mps: Floats, ahead_mps: Floats) -> Bools:
        response, final_speed = self.response_s, speed_mps + self.response_s * self.acceleration
        own_m = speed_mps * response + self.acceleration * response**2 / 2.0 + final_speed**2 / (2.0 * self.braking)
        ahead_m = np.maximum(ahead_mps, 0.0) ** 2 / (2.0 * self.braking_ahead)
        return np.asarray((speed_mps > STANDING_MPS) & (gap_m < np.maximum(own_m - ahead_m, 0.0)))


class TimeToCollision(BrakingRule):
    """Brake when the time to collision at constant speeds is below a threshold.

    Sources: Hayward, Near-miss determination through use of a scale of danger (Highway Research Record 384, 1972); the
    threshold is from van der Horst, A time-based analysis of road user behaviour in normal and critical encounters
    (TU Delft, 1990), below which an encounter is critical.

    threshold_s: s
    """

    def __init__(self, *, threshold_s: float = 1.5) -> None:
        if not 0.0 < threshold_s < np.inf:
            raise ValueError(f"threshold_s: found {threshold_s}, expected more than 0")
        self.threshold_s = threshold_s

    def brakes(self, gap_m: Floats, speed_mps: Floats, ahead_mps: Floats) -> Bools:
        moving = speed_mps > STANDING_MPS
        return np.asarray(moving & (time_to_collision(gap_m, speed_mps, ahead_mps) < self.threshold_s))
