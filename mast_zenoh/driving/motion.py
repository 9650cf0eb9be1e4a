"""A car along its lane and beside it: the kinematic bicycle model, commands, and what a car can do."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.geometry import distance_along
from mast_zenoh.arrays.states import Floats


class Command(NamedTuple):
    """What a driver wants of its car until the next command.

    acceleration: m/s^2, along the car, negative: it brakes
    curvature:    1/m, of the way that the middle of the car drives, positive to the left
    """

    acceleration: float
    curvature: float


@dataclass(frozen=True, kw_only=True)
class CarLimits:
    """What a car can do.

    acceleration: m/s^2; braking: m/s^2, on dry asphalt; curvature: 1/m, with the steering wheel turned fully

    Raises ValueError for a limit that is not positive.
    """

    acceleration: float = 4.0
    braking: float = 9.0
    curvature: float = 0.2

    def __post_init__(self) -> None:
        check("more than 0, finite", acceleration=self.acceleration, braking=self.braking, curvature=self.curvature)

    def refusal(self, command: Command) -> str:
        """The reason why no driver of this car can mean a command, or ""."""
        if not -self.braking <= command.acceleration <= self.acceleration:
            expected = f"{-self.braking:g} to {self.acceleration:g} m/s^2"
            return f"absurd: acceleration is {command.acceleration:g}, expected {expected}"
        if not abs(command.curvature) <= self.curvature:
            expected = f"{-self.curvature:g} to {self.curvature:g} 1/m"
            return f"absurd: curvature is {command.curvature:g}, expected {expected}"
        return ""

    def nearest(self, acceleration: float, curvature: float) -> Command:
        """The command within the limits that is nearest to these values."""
        return Command(
            min(max(acceleration, -self.braking), self.acceleration),
            min(max(curvature, -self.curvature), self.curvature),
        )


@dataclass(frozen=True, eq=False)
class RouteAhead:
    """What a car's map and the traffic lights tell its driver.

    position: (k, 2) m, k >= 2 points in the middle of its lane, 1 m apart, from beside the car on
    speed:    (k,) m/s, greatest speed at each: the limit, and what the bends allow
    stop_m:   m from the car's front to where it has to stop; inf: nowhere
    """

    position: Floats
    speed: Floats
    stop_m: float

    @cached_property
    def along(self) -> Floats:
        """(k,) m, distance of each point from the first one, along the points."""
        return distance_along(self.position)


class LaneMotion(NamedTuple):
    """Where n cars are with respect to their lanes, after they drove a distance.

    along: (n,) m, progress along the lane; offset: (n,) m, of the middle of the car to the left of the lane's
    turn: (n,) rad, heading of the car minus that of the lane
    """

    along: Floats
    offset: Floats
    turn: Floats


#: m; a longer distance is driven in several steps.
_STEP_M = 0.25


def drive(offset: Floats, turn: Floats, distance: Floats, curvature: Floats, lane_curvature: Floats) -> LaneMotion:
    """Drive n cars over a distance (n,) m along lanes of a constant curvature (n,) 1/m.

    The kinematic bicycle model whose reference point is the middle of the car, in the coordinates of the lane:
    ds = cos(turn) / (1 - lane_curvature offset) dx, d(offset) = sin(turn) dx, d(turn) = curvature dx - lane_curvature
    ds, by Runge-Kutta steps of fourth order. Source: Rajamani, Vehicle Dynamics and Control (2012), chapter 2.

    offset, turn: (n,) before; curvature: (n,) 1/m, of the way of the car
    """
    steps = max(1, int(np.ceil(np.max(np.abs(distance), initial=0.0) / _STEP_M)))
    dx = distance / steps
    state = np.stack([np.zeros_like(offset), offset, turn])

    def slope(state: Floats) -> Floats:
        along = np.cos(state[2]) / np.maximum(1.0 - lane_curvature * state[1], 0.1)  # beyond the centre of a bend
        return np.stack([along, np.sin(state[2]), curvature - lane_curvature * along])

    for _ in range(steps):
        first = slope(state)
        second = slope(state + 0.5 * dx * first)
        third = slope(state + 0.5 * dx * second)
        fourth = slope(state + dx * third)
        state = state + dx / 6.0 * (first + 2.0 * second + 2.0 * third + fourth)
    return LaneMotion(*state)
