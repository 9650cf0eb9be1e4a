"""Attacks on the road ahead of a car, wherever its driver has taken it: what it would brake for, or hit.

They know the ego's route, as a map and the plans of a fleet tell it, and follow the ego along it. They do not rely on
its schedule: a car that reacts leaves it (docs/explanation-driving.md).
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import replace
from typing import Literal

import numpy as np

from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.states import Bools, Floats, Ints, ObjectStates, concatenate
from mast_zenoh.attacks.adaptive import AdaptiveAttack, Lies, Moment
from mast_zenoh.attacks.imitation import VictimLike
from mast_zenoh.attacks.phantoms import BOX, PhantomAttack
from mast_zenoh.attacks.real_objects import ChangingAttack, SlowDrift
from mast_zenoh.attacks.regions import LANE_M, PATH_AHEAD_M, REGIONS, VEHICLE_M, Path, path_ahead
from mast_zenoh.attacks.selection import ground_height
from mast_zenoh.attacks.surroundings import UNKNOWN, Coverage, Surroundings
from mast_zenoh.errors import nearest

#: m; an object this near to where the ego is expected is the ego.
EGO_M = 3.0
#: Weight of the newest message in the ego's speed.
_NEWEST = 0.3
#: m, from the middle of a lane to that of its neighbour.
LANE_WIDTH_M = 2.0 * LANE_M
#: m ahead of the ego within which objects matter; and behind it, after which they do not any more.
REACH_M, PASSED_M = 60.0, 3.0
#: m to the side of the ego's path within which a chosen object still matters.
ASIDE_M = 15.0


class EgoOnRoute:
    """Where the ego is on its route, for an attack on any agent's messages, or on the picture.

    If the ego is the victim, its pose says it. Otherwise the ego is the object that is on its schedule, and is followed
    from there. While nobody sees it, it goes on along its route: as its schedule says if it was within EGO_M of it
    when it was last seen, otherwise at the same speed.

    path: of the whole route; None: no route is known;  along: m, how far along it the ego is;  speed: m/s
    """

    def __init__(self, known: Surroundings) -> None:
        self.path: Path | None = None
        self.along, self.speed = 0.0, 0.0
        self._known = known
        if known.ego_sensor is not None:
            self.path = path_ahead(Coverage(known, (), float(known.ego_sensor.route.time_s[0])))
        self._scheduled: float | None = None  # m along the path, at the last message

    def observe(self, moment: Moment) -> None:
        """Follow the ego to the time of a message."""
        path, ego = self.path, self._known.ego_sensor
        if path is None or ego is None:
            return
        scheduled = float(path.coordinates(ego.route.position_at(moment.time_s)[None])[0][0])
        if self._scheduled is None:
            now = path_ahead(moment.coverage)
            self.along, self.speed = scheduled, now.speed if now is not None else 0.0
            expected = scheduled
        elif abs(self.along - self._scheduled) <= EGO_M:
            expected = self.along + scheduled - self._scheduled
        else:
            expected = self.along + self.speed * moment.elapsed_s
        self._scheduled = scheduled
        if tuple(self._known.victims) == tuple(self._known.sensors)[:1]:
            position: Floats | None = moment.position
        else:
            position = self._seen(moment.seen, path.at(np.array([expected]))[0][0])
        along = expected if position is None else float(path.coordinates(position[None])[0][0])
        if moment.elapsed_s > 0.0:
            self.speed += _NEWEST * (max(along - self.along, 0.0) / moment.elapsed_s - self.speed)
        self.along = along

    @staticmethod
    def _seen(objects: ObjectStates, expected: Floats) -> Floats | None:
        """The position (3,) m of the object that is where the ego is expected, (2,) m; None: none is."""
        offset = objects.position[:, :2] - expected
        distance = np.hypot(offset[:, 0], offset[:, 1])
        row = int(distance.argmin()) if len(distance) else -1
        return objects.position[row] if row >= 0 and distance[row] <= EGO_M else None

    def on_route(self, coverage: Coverage) -> Coverage:
        """The coverage, if the ego is off its schedule with the time at which its route has it where it is."""
        if self.path is None or self._known.ego_sensor is None:
            return coverage
        position, route = self.path.at(np.array([self.along]))[0][0], self._known.ego_sensor.route
        if np.hypot(*(route.position_at(coverage.time_s)[:2] - position)) <= EGO_M:
            return coverage
        return replace(coverage, time_s=route.time_near(position))

    def ahead(self, objects: ObjectStates) -> tuple[Floats, Floats]:
        """How far ahead of the ego, and how far left of its path objects are, both (n,) m; inf without a path."""
        if self.path is None:
            return np.full(len(objects), np.inf), np.full(len(objects), np.inf)
        along, left = self.path.coordinates(objects.position)
        return along - self.along, left

    def distance(self, objects: ObjectStates) -> Floats:
        """(n,) m ahead of the ego; infinite for what is behind it or far aside."""
        gap, left = self.ahead(objects)
        return np.where((gap > PASSED_M) & (gap <= REACH_M + ASIDE_M) & (np.abs(left) <= ASIDE_M), gap, np.inf)


class FollowingEgo(AdaptiveAttack):
    """Base of attacks that know where the ego is on its route: `ego`, which has seen each message before `lie` has."""

    ego = EgoOnRoute(UNKNOWN)

    def inform(self, surroundings: Surroundings) -> None:
        super().inform(surroundings)
        self.ego = EgoOnRoute(surroundings)

    def observe(self, moment: Moment) -> None:
        super().observe(moment)
        self.ego.observe(moment)


# -- real objects ------------------------------------------------------------------------------------------------------


class HideAhead(FollowingEgo, ChangingAttack):
    """Hides real objects that the ego has to brake for: those in its lane ahead, or those that will cross it.

    An object that it has begun to hide stays hidden until the ego has passed it, or it is far away. On the picture,
    only what the ego does not see itself disappears for it. Where the route says at which lines the ego waits for
    others, as in generated junctions, it waits also for crossers that it does not see. Source: removal of objects in
    collaborative perception, Zhang et al. (USENIX Security 2024).

    what:      "lane": what is in the ego's lane, its leader first; "crossing": what will come into it from the side
               within `horizon_s`; "both"
    horizon_s: s, for which velocities are extrapolated
    budget:    lies per second, so the number of objects
    start_s:   s of scene time at which the attack begins
    """

    def __init__(
        self,
        *,
        what: Literal["lane", "crossing", "both"] = "lane",
        horizon_s: float = 6.0,
        budget: float = 2.0,
        start_s: float = 4.0,
    ) -> None:
        super().__init__(budget=budget, start_s=start_s)
        check("more than 0, finite", horizon_s=horizon_s)
        kinds = "lane", "crossing", "both"
        if what not in kinds:
            raise ValueError(f"what: found {what!r}{nearest(str(what), kinds)}")
        self._what, self._horizon_s = what, horizon_s

    def lie(self, moment: Moment) -> Lies:
        gap, left = self.ego.ahead(moment.seen)
        wanted = np.zeros(len(gap), bool)
        if self._what != "crossing":
            wanted |= np.abs(left) <= LANE_M
        if self._what != "lane":
            wanted |= self._will_cross(gap, left)
        return super().lie(replace(moment, established=moment.established & wanted & (gap <= REACH_M)))

    def _will_cross(self, gap: Floats, left: Floats) -> Bools:
        """(n,) whether objects beside the lane will be in it ahead of the ego, if they go on as now."""
        path = self.ego.path
        if path is None:
            return np.zeros(len(gap), bool)
        velocity = self._follower.velocities()
        heading = path.at(np.maximum(gap + self.ego.along, 0.0))[1]
        forward = np.cos(heading) * velocity[:, 0] + np.sin(heading) * velocity[:, 1]
        leftward = np.cos(heading) * velocity[:, 1] - np.sin(heading) * velocity[:, 0]
        inward = -np.sign(left) * leftward
        time_s = np.maximum(np.abs(left) - LANE_M, 0.0) / np.maximum(inward, _LEAST_MPS)
        aside = (np.abs(left) > LANE_M) & (inward > _LEAST_MPS)
        return np.asarray(aside & (time_s <= self._horizon_s) & (gap + forward * time_s > 0.0))

    def _cost(self, moment: Moment) -> Floats:
        return self.ego.distance(moment.seen)

    def _claims(self, moment: Moment, numbers: Ints, real: ObjectStates) -> None:
        return None


#: m/s, least speed toward a lane with which an object crosses it.
_LEAST_MPS = 0.8


class LaneIntrusion(FollowingEgo, SlowDrift):
    """Displaces real vehicles from lane to lane, so slowly that no single message is suspicious.

    Toward the ego's lane: a vehicle beside it seems to come into it, and the ego brakes. Out of it: the vehicle ahead
    seems to leave it, and the ego goes on. The offset grows at `rate_mps` until the vehicle is in the middle of the
    other lane; its velocity agrees. Source: a perceived position that is shifted into the victim's lane, PosePert
    (arXiv 2605.01301, abstract and quotations); see `PosePert` for shifts below a metre.

    into:      "ego": vehicles beside its lane, into it; "neighbour": vehicles in its lane, into the one to its right
    rate_mps:  m/s by which the offset grows
    tolerance: 0 to 1, fall of the trust that is accepted
    budget:    lies per second, so the number of vehicles
    start_s:   s of scene time at which the attack begins
    """

    def __init__(
        self,
        *,
        into: Literal["ego", "neighbour"] = "ego",
        rate_mps: float = 1.0,
        tolerance: float = 0.05,
        budget: float = 2.0,
        start_s: float = 4.0,
    ) -> None:
        super().__init__(
            rate_mps=rate_mps, limit_m=LANE_WIDTH_M + LANE_M, tolerance=tolerance, budget=budget, start_s=start_s
        )
        if into not in ("ego", "neighbour"):
            raise ValueError(f"into: found {into!r}{nearest(str(into), ('ego', 'neighbour'))}")
        self._into = into

    def lie(self, moment: Moment) -> Lies:
        gap, left = self.ego.ahead(moment.seen)
        beside = np.abs(left) > LANE_M
        wanted = beside & (np.abs(left) <= self._limit_m) if self._into == "ego" else ~beside
        wanted &= (moment.seen.size[:, 0] >= VEHICLE_M) & (gap <= REACH_M)
        return super().lie(replace(moment, established=moment.established & wanted))

    def _cost(self, moment: Moment) -> Floats:
        return self.ego.distance(moment.seen)

    def _claims(self, moment: Moment, numbers: Ints, real: ObjectStates) -> ObjectStates:
        self._direction |= self._directions(moment, numbers, real)  # lanes bend
        return super()._claims(moment, numbers, real)

    def _directions(self, moment: Moment, numbers: Ints, real: ObjectStates) -> dict[int, float]:
        gap, left = self.ego.ahead(real)
        if self.ego.path is None:
            return dict.fromkeys(numbers.tolist(), 0.0)
        across = self.ego.path.at(np.maximum(gap + self.ego.along, 0.0))[1] + np.pi / 2
        # Out of the ego's lane, all go to the right.
        right = left > 0.0 if self._into == "ego" else np.ones(len(left), bool)
        return dict(zip(numbers.tolist(), (across + np.where(right, np.pi, 0.0)).tolist(), strict=True))

    def _limits(self, moment: Moment, real: ObjectStates) -> Floats:
        _, left = self.ego.ahead(real)
        return np.minimum(np.abs(left) if self._into == "ego" else LANE_WIDTH_M + left, self._limit_m)


# -- false vehicles ----------------------------------------------------------------------------------------------------

#: m; a ghost nearer to the ego than this would be hit: it is withdrawn.
NEAREST_M = 6.0


class GhostAhead(FollowingEgo, PhantomAttack):
    """Puts vehicles into the ego's lane, 10 to 60 m ahead of it, so that it brakes.

    A ghost that the ego would hit, or that is no longer on its path, is withdrawn, and another one is placed.
    Source: the "front-near" spoofing of Cao et al. (CCS 2019), in collaborative perception Zhang et al. (USENIX
    Security 2024).

    budget:    lies per second, so the number of false objects
    start_s:   s of scene time at which the attack begins
    speed_mps: σ per axis of their speed, at most half of the ego's; 0: they stand
    """

    region = REGIONS["ego_path"]

    def __init__(self, *, budget: float = 2.0, start_s: float = 4.0, speed_mps: float = 0.0) -> None:
        super().__init__(budget=budget, start_s=start_s, speed_mps=speed_mps)

    def lie(self, moment: Moment) -> Lies:
        return super().lie(replace(moment, coverage=self.ego.on_route(moment.coverage)))

    def _given_up(self, moment: Moment, phantoms: ObjectStates) -> Bools:
        path = path_ahead(moment.coverage)
        if path is None:
            return np.ones(len(phantoms), bool)
        offset = phantoms.position[:, :2] - path.corners[0]
        distance = np.hypot(offset[:, 0], offset[:, 1])
        off_path = path.offset(phantoms.position) > LANE_M + 1.0  # samples of the path are 1 m apart
        return np.asarray(off_path | (distance < NEAREST_M) | (distance > PATH_AHEAD_M[1] + NEAREST_M))


#: m; a false vehicle whose centre is nearer to the ego's would be hit: it is withdrawn.
_HIT_M = 4.5


class FalseTraffic(FollowingEgo):
    """Base of attacks that put false vehicles on the ego's path, each with its own place and speed along it.

    No false vehicle is shown where the victim sees a real one, or in a building; all are withdrawn when the ego has
    reached the first one, and after `pause_s` others come.
    """

    #: s, from the withdrawal of false vehicles to the next ones
    pause_s = 1.0

    def __init__(self, *, budget: float, start_s: float) -> None:
        super().__init__(budget=budget, start_s=start_s)
        self._imitation = VictimLike()
        self._numbers: Ints = np.zeros(0, np.int64)
        self._along: Floats = np.zeros(0)
        self._withdrawn_ns: int | None = None
        self._placed = 0

    def bind(self, seed: int, name: str) -> None:
        super().bind(seed, name)
        self._imitation.bind(seed, self._surroundings.scene, name)

    def observe(self, moment: Moment) -> None:
        super().observe(moment)
        self._imitation.observe(moment.seen, moment.time_ns, moment.position)

    def counts(self) -> dict[str, int]:
        return {"selected": 0, "placed": self._placed, "wanted": self._numbers_used}

    def rest(self) -> None:
        self._numbers, self._along = self._numbers[:0], self._along[:0]

    def lie(self, moment: Moment) -> Lies:
        path = self.ego.path
        if path is None:
            return Lies()
        if len(self._numbers) == 0:
            paused = self._withdrawn_ns is not None and moment.time_ns - self._withdrawn_ns < self.pause_s * 1e9
            gaps = np.zeros(0) if paused else self.places(moment)
            gaps = gaps[: self.budget.admit(0, len(gaps))]
            self._along, self._numbers = self.ego.along + gaps, self.numbers(len(gaps))
            self._placed += len(gaps)
            speed, left, leftward = self.motion(moment, begins=True)
        else:
            speed, left, leftward = self.motion(moment, begins=False)
            self._along = self._along + speed * moment.elapsed_s
            if (self._along - self.ego.along < _HIT_M).any():
                self._withdrawn_ns = moment.time_ns
                self.rest()
                return Lies()
        return Lies(inserted=self._shown(moment, path, speed, left, leftward))

    @abstractmethod
    def places(self, moment: Moment) -> Floats:
        """(k,) m, how far ahead of the ego new false vehicles are, ascending; none: they wait."""

    @abstractmethod
    def motion(self, moment: Moment, *, begins: bool) -> tuple[float, float, float]:
        """The speed of all, m/s, how far left of the path they are, m, and the speed with which they go left, m/s.

        begins: whether they have just been placed
        """

    def _shown(self, moment: Moment, path: Path, speed: float, left: float, leftward: float) -> ObjectStates:
        """The false vehicles as they appear in a message."""
        allowed = self.budget.admit(len(self._numbers), len(self._numbers))
        along, numbers = self._along[:allowed], self._numbers[:allowed]
        point, heading = path.at(along)
        ahead, side = (np.stack([np.cos(a), np.sin(a)], axis=1) for a in (heading, heading + np.pi / 2))
        height = np.full((len(along), 1), ground_height(moment.seen) + BOX[2] / 2.0)
        false = ObjectStates.of(
            np.concatenate([point + left * side, height], axis=1),
            id=numbers,
            velocity=np.concatenate([speed * ahead + leftward * side, np.zeros_like(height)], axis=1),
            size=np.tile(BOX, (len(along), 1)),
            yaw=heading + (np.arctan2(leftward, speed) if speed > _STANDING_MPS else 0.0),
        )
        real = concatenate([moment.seen, self.known_objects(moment)])
        return self._imitation.show(moment.frame, false, real, moment.coverage, moment.view)


#: m/s; a slower vehicle keeps its heading.
_STANDING_MPS = 0.5


class PhantomQueue(FalseTraffic):
    """Puts a queue of standing vehicles into the ego's lane, so that it stops, and with it all behind it.

    Unlike the vehicles of `GhostAhead`, it stays where it is until the ego has reached it: an ego that brakes in time
    stands before it for as long as the attack goes on. Source: congestion by false reports of vehicles, Chen et al.
    (NDSS 2018), there to the controller of traffic lights.

    ahead_m: m, from the ego to the first vehicle when the queue appears;  spacing_m: m, from vehicle to vehicle
    budget:  lies per second, so the number of vehicles
    start_s: s of scene time at which the attack begins
    """

    def __init__(
        self, *, ahead_m: float = 35.0, spacing_m: float = 7.0, budget: float = 4.0, start_s: float = 4.0
    ) -> None:
        super().__init__(budget=budget, start_s=start_s)
        check("more than 0, finite", ahead_m=ahead_m, spacing_m=spacing_m)
        self._ahead_m, self._spacing_m, self._count = ahead_m, spacing_m, max(1, int(budget))

    def places(self, moment: Moment) -> Floats:
        return np.asarray(self._ahead_m + self._spacing_m * np.arange(self._count))

    def motion(self, moment: Moment, *, begins: bool) -> tuple[float, float, float]:
        return 0.0, 0.0, 0.0


class CutIn(FalseTraffic):
    """A false vehicle comes from the neighbouring lane into the ego's, close ahead of it, and brakes.

    It drives beside the ego's lane as fast as the ego, changes lanes in `change_s`, and then brakes to a stop. After
    the ego has reached it, another one comes. Source: cut-ins of UN Regulation No. 157 (automated lane keeping), here
    of a vehicle that is not there.

    ahead_m:      m, from the ego to the vehicle when it appears;  side: "left" or "right" of the ego's lane
    change_s:     s, of a change of lanes;  braking_mps2: m/s², after it
    least_mps:    m/s; while the ego is slower, no vehicle comes
    budget:       lies per second
    start_s:      s of scene time at which the attack begins
    """

    def __init__(
        self,
        *,
        ahead_m: float = 15.0,
        side: Literal["left", "right"] = "left",
        change_s: float = 2.0,
        braking_mps2: float = 3.0,
        least_mps: float = 3.0,
        budget: float = 2.0,
        start_s: float = 4.0,
    ) -> None:
        super().__init__(budget=budget, start_s=start_s)
        check("more than 0, finite", ahead_m=ahead_m, change_s=change_s, braking_mps2=braking_mps2)
        check("0 or more, finite", least_mps=least_mps)
        if side not in ("left", "right"):
            raise ValueError(f"side: found {side!r}{nearest(str(side), ('left', 'right'))}")
        self._ahead_m, self._change_s, self._braking, self._least_mps = ahead_m, change_s, braking_mps2, least_mps
        self._from_m = LANE_WIDTH_M if side == "left" else -LANE_WIDTH_M
        self._began_ns, self._speed = 0, 0.0

    def places(self, moment: Moment) -> Floats:
        return np.array([self._ahead_m] if self.ego.speed >= self._least_mps else [])

    def motion(self, moment: Moment, *, begins: bool) -> tuple[float, float, float]:
        if begins:
            self._began_ns, self._speed = moment.time_ns, self.ego.speed
        share = (moment.time_ns - self._began_ns) * 1e-9 / self._change_s
        if share >= 1.0:
            self._speed = max(self._speed - self._braking * moment.elapsed_s, 0.0)
            return self._speed, 0.0, 0.0
        left = 0.5 * (1.0 + np.cos(np.pi * share)) * self._from_m
        return self._speed, left, -0.5 * np.pi / self._change_s * float(np.sin(np.pi * share)) * self._from_m
