"""Drivers: from what a car knows to what it does; and the veto of its own sensors."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field

import numpy as np

from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.matching import greedy_matching, neighbours
from mast_zenoh.arrays.states import Bools, Floats, Ints, ObjectStates, concatenate
from mast_zenoh.driving.corridor import along_route
from mast_zenoh.driving.following import IntelligentDriverModel
from mast_zenoh.driving.motion import CarLimits, Command, RouteAhead
from mast_zenoh.metrics.driving import BrakingRule, Driving, RoadUsers, TimeToCollision

#: s, the greatest age of an estimate that is used, if a scenario says nothing else.
ESTIMATE_AGE_S = 0.5


@dataclass(frozen=True, eq=False)
class Situation:
    """What a driver knows of one frame.

    time_ns:  ns, of the frame
    position: (3,) m, velocity: (3,) m/s, world frame, and heading: rad, of the car, as it believes
    size:     (2,) m, its length and width
    route:    its lane ahead
    objects:  n objects that it believes are there now, world frame; it may be one of them itself
    limits:   what the car can do
    """

    time_ns: int
    position: Floats
    velocity: Floats
    heading: float
    size: Floats
    route: RouteAhead
    objects: ObjectStates
    limits: CarLimits = field(default_factory=CarLimits)

    @property
    def speed(self) -> float:
        """m/s, of the car."""
        return float(np.hypot(self.velocity[0], self.velocity[1]))


class Driver(ABC):
    """Base class of drivers. A subclass takes its parameters as keywords."""

    @abstractmethod
    def drive(self, situation: Situation) -> Command:
        """What the car is to do until the next frame.

        The command must be within the limits of the situation: the car refuses any other. The result must not depend on
        the order of the objects.
        """


#: m, places of a stopped car's front before the line.
BEFORE_LINE_M = 0.8


class FollowingDriver(Driver):
    """Follows its lane and the car ahead, and stops at lines: the intelligent driver model, with emergency braking.

    It steers towards a point of its lane that is `preview_s` ahead, see `steering`.

    following:   distances and accelerations; None: IntelligentDriverModel()
    emergency:   when it brakes as hard as it can; None: TimeToCollision()
    horizon_m:   m, how far ahead it looks
    margin_m:    m, on either side of the car, in which it brakes for objects
    preview_s:   s, how far ahead it steers
    preview_m:   m, how far ahead it steers at least
    """

    def __init__(
        self,
        *,
        following: IntelligentDriverModel | None = None,
        emergency: BrakingRule | None = None,
        horizon_m: float = 60.0,
        margin_m: float = 0.3,
        preview_s: float = 1.0,
        preview_m: float = 4.0,
    ) -> None:
        check("more than 0, finite", preview_s=preview_s, preview_m=preview_m)
        self.following = following or IntelligentDriverModel()
        self.corridor = Driving(rule=emergency or TimeToCollision(), horizon_m=horizon_m, margin_m=margin_m)
        self.preview_s, self.preview_m = preview_s, preview_m

    def drive(self, situation: Situation) -> Command:
        speed, limits = situation.speed, situation.limits
        objects = situation.objects
        ahead = self.corridor.ahead(
            along_route(situation.position, situation.velocity, situation.heading, situation.size, situation.route),
            RoadUsers(np.zeros(len(objects), np.int64), objects.position, objects.velocity, objects.size, objects.yaw),
        )
        acceleration = -limits.braking
        if not ahead.brake.any():
            gap, other = ahead.gap_m, ahead.speed_mps
            if np.isfinite(situation.route.stop_m):  # a line is a standing car, before which it stops nearer
                gap = np.append(gap, situation.route.stop_m + self.following.gap_m - BEFORE_LINE_M)
                other = np.append(other, 0.0)
            own = np.array([speed])
            acceleration = float(self.following.free(own, self._desired(situation.route))[0])
            acceleration += float(self.following.interaction(speed * np.ones(len(gap)), gap, other).min(initial=0.0))
        preview = max(self.preview_s * speed, self.preview_m)
        return limits.nearest(acceleration, steering(situation, preview))

    def _desired(self, route: RouteAhead) -> Floats:
        """(1,) m/s at which the car can still slow down comfortably for all that is ahead."""
        allowed = np.sqrt(route.speed**2 + 2.0 * self.following.braking * route.along)
        return np.array([max(float(allowed.min()), 0.1)])


def steering(situation: Situation, preview_m: float, offset_m: float = 0.0) -> float:
    """Curvature 1/m of the arc from the car to a point of its lane that is `preview_m` ahead (pure pursuit).

    offset_m: m, of this point to the left of the lane's middle

    Source: Coulter, Implementation of the Pure Pursuit Path Tracking Algorithm, CMU-RI-TR-92-01 (1992).
    """
    along, points = situation.route.along, situation.route.position
    preview = min(preview_m, float(along[-1]))
    target = np.array([np.interp(preview, along, points[:, axis]) for axis in (0, 1)])
    if offset_m:
        step = np.diff(points[int(np.clip(np.searchsorted(along, preview), 1, len(along) - 1)) - 1 :][:2], axis=0)[0]
        target += offset_m * np.array([-step[1], step[0]]) / max(float(np.hypot(*step)), 1e-9)
    offset = target - situation.position[:2]
    across = np.cos(situation.heading) * offset[1] - np.sin(situation.heading) * offset[0]
    return float(2.0 * across / max(float(offset @ offset), 1.0))


#: m, in the bird's-eye view, between an own track and the object of the mission estimate that it stands for at most:
#: the radius within which agents pair the two.
SAME_OBJECT_M = 2.0
#: s, for which own sensors remember that they saw through an object: of what is close to the car, too little is in view
#: now and then.
REFUTED_S = 1.0


class Refutations:
    """Which objects of a mission estimate own sensors see through, or did of late."""

    def __init__(self) -> None:
        self._until_ns: dict[int, int] = {}  # by id of the object

    def update(self, time_ns: int, ids: Ints, free: Bools) -> Bools:
        """(n,) whether the places of the objects with these ids are free, or were within REFUTED_S.

        free: (n,) whether own sensors see through them now; times must not fall
        """
        self._until_ns = {id_: until_ns for id_, until_ns in self._until_ns.items() if until_ns >= time_ns}
        self._until_ns |= dict.fromkeys(ids[free].tolist(), time_ns + round(REFUTED_S * 1e9))
        return np.array([id_ in self._until_ns for id_ in ids.tolist()], np.bool_)


def upheld(own: Floats, mission: Floats, free: Bools) -> Bools:
    """Which objects of the mission estimate count beside own tracks: (m,).

    own: (n, 3) m, positions of own tracks; mission: (m, 3) m, of the objects; free: (m,), see `overruled`
    """
    i, j, dx, dy = neighbours(own, mission, np.full(len(own), SAME_OBJECT_M))
    others = ~free
    others[j[greedy_matching(i, j, np.hypot(dx, dy))]] = False
    return others


def overruled(own: ObjectStates, mission: ObjectStates, free: Bools) -> ObjectStates:
    """The objects to drive by: own tracks, and the objects of the mission estimate that own sensors do not refute.

    own:     n own tracks, from the agent's sensors alone
    mission: m objects of its mission estimate, at the same time
    free:    (m,) whether its sensors see through the place of each of these, see `Refutations`

    All own tracks count, whether or not the mission estimate has them. An object of the mission estimate counts where
    no own track stands for it (each track for one object at most, the nearest pairs first), unless its place is free.
    Ids are those of the mission estimate, and -1 - id for own tracks, so that they are unique.
    """
    others = mission.select(upheld(own.position, mission.position, free))
    return concatenate([own.with_(id=-1 - own.id), others])
