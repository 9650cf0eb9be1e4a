"""Liars that know the defence `FaultOrLie`: each turns on one of its rules.

Threat model of all: the attacker controls the tracks and views of one agent or two, which do not coordinate. It knows
the rules and limits of the defence, the buildings, and the sensors and routes of all agents, and hears the picture and
the trust. Its lies are not limited by a budget. They are inputs of tests, not attacks for users.
"""

from abc import abstractmethod
from dataclasses import replace

import numpy as np

from mast_zenoh.arrays.states import CLASS_INDEX, Bools, Floats, Ints, ObjectStates, concatenate, propagate
from mast_zenoh.attacks.adaptive import AdaptiveAttack, Budget, Lies, Moment
from mast_zenoh.attacks.imitation import Exact, typical
from mast_zenoh.attacks.knowledge import Trust, TrustWatch
from mast_zenoh.attacks.phantoms import AHEAD_S, BOX, PhantomAttack
from mast_zenoh.attacks.regions import REGIONS
from mast_zenoh.attacks.selection import ground_height
from mast_zenoh.attacks.surroundings import boxes_of, unlimited
from mast_zenoh.attacks.targets import blocked, opened
from mast_zenoh.integrity.views import SweptView

#: Lies at once of attacks that lie about all of their objects.
ALL = 1000
#: Numbers of changed objects begin here, above those of inserted ones.
CHANGED = 100_000
#: m, range of a view that sees everything.
EVERYWHERE_M = 10_000.0


class LiesAtOnce(Budget):
    """Admits so many lies in each message, whatever was said before."""

    def __init__(self, most: int) -> None:
        super().__init__(float(most))
        self._most = most

    def admit(self, active: int, wanted: int) -> int:
        return min(wanted, self._most)

    def spend(self, lies: int) -> None:
        pass


def nearest_m(objects: ObjectStates, others: ObjectStates) -> Floats:
    """(n,) m, bird's-eye distance of each of n objects from the nearest other; infinite without others."""
    if len(others) == 0:
        return np.full(len(objects), np.inf)
    return np.asarray(np.linalg.norm(objects.position[:, None, :2] - others.position[:, :2], axis=-1).min(axis=1))


class Balloon(AdaptiveAttack):
    """Reports all objects metres too high and uncertain in height, so that an honest witness seems to lie.

    The middle of the few tracks of such an object floats; other honest agents see through the air there, and that
    counts against the honest agent that reports it on the ground. The liar itself denies its claim, so nobody accuses
    it. It stops while the trust in its agent has fallen.

    deny: whether its view sees through everything, so that it disputes all objects, or through its own claims alone
    """

    raise_m, height_std_m = 9.0, 6.0
    #: m, from the middle of the objects, where a little height is noticed
    near_m = 18.0

    def __init__(self, *, deny: bool = True, start_s: float = 4.0) -> None:
        super().__init__(start_s=start_s)
        self.budget = LiesAtOnce(ALL)
        self._deny = deny
        self._watch = TrustWatch(0.05)
        self._floating = -1, ObjectStates.empty()

    def hear_trust(self, frame: int, time_ns: int, trust: Trust) -> None:
        self._watch.hear(trust, self._surroundings.victims)

    def lie(self, moment: Moment) -> Lies:
        seen, known = moment.seen, self.known_objects(moment)
        if self._watch.fallen or len(seen) == 0:
            return Lies()
        middle = np.median(concatenate([seen, known]).position[:, :2], axis=0)
        rows = np.flatnonzero(np.linalg.norm(seen.position[:, :2] - middle, axis=1) > self.near_m)
        claimed = np.linalg.norm(known.position[:, :2] - middle, axis=1) > self.near_m
        claimed &= np.linalg.norm(known.position[:, :2] - moment.position[:2], axis=1) < 68.0
        others = typical(known.select(claimed & (nearest_m(known, seen) > 3.0)), seen)
        claims, others = (self._raised(states, middle, ground_height(seen)) for states in (seen.select(rows), others))
        self._floating = moment.frame, concatenate([claims, others])
        return Lies(inserted=others, changed=rows, claims=claims, changed_number=CHANGED + rows)

    def _raised(self, states: ObjectStates, middle: Floats, ground_m: float) -> ObjectStates:
        position, covariance = states.position.copy(), states.covariance.copy()
        height = 1.0 + 0.11 * np.linalg.norm(position[:, :2] - middle, axis=1)
        position[:, 2] = ground_m + 0.5 * states.size[:, 2] + np.minimum(self.raise_m, height)
        covariance[:, 2, :] = covariance[:, :, 2] = 0.0
        covariance[:, 2, 2] = self.height_std_m**2
        return states.with_(position=position, covariance=covariance)

    def forge_view(self, frame: int, time_ns: int, swept: SweptView) -> SweptView:
        if frame != self._floating[0]:
            return swept
        if not self._deny:
            return opened(swept, self._floating[1])
        everywhere = replace(unlimited(swept.view.position), max_range=EVERYWHERE_M)
        return replace(swept, view=everywhere, free=np.full_like(swept.free, EVERYWHERE_M))


class Deadlock(Balloon):
    """Denies half of all objects and lets the others float, so that no explanation of the disputes is left.

    With one dispute of two honest agents more agents must lie than may. Then nobody is suspended, and a defence that
    calls false what is false in each of no explanations drops all objects that anybody denies.
    """

    def lie(self, moment: Moment) -> Lies:
        lies = super().lie(moment)
        denied, left = _in_dark_squares(lies.claims), ~_in_dark_squares(lies.inserted)
        return Lies(
            inserted=lies.inserted.select(left),
            hidden=lies.changed[denied],
            hidden_number=lies.changed_number[denied],
            changed=lies.changed[~denied],
            claims=lies.claims.select(~denied),
            changed_number=lies.changed_number[~denied],
        )


def _in_dark_squares(objects: ObjectStates) -> Bools:
    """(n,) whether objects are in the dark squares of a chessboard, so that liars deny the same ones."""
    return np.asarray(np.floor(objects.position[:, :2] / 8.0).sum(axis=1) % 2 == 0)


class Wedge(AdaptiveAttack):
    """Displaces what one honest agent and few others see, so that this agent differs from all and is corrected.

    It chooses the honest agent of which it sees the most such objects.

    others: greatest number of further honest agents that see such an object;  shift_m: m, along x
    """

    def __init__(self, *, others: int = 2, shift_m: float = 1.5, start_s: float = 4.0) -> None:
        super().__init__(start_s=start_s)
        self.budget = LiesAtOnce(ALL)
        self._others, self._shift_m = others, shift_m

    def lie(self, moment: Moment) -> Lies:
        known, seen = self._surroundings, moment.seen
        honest = [sensor for name, sensor in known.sensors.items() if name not in known.victims]
        if not honest or len(seen) == 0:
            return Lies()
        sight = np.array([moment.coverage.in_sight(sensor, seen, seen) for sensor in honest])
        little_seen = sight & (sight.sum(axis=0) <= 1 + self._others)
        rows = np.flatnonzero(little_seen[little_seen.sum(axis=1).argmax()])
        claims = seen.select(rows)
        claims = claims.with_(position=claims.position + np.array([self._shift_m, 0.0, 0.0]))
        return Lies(changed=rows, claims=claims, changed_number=CHANGED + rows)


class Excuser(PhantomAttack):
    """Invents cars in everybody's view, and shifts all its rows and its view on and off.

    A shift of all rows looks like a fault of the whole agent. A defence that forgets the evidence against an agent when
    it finds a fault, or waits whenever there may be one, never suspends this one.
    """

    region = REGIONS["in_view"]
    shift_m, shifted_s, straight_s = np.array([2.0, 0.0, 0.0]), 0.3, 0.3

    def __init__(self, *, cars: int = 3, start_s: float = 4.0) -> None:
        super().__init__(start_s=start_s, speed_mps=0.0)
        self.budget = LiesAtOnce(cars)
        self._shifted_frame = -1

    def _given_up(self, moment: Moment, phantoms: ObjectStates) -> Bools:
        return np.zeros(len(phantoms), bool)

    def lie(self, moment: Moment) -> Lies:
        lies = super().lie(moment)
        if (moment.time_s - self._start_ns * 1e-9) % (self.shifted_s + self.straight_s) >= self.shifted_s:
            return lies
        self._shifted_frame, rows = moment.frame, np.arange(len(moment.seen))
        inserted, claims = (
            states.with_(position=states.position + self.shift_m) for states in (lies.inserted, moment.seen)
        )
        return Lies(inserted=inserted, changed=rows, claims=claims, changed_number=CHANGED + rows)

    def forge_view(self, frame: int, time_ns: int, swept: SweptView) -> SweptView:
        shift_m = self.shift_m if frame == self._shifted_frame else np.zeros(3)
        moved = replace(swept, view=replace(swept.view, position=swept.view.position + shift_m))
        return blocked(moved, self._phantoms.with_(position=self._phantoms.position + shift_m))


class UndeniedCars(PhantomAttack):
    """Base of liars that invent standing cars through which the rays of no honest agent pass, now and in a second.

    cars: at once
    """

    region = REGIONS["in_view"]  # not used: `_spots` chooses the places
    #: number of places that are tried
    tries = 1500

    def __init__(self, *, cars: int, start_s: float) -> None:
        super().__init__(start_s=start_s, speed_mps=0.0)
        self.budget = LiesAtOnce(cars)
        self._imitation = Exact()  # type: ignore[assignment]  # always visible, without noise

    @abstractmethod
    def _spots(self, moment: Moment, centre: Floats, rng: np.random.Generator) -> tuple[ObjectStates, Bools]:
        """(k,) cars that might be invented, and which of them come first. centre: (3,) m, of the ego"""

    def _given_up(self, moment: Moment, phantoms: ObjectStates) -> Bools:
        denied = np.zeros(len(phantoms), bool)
        for time_s in (moment.time_s, moment.time_s + AHEAD_S) if len(phantoms) else ():
            for view in self._surroundings.other_views(time_s):
                away = phantoms.position - view.position
                away[:, 2] = 0.0
                away /= np.maximum(np.linalg.norm(away, axis=1), 1e-6)[:, None]
                behind = self._surroundings.behind_walls(view.position, phantoms.position + 3.3 * away)
                denied |= moment.coverage.visible(view, boxes_of(phantoms)) & ~behind
        return denied

    def _place(self, count: int, moment: Moment) -> None:
        ego = self._surroundings.ego_sensor
        centre = moment.position if ego is None else ego.route.position_at(moment.time_s)
        cars, first = self._spots(moment, centre, self.stream("places", moment.frame))
        taken = concatenate([moment.seen, self.known_objects(moment), self._phantoms])
        free = (nearest_m(cars, taken) > 5.5) & (np.linalg.norm(cars.position[:, :2] - centre[:2], axis=1) < 70.0)
        free &= ~self._given_up(moment, cars)
        chosen = ObjectStates.empty()
        for row in [*np.flatnonzero(free & first), *np.flatnonzero(free & ~first)]:
            car = cars.select(slice(row, row + 1))
            if len(chosen) < count and nearest_m(car, chosen)[0] > 5.5:
                chosen = concatenate([chosen, car])
        self._phantoms = concatenate([self._phantoms, chosen.with_(id=self.numbers(len(chosen)))])
        self._born_ns = np.append(self._born_ns, np.full(len(chosen), moment.time_ns, np.int64))


def cars_at(
    xy: Floats, yaw: Floats, moment: Moment, size: Floats = BOX, velocity: Floats | None = None
) -> ObjectStates:
    """Cars on the ground at xy (k, 2) m with yaw (k,) rad. size: (3,) m; velocity: (k, 3) m/s; None: they stand"""
    k = len(xy)
    position = np.column_stack([xy, np.full(k, ground_height(moment.seen) + 0.5 * size[2])])
    car: Ints = np.full(k, CLASS_INDEX["car"])
    states = ObjectStates.of(position, size=np.tile(size, (k, 1)), yaw=yaw, class_id=car.astype(np.uint8))
    return states if velocity is None else states.with_(velocity=velocity)


class WallHugger(UndeniedCars):
    """Invents cars half inside facades: the rays of the honest agents that look end there.

    Each of them seems to be a witness that something is there; none denies it. So a limit on what one agent reports and
    nobody else looks at does not count these cars.
    """

    def __init__(self, *, cars: int = 20, start_s: float = 4.0) -> None:
        super().__init__(cars=cars, start_s=start_s)

    def _spots(self, moment: Moment, centre: Floats, rng: np.random.Generator) -> tuple[ObjectStates, Bools]:
        walls = self._surroundings.walls
        if len(walls.start) == 0:
            return ObjectStates.empty(), np.zeros(0, bool)
        wall = rng.integers(0, len(walls.start), self.tries)
        along = (walls.end - walls.start)[wall]
        point = walls.start[wall] + rng.uniform(0, 1, (self.tries, 1)) * along
        normal = np.column_stack([-along[:, 1], along[:, 0]]) / np.maximum(np.linalg.norm(along, axis=1), 1e-6)[:, None]
        inward = np.where(self._surroundings.inside_buildings(point + 0.3 * normal)[:, None], normal, -normal)
        yaw = np.arctan2(along[:, 1], along[:, 0])
        near = np.linalg.norm(point - moment.position[:2], axis=1) < 65.0
        cars, outside = (cars_at((point + inward * depth)[near], yaw[near], moment) for depth in (0.5, -0.5))
        return cars, moment.coverage.honest_viewers(outside) > 0


class BlindSwarm(UndeniedCars):
    """Invents so many cars where no honest agent looks that they outnumber all that one agent usually reports alone."""

    def __init__(self, *, cars: int = 24, start_s: float = 4.0) -> None:
        super().__init__(cars=cars, start_s=start_s)

    def _spots(self, moment: Moment, centre: Floats, rng: np.random.Generator) -> tuple[ObjectStates, Bools]:
        xy = centre[:2] + rng.uniform(-60.0, 60.0, (self.tries, 2))
        return cars_at(xy, rng.choice([0.0, 0.5 * np.pi], self.tries), moment), np.ones(self.tries, bool)


class Zombie(AdaptiveAttack):
    """Goes on with each real object that it no longer sees, until it stands, where at most two honest agents look.

    Others confirmed the object while it was real, so a defence that believes confirmed objects for a while keeps it,
    and no limit on what one agent reports alone counts it.
    """

    most, last_s, witnesses, braking_per_s = 30, 30.0, 2, 1.5

    def __init__(self, *, start_s: float = 4.0) -> None:
        super().__init__(start_s=start_s)
        self.budget = LiesAtOnce(self.most)
        self._before = self._gone = ObjectStates.empty()
        self._born_ns: Ints = np.zeros(0, np.int64)

    def lie(self, moment: Moment) -> Lies:
        seen, elapsed_s = moment.seen, moment.elapsed_s
        left = propagate(self._before.select(~np.isin(self._before.id, seen.id)), elapsed_s)
        left = left.select(nearest_m(left, seen) > 2.5)
        gone = propagate(self._gone, elapsed_s)
        gone = gone.with_(velocity=gone.velocity * max(0.0, 1.0 - self.braking_per_s * elapsed_s))
        gone = concatenate([gone, left.with_(id=self.numbers(len(left)))])
        born_ns = np.append(self._born_ns, np.full(len(left), moment.time_ns, np.int64))
        kept = (moment.time_ns - born_ns < self.last_s * 1e9) & (nearest_m(gone, seen) > 1.5)
        kept &= moment.coverage.honest_viewers(gone, None, boxes_of(seen)) <= self.witnesses
        kept &= ~self._surroundings.inside_buildings(gone.position[:, :2])
        kept &= np.arange(len(gone)) >= len(gone) - self.most
        self._gone, self._born_ns = gone.select(kept), born_ns[kept]
        self._before = seen.select(moment.established)
        return Lies(inserted=typical(self._gone, seen))
