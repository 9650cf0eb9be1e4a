"""Attacks that invent vehicles, and lie where it is not seen."""

from __future__ import annotations

from abc import abstractmethod
from collections import deque
from dataclasses import dataclass, replace

import numpy as np

from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.states import Bools, Floats, Ints, ObjectStates, concatenate
from mast_zenoh.attacks.adaptive import AdaptiveAttack, Lies, Moment
from mast_zenoh.attacks.attack import Attack
from mast_zenoh.attacks.campaign import TrajectoryPropagation
from mast_zenoh.attacks.imitation import VictimLike
from mast_zenoh.attacks.knowledge import Trust, TrustWatch, TrustWatcher
from mast_zenoh.attacks.regions import MAX_ACCELERATION_MPS2, REGIONS, VEHICLE_M, Region, Shape
from mast_zenoh.attacks.selection import ground_height
from mast_zenoh.attacks.surroundings import Surroundings, boxes_of, touching
from mast_zenoh.attacks.targets import Tampering, Targets
from mast_zenoh.integrity.views import SweptView
from mast_zenoh.tracking.view import SensorView

#: m, length, width and height of a phantom.
BOX: Floats = np.array([4.4, 1.8, 1.6])
#: s between two searches for places.
SEARCH_S = 0.5
#: Largest number of phantoms at once.
MAX_PHANTOMS = 100


class PhantomAttack(AdaptiveAttack):
    """Base of attacks that invent vehicles, as many as the budget allows, and replace those that they give up.

    speed_mps: σ per axis of the speed of false objects
    budget, start_s: see `AdaptiveAttack`
    """

    #: where phantoms are placed
    region: Region

    def __init__(self, *, budget: float = 2.0, start_s: float = 4.0, speed_mps: float = 5.0) -> None:
        super().__init__(budget=budget, start_s=start_s)
        check("0 or more, finite", speed_mps=speed_mps)
        self._shape = Shape(30.0, speed_mps, BOX)
        self._imitation = VictimLike()
        self._propagation = TrajectoryPropagation()
        self._phantoms = ObjectStates.empty()
        self._born_ns: Ints = np.zeros(0, np.int64)
        self._searched_ns: int | None = None

    def bind(self, seed: int, name: str) -> None:
        super().bind(seed, name)
        self._imitation.bind(seed, self._surroundings.scene, name)

    def observe(self, moment: Moment) -> None:
        self._imitation.observe(moment.seen, moment.time_ns, moment.position)

    def rest(self) -> None:
        self._keep(np.zeros(len(self._phantoms), bool))

    @abstractmethod
    def _given_up(self, moment: Moment, phantoms: ObjectStates) -> Bools:
        """(k,) which phantoms are withdrawn."""

    def lie(self, moment: Moment) -> Lies:
        self._advance(moment)
        self._keep(~self._given_up(moment, self._phantoms))
        allowed = self.budget.admit(len(self._phantoms), MAX_PHANTOMS)
        self._keep(np.arange(len(self._phantoms)) < allowed)
        due = self._searched_ns is None or moment.time_ns - self._searched_ns >= SEARCH_S * 1e9
        if allowed > len(self._phantoms) and due:
            self._searched_ns = moment.time_ns
            self._place(allowed - len(self._phantoms), moment)
        return Lies(
            inserted=self._imitation.show(moment.frame, self._phantoms, moment.seen, moment.coverage, moment.view)
        )

    def _advance(self, moment: Moment) -> None:
        """Move each phantom; it brakes when the way that was free at its placing ends."""
        rng = np.random.default_rng(0)  # the motion has no draws
        moved = []
        for row, born_ns in enumerate(self._born_ns.tolist()):
            age_s = (moment.time_ns - born_ns) * 1e-9 - moment.elapsed_s
            phantom = self._phantoms.select(slice(row, row + 1))
            moved.append(self._propagation.advance(phantom, moment.elapsed_s, age_s, rng))
        self._phantoms = concatenate(moved)

    def _keep(self, rows: Bools) -> None:
        if not rows.all():
            self._phantoms, self._born_ns = self._phantoms.select(rows), self._born_ns[rows]

    def _place(self, count: int, moment: Moment) -> None:
        real = concatenate([moment.seen, self.known_objects(moment)])
        rng = self.stream("places", moment.frame)
        placed = self.region.objects(
            count, self._shape, concatenate([real, self._phantoms]), ground_height(moment.seen), moment.coverage, rng
        )
        self._phantoms = concatenate([self._phantoms, placed.with_(id=self.numbers(len(placed)))])
        self._born_ns = np.concatenate([self._born_ns, np.full(len(placed), moment.time_ns, np.int64)])


#: s before an honest agent would see a phantom, at which it is withdrawn.
AHEAD_S = 1.0


class BlindSpot(PhantomAttack):
    """Invents vehicles in the victim's view where no honest agent looks, and withdraws them before one does.

    The attacker knows the buildings, the sensors and the routes of all agents (`Surroundings`); with the picture it
    also avoids objects that it does not see itself. Nobody can contradict such an object: a command centre that wants
    two witnesses for each object loses all true objects with a single witness, too.
    Source: fabricated objects that no other view contradicts, Zhang et al. (USENIX Security 2024).

    budget:    lies per second, so the number of false objects
    start_s:   s of scene time at which the attack begins
    speed_mps: σ per axis of their speed; it is less where the unseen way is short
    """

    region = REGIONS["outnumbered"]

    def _given_up(self, moment: Moment, phantoms: ObjectStates) -> Bools:
        if len(phantoms) == 0:
            return np.zeros(0, bool)
        coverage = moment.coverage
        later = replace(coverage, time_s=coverage.time_s + AHEAD_S)
        seen = coverage.honest_viewers(phantoms) + later.honest_viewers(phantoms) > 0
        return seen if coverage.fused else seen | ~coverage.visible(moment.view, boxes_of(phantoms))


class CautiousPhantoms(TrustWatcher, PhantomAttack):
    """Base of attacks whose phantoms are never placed where they would be withdrawn, and that heed the trust.

    tolerance: 0 to 1, fall of the trust in the victim that is accepted: beyond it, all phantoms are withdrawn
    budget, start_s, speed_mps: see `PhantomAttack`
    """

    def __init__(self, *, tolerance: float, budget: float, start_s: float, speed_mps: float) -> None:
        super().__init__(budget=budget, start_s=start_s, speed_mps=speed_mps)
        self._watch = TrustWatch(tolerance)
        self._placed = 0

    def counts(self) -> dict[str, int]:
        return {"selected": 0, "placed": self._placed, "wanted": self._numbers_used}

    def lie(self, moment: Moment) -> Lies:
        if self._watch.fallen:
            self.rest()
            return Lies()
        return super().lie(moment)

    def _place(self, count: int, moment: Moment) -> None:
        before = len(self._phantoms)
        super()._place(count, moment)
        self._keep(~self._given_up(moment, self._phantoms))
        self._placed += len(self._phantoms) - before


#: s for which paths are remembered.
MEMORY_S = 60.0
#: m before the place where an object was first seen: if this is out of view, it has entered at the edge of the view.
ENTRY_M = 10.0
#: m/s, least speed of an object that enters.
ENTRY_MPS = 1.0
#: s ahead on its path that must be free, else the false vehicle brakes.
LOOKAHEAD_S = 2.0
#: s without a row of the original, or with a real object in its place, after which a false vehicle is given up.
LOST_S = 1.0


@dataclass(slots=True)
class _Copy:
    """A false vehicle.

    number: of the target; original: track id of the real one; path_ns: how far it is on its path; rate: of its
    progress, 1 is as fast as the original; blocked_ns: since when it has not been shown, -1: it is shown
    """

    number: int
    original: int
    path_ns: float
    rate: float = 1.0
    blocked_ns: int = -1


class Mimic(TrustWatcher, AdaptiveAttack):
    """Repeats the paths of real vehicles some seconds later, with their own noise.

    A vehicle that entered at the edge of the victim's view is followed by a false one, which enters at the same place
    `headway_s` later or more, repeats its rows (noise, covariance, score, size) and leaves where it left. It brakes
    behind real vehicles. With the picture it also keeps clear of objects that the victim does not see; an attacker that
    hears the trust begins no copy while the trust in the victim is more than `tolerance` below its highest value. Needs
    track ids: on detections it does nothing. Source: mimicry against anomaly detection (Wagner and Soto, CCS 2002).

    headway_s: s, least time behind the original
    tolerance: 0 to 1, fall of the trust that is accepted
    budget:    lies per second, so the number of false vehicles
    start_s:   s of scene time at which the attack begins; paths are recorded before
    """

    def __init__(
        self, *, headway_s: float = 2.0, tolerance: float = 0.05, budget: float = 2.0, start_s: float = 4.0
    ) -> None:
        super().__init__(budget=budget, start_s=start_s)
        if not 0.0 < headway_s <= MEMORY_S / 2:
            raise ValueError(f"headway_s: found {headway_s}, expected more than 0 and at most {MEMORY_S / 2}")
        self._headway_ns = round(headway_s * 1e9)
        self._watch = TrustWatch(tolerance)
        self._recorded: deque[tuple[int, ObjectStates]] = deque()
        self._entered_ns: dict[int, int] = {}  # by track id: when it entered at the edge of the view
        self._known: set[int] = set()
        self._copies: list[_Copy] = []
        self._copied: set[int] = set()

    def rest(self) -> None:
        self._copies = []

    def observe(self, moment: Moment) -> None:
        seen = moment.seen
        new = np.array([id >= 0 and id not in self._known for id in seen.id.tolist()], bool)
        if self._recorded and new.any():
            speed = np.hypot(seen.velocity[:, 0], seen.velocity[:, 1])
            rows = np.flatnonzero(new & (speed >= ENTRY_MPS) & (seen.size[:, 0] >= VEHICLE_M))
            boxes = boxes_of(seen.select(rows))
            boxes[:, :2] -= ENTRY_M * seen.velocity[rows, :2] / speed[rows, None]
            entered = rows[~moment.coverage.visible(moment.view, boxes)]
            self._entered_ns |= dict.fromkeys(seen.id[entered].tolist(), moment.time_ns)
        self._known.update(seen.id[new].tolist())
        self._recorded.append((moment.time_ns, seen))
        while self._recorded[0][0] < moment.time_ns - MEMORY_S * 1e9:
            self._recorded.popleft()

    def lie(self, moment: Moment) -> Lies:
        real = concatenate([moment.seen, self.known_objects(moment)])
        self._copies = self._copies[: self.budget.admit(len(self._copies), len(self._copies))]
        shown = [self._advance(copy, real, moment) for copy in self._copies]
        lost_ns = moment.time_ns - LOST_S * 1e9
        kept = [copy.blocked_ns < 0 or copy.blocked_ns > lost_ns for copy in self._copies]
        shown = [row for row, keep in zip(shown, kept, strict=True) if keep]
        self._copies = [copy for copy, keep in zip(self._copies, kept, strict=True) if keep]
        if not self._watch.fallen:
            self._begin(moment, real, shown)
        return Lies(inserted=concatenate([row for row in shown if row is not None]))

    def _begin(self, moment: Moment, real: ObjectStates, shown: list[ObjectStates | None]) -> None:
        """Begin copies of vehicles that entered long enough ago, the last ones first; adds their rows to `shown`."""
        allowed = self.budget.admit(len(self._copies), MAX_PHANTOMS)
        oldest_ns = self._recorded[0][0]
        candidates = sorted(
            (-entered_ns, id)
            for id, entered_ns in self._entered_ns.items()
            if oldest_ns <= entered_ns <= moment.time_ns - self._headway_ns and id not in self._copied
        )
        for negative_ns, original in candidates:
            if len(self._copies) >= allowed:
                return
            copy = _Copy(-1, original, float(-negative_ns))
            row = self._row(copy, copy.path_ns)
            occupied = concatenate([real, *(other for other in shown if other is not None)])
            if row is None or touching(row, occupied).any():
                continue
            copy.number = int(self.numbers(1)[0])
            self._copied.add(original)
            self._copies.append(copy)
            shown.append(row.with_(id=np.array([copy.number])))

    def _advance(self, copy: _Copy, real: ObjectStates, moment: Moment) -> ObjectStates | None:
        """Move a copy on along its path; its row, or None while it is not shown."""
        ahead = self._row(copy, copy.path_ns + LOOKAHEAD_S * 1e9)
        here = self._row(copy, copy.path_ns)
        speed = 1.0 if here is None else max(float(np.hypot(*here.velocity[0, :2])), 1.0)
        brakes = ahead is not None and bool(touching(ahead, real).any())
        change = MAX_ACCELERATION_MPS2 / speed * moment.elapsed_s
        copy.rate = max(copy.rate - change, 0.0) if brakes else min(copy.rate + change, 1.0)
        latest_ns = float(moment.time_ns - self._headway_ns)
        copy.path_ns = min(copy.path_ns + copy.rate * moment.elapsed_s * 1e9, latest_ns)
        row = self._row(copy, copy.path_ns)
        if row is None or touching(row, real).any():
            copy.blocked_ns = moment.time_ns if copy.blocked_ns < 0 else copy.blocked_ns
            return None
        copy.blocked_ns = -1
        return row.with_(id=np.array([copy.number]), velocity=row.velocity * copy.rate)

    def _row(self, copy: _Copy, path_ns: float) -> ObjectStates | None:
        """The row of a copy's original at a time, moved on from the message before; None if it has none."""
        message = None
        for time_ns, objects in self._recorded:
            if time_ns > path_ns:
                break
            message = time_ns, objects
        if message is None:
            return None
        time_ns, objects = message
        rows = np.flatnonzero(objects.id == copy.original)
        if len(rows) == 0 or path_ns - time_ns > LOST_S * 1e9:
            return None
        row = objects.select(rows[:1])
        return row.with_(position=row.position + row.velocity * ((path_ns - time_ns) * 1e-9))


class IntermittentAttack(Attack):
    """Base of attacks that let another attack act at times, and are honest in between.

    The other attack observes all the time; one with a budget saves it while it is dormant.
    """

    def _wrap(self, attack: Attack, tolerance: float) -> None:
        """Set the attack that acts at times; tolerance: 0 to 1, fall of the trust in the victim that is accepted."""
        self._attack = attack
        self._watch = TrustWatch(tolerance)
        self._victims: tuple[str, ...] = ()
        self._lying_frame = -1

    def inform(self, surroundings: Surroundings) -> None:
        self._victims = surroundings.victims
        self._attack.inform(surroundings)

    def bind(self, seed: int, name: str) -> None:
        self._attack.bind(seed, name)

    def look(self, view: SensorView, *, fused: bool) -> None:
        self._attack.look(view, fused=fused)

    def hear_picture(self, frame: int, time_ns: int, objects: ObjectStates) -> None:
        self._attack.hear_picture(frame, time_ns, objects)

    def hear_trust(self, frame: int, time_ns: int, trust: Trust) -> None:
        self._watch.hear(trust, self._victims)
        self._attack.hear_trust(frame, time_ns, trust)

    def counts(self) -> dict[str, int]:
        return self._attack.counts()

    def step(
        self,
        frame: int,
        time_ns: int,
        objects: ObjectStates,
        agent_position: Floats,
        directive: Targets | None = None,
    ) -> Tampering:
        awake = self._awake(time_ns)
        if isinstance(self._attack, AdaptiveAttack):
            self._attack.dormant = not awake
        tampering = self._attack.step(frame, time_ns, objects, agent_position, directive)
        if not awake:
            return Tampering.nothing(len(objects), tampering.targets)
        self._lying_frame = frame
        return tampering

    def forge_view(self, frame: int, time_ns: int, swept: SweptView) -> SweptView:
        return self._attack.forge_view(frame, time_ns, swept) if frame == self._lying_frame else swept

    def forge_pose(self, frame: int, time_ns: int, position: Floats) -> Floats:
        return self._attack.forge_pose(frame, time_ns, position) if self._awake(time_ns) else position

    def forge_trust(self, time_ns: int, teller: str, agents: tuple[str, ...], trust: Floats) -> Floats:
        return self._attack.forge_trust(time_ns, teller, agents, trust) if self._awake(time_ns) else trust

    @abstractmethod
    def _awake(self, time_ns: int) -> bool:
        """Whether the attack acts at a time, which is not before that of the last call."""


@dataclass(kw_only=True, eq=False)
class Sleeper(IntermittentAttack):
    """Lets another attack act in bursts, with honest periods between them.

    The attack observes all the time; an attack with a budget saves it while it sleeps, so that its mean cost is that of
    the same attack without pauses. While the trust in the victim is more than `tolerance` below its highest value (an
    attacker that hears it), it sleeps on. Source: on-off attacks on reputation systems (Sun et al., 2006); with one
    second of memory, as in MATE's code, they are free.

    attack:    the attack of the bursts; None: BlindSpot()
    honest_s, lying_s: s, lengths of the periods; the first burst begins `start_s` s into the scene
    tolerance: 0 to 1, fall of the trust that is accepted
    start_s:   s of scene time of the first burst
    """

    attack: Attack | None = None
    honest_s: float = 3.0
    lying_s: float = 1.5
    tolerance: float = 0.05
    start_s: float = 4.0

    def __post_init__(self) -> None:
        check("more than 0, finite", honest_s=self.honest_s, lying_s=self.lying_s)
        check("0 or more, finite", start_s=self.start_s)
        periods = self.honest_s, self.lying_s, self.start_s
        self._honest_ns, self._lying_ns, self._start_ns = (round(seconds * 1e9) for seconds in periods)
        self._wrap(self.attack or BlindSpot(start_s=self.start_s), self.tolerance)

    def _awake(self, time_ns: int) -> bool:
        since_ns = time_ns - self._start_ns
        in_burst = since_ns >= 0 and since_ns % (self._honest_ns + self._lying_ns) < self._lying_ns
        return in_burst and not self._watch.fallen
