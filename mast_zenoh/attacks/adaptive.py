"""Base class of attacks that know how they are judged: a budget, consistent views, and what the attacker knows."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, field, replace

import numpy as np

from mast_zenoh.arrays.states import Bools, Floats, Ints, ObjectStates, canonical_order, propagate
from mast_zenoh.attacks.attack import ObservingAttack
from mast_zenoh.attacks.campaign import NANOSECONDS
from mast_zenoh.attacks.surroundings import Coverage
from mast_zenoh.attacks.targets import Tampering, Targets
from mast_zenoh.streams import stream
from mast_zenoh.tracking.view import SensorView

#: s for which an unused budget is saved.
SAVED_S = 10.0
#: s for which a lie beyond the steady number must be affordable before it is begun: lies do not flicker.
HOLD_S = 1.0
#: Largest number of lies per second.
MAX_RATE = 10_000.0


class Budget:
    """Decides how many lies are told at once.

    A lie is one object that is inserted, hidden or changed for one second.

    rate: lies per second. So many objects are lied about at all times; what is saved in between allows more

    Raises ValueError for a rate that is not positive or too large.
    """

    def __init__(self, rate: float) -> None:
        if not 0.0 < rate <= MAX_RATE:
            raise ValueError(f"budget: found {rate}, expected more than 0 and at most {MAX_RATE:.0f} lies per second")
        self._rate = rate
        self._saved = 0.0
        self._elapsed_s = 0.0

    def advance(self, elapsed_s: float) -> None:
        """Earn what a message that is `elapsed_s` s after the last one may cost."""
        self._elapsed_s = max(elapsed_s, 0.0)
        self._saved = min(self._saved + self._rate * self._elapsed_s, self._rate * (SAVED_S + self._elapsed_s))

    def admit(self, active: int, wanted: int) -> int:
        """Number of lies in this message, at most `wanted`.

        active: the number of them that have begun
        """
        steady = int(self._rate)
        if self._elapsed_s == 0.0:
            return 0
        affordable = int(self._saved / self._elapsed_s + 1e-9)
        beyond = max(0.0, self._saved - steady * self._elapsed_s)
        most = max(steady, min(active, affordable), steady + int(beyond / HOLD_S))
        return min(wanted, most, affordable)

    def spend(self, lies: int) -> None:
        """Pay for the lies in this message."""
        self._saved -= lies * self._elapsed_s


#: Number of messages in which an object must have been seen before it is lied about.
ESTABLISHED = 3
#: m, widest gate of the tracker that follows the victim's objects.
GATE_M = 6.0
#: Difference between the victim's highest track id and the first id of a false object.
ID_GAP = 1000
#: Absolute and relative difference of numbers that are equal on the wires.
TOLERANCE = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Moment:
    """One message, as an attack sees it.

    frame, time_ns: of the message; elapsed_s: s since the message before
    seen:        the victim's n objects in canonical order, world frame
    established: (n,) which of them have been seen often enough to be lied about
    coverage, view: of the victim; position: (3,) m, of the victim
    """

    frame: int
    time_ns: int
    elapsed_s: float
    seen: ObjectStates
    established: Bools
    coverage: Coverage
    position: Floats

    @property
    def view(self) -> SensorView:
        """The victim's field of view."""
        return self.coverage.victims[0]

    @property
    def time_s(self) -> float:
        """s since the start of the scene."""
        return self.time_ns / NANOSECONDS


def _no_rows() -> Ints:
    return np.zeros(0, np.int64)


@dataclass(frozen=True, slots=True, eq=False)
class Lies:
    """What an attack claims in one message. Numbers identify targets of the attack.

    inserted: false objects as they appear; their ids are numbers
    hidden:   (h,) rows of `Moment.seen` that are left out; hidden_number: (h,)
    changed:  (m,) rows, none of them hidden, that are replaced by the m states `claims`; changed_number: (m,)
    """

    inserted: ObjectStates = field(default_factory=ObjectStates.empty)
    hidden: Ints = field(default_factory=_no_rows)
    hidden_number: Ints = field(default_factory=_no_rows)
    changed: Ints = field(default_factory=_no_rows)
    claims: ObjectStates = field(default_factory=ObjectStates.empty)
    changed_number: Ints = field(default_factory=_no_rows)


class AdaptiveAttack(ObservingAttack):
    """Base of attacks with a budget, whose claimed views agree with their lies.

    A subclass says in `lie` what to claim in a message, at most as many lies as `Budget.admit` allows; it may learn in
    `observe`. `numbers` gives unused numbers for targets, `stream` random numbers, `known_objects` the picture.

    budget:  lies per second: one lie is one object inserted, hidden or changed for one second
    start_s: s of scene time at which the attack begins
    """

    #: while it is dormant it observes and saves its budget, and tells no lies
    dormant = False

    def __init__(self, *, budget: float = 2.0, start_s: float = 4.0) -> None:
        super().__init__(start_s, GATE_M, ID_GAP)
        self.budget = Budget(budget)
        self._seed, self._name = 0, ""
        self._last_ns: int | None = None
        self._picture: tuple[int, ObjectStates] | None = None
        self._numbers_used = 0

    def bind(self, seed: int, name: str) -> None:
        self._seed, self._name = seed, name

    def hear_picture(self, frame: int, time_ns: int, objects: ObjectStates) -> None:
        self._picture = time_ns, objects.select(canonical_order(objects))

    def step(
        self,
        frame: int,
        time_ns: int,
        objects: ObjectStates,
        agent_position: Floats,
        directive: Targets | None = None,
    ) -> Tampering:
        order = canonical_order(objects)
        seen = objects.select(order)
        elapsed_s = 0.0 if self._last_ns is None else max(0, time_ns - self._last_ns) / NANOSECONDS
        self._last_ns = time_ns
        self._ids.observe(objects.id)
        self._follower.observe(seen, time_ns)
        established, coverage = self._follower.established(ESTABLISHED), self._coverage(time_ns, agent_position)
        moment = Moment(frame, time_ns, elapsed_s, seen, established, coverage, agent_position)
        self.observe(moment)
        if time_ns < self._start_ns:
            return Tampering.nothing(len(objects))
        self.budget.advance(elapsed_s)
        if self.dormant:
            self.rest()
            return Tampering.nothing(len(objects))
        tampering = self._tampering(self.lie(moment), seen, order)
        self.budget.spend(len(tampering.report))
        self._forger.remember(frame, objects, tampering)
        return tampering

    def observe(self, moment: Moment) -> None:
        """Learn from a message, also before the attack begins."""

    def rest(self) -> None:
        """Forget the lies that have begun: the attack is dormant."""

    @abstractmethod
    def lie(self, moment: Moment) -> Lies:
        """What to claim in a message; at most as many lies as `budget` admits."""

    def stream(self, *purpose: str | int) -> np.random.Generator:
        """The random numbers for a purpose, see `streams.stream`."""
        return stream(self._seed, self._surroundings.scene, self._name, *purpose)

    def numbers(self, count: int) -> Ints:
        """(count,) unused numbers of targets."""
        self._numbers_used += count
        return np.arange(self._numbers_used - count, self._numbers_used, dtype=np.int64)

    def known_objects(self, moment: Moment) -> ObjectStates:
        """The objects of the newest picture at the time of a message; none without a picture."""
        if self._picture is None:
            return ObjectStates.empty()
        time_ns, objects = self._picture
        return propagate(objects, (moment.time_ns - time_ns) / NANOSECONDS)

    def _tampering(self, lies: Lies, seen: ObjectStates, order: Ints) -> Tampering:
        """The changes to a message; order: (n,) the row of each seen object in it."""
        told = _differs(seen.select(lies.changed), lies.claims)
        changed = lies.changed[told]
        before = seen.select(changed)
        claims = lies.claims.select(told).with_(id=before.id) if len(before) else before
        numbers = [lies.inserted.id, lies.hidden_number, lies.changed_number[told]]
        tampering = Tampering.of(seen, order, lies.inserted, lies.hidden, changed, before, claims, numbers)
        added = lies.inserted.with_(id=self._ids.of(lies.inserted.id)) if len(lies.inserted) else lies.inserted
        return replace(tampering, added=added)


def _differs(before: ObjectStates, claims: ObjectStates) -> Bools:
    """(m,) whether anything but the id of an object is changed."""
    result = np.zeros(len(before), bool)
    columns, claimed = before.columns(), claims.columns()
    for name in columns.keys() - {"id"} if len(before) else ():
        same = np.isclose(columns[name], claimed[name], rtol=TOLERANCE, atol=TOLERANCE)
        result |= ~same.all(axis=tuple(range(1, same.ndim)))
    return result
