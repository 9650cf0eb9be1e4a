"""How a car moves: the bicycle model, which command it carries out, and what is comfortable."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.geometry import distance_along
from mast_zenoh.arrays.states import Bools, Floats


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

    acceleration: m/s², at most; braking: m/s², on dry asphalt; curvature: 1/m, with the steering wheel turned fully

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


#: s, until which a world's cars drive as in the prepared scene, and for which a car without commands goes on as it was
#: told, if a scenario says nothing else.
TAKE_OVER_S, HOLD_S = 1.0, 0.3


class Actuation:
    """What one car does with the commands that it gets.

    A command of a frame acts in the next one. If that one has no command, because it is late, lost or refused, the car
    goes on as the newest command said, for at most `hold_frames` frames; then it brakes along its last curvature,
    until a newer command arrives. A late command acts when it arrives, if it is new enough to be held.

    limits: of the car; braking: m/s^2, of a car without commands, if it can
    counts: of frames, by what the car did: "commanded", "held", "braked"; and of refused commands, "refused"
    """

    def __init__(self, limits: CarLimits, hold_frames: int, braking: float) -> None:
        self.limits, self.hold_frames, self.braking = limits, hold_frames, min(braking, limits.braking)
        self.counts: Counter[str] = Counter(commanded=0, held=0, braked=0, refused=0)
        self._newest: tuple[int, Command] | None = None

    def receive(self, frame: int, now: int, command: Command) -> str:
        """Take a command of a frame; returns the reason why it is refused, or "". now: the current frame"""
        reason = self._refusal(frame, now, command)
        if reason:
            self.counts["refused"] += 1
        else:
            self._newest = frame, command
        return reason

    def _refusal(self, frame: int, now: int, command: Command) -> str:
        if frame > now:
            return f"early: command of frame {frame}, which has not begun"
        if self._newest is not None and frame <= self._newest[0]:
            return f"old: command of frame {frame} after that of frame {self._newest[0]}"
        return self.limits.refusal(command)

    def obeyed(self, frame: int) -> int:
        """The frame whose command the car carries out from the frame before until `frame`; -1: of none, it brakes."""
        if self._newest is None or frame - 1 - self._newest[0] > self.hold_frames:
            return -1
        return self._newest[0]

    def act(self, frame: int) -> Command:
        """What the car does from the frame before until `frame`."""
        _, newest = self._newest or (-1, Command(0.0, 0.0))
        sent = self.obeyed(frame)
        if sent < 0:
            self.counts["braked"] += 1
            return Command(-self.braking, newest.curvature)
        self.counts["held" if sent < frame - 1 else "commanded"] += 1
        return newest


#: Bounds of comfort by name: the least and the greatest m/s^2, m/s^3, rad/s or rad/s^2. Source: the comfort metric of
#: nuPlan (Caesar et al., NuPlan: A closed-loop ML-based planning benchmark for autonomous vehicles, 2021).
COMFORT = {
    "braking": (-4.05, np.inf),
    "acceleration": (-np.inf, 2.40),
    "lateral_acceleration": (-4.89, 4.89),
    "jerk": (-8.37, 8.37),
    "longitudinal_jerk": (-4.13, 4.13),
    "yaw_rate": (-0.95, 0.95),
    "yaw_acceleration": (-1.93, 1.93),
}
#: m/s^2; harder braking is not comfortable.
HARD_BRAKING_MPS2 = -COMFORT["braking"][0]


def uncomfortable(name: str, values: Floats) -> Bools:
    """Whether values of any shape are beyond a bound of COMFORT."""
    least, most = COMFORT[name]
    return np.asarray((values < least) | (values > most))
