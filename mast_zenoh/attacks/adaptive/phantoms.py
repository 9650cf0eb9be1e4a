"""False objects that an attack keeps alive, one by one."""

from __future__ import annotations

from abc import abstractmethod

import numpy as np

from mast_zenoh.arrays.states import CLASS_INDEX, Bools, Floats, Ints, ObjectStates, concatenate
from mast_zenoh.attacks.adaptive.base import AdaptiveAttack, Lies, Moment
from mast_zenoh.attacks.imitation import VictimLike
from mast_zenoh.attacks.propagation import TrajectoryPropagation
from mast_zenoh.attacks.regions import Region, Shape
from mast_zenoh.attacks.selection import ground_height

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

    def __init__(self, *, budget: float, start_s: float, speed_mps: float) -> None:
        super().__init__(budget=budget, start_s=start_s)
        if not 0.0 <= speed_mps < np.inf:
            raise ValueError(f"speed_mps: found {speed_mps}, expected 0 or more")
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
        if allowed > len(self._phantoms) and self._due(moment):
            self._searched_ns = moment.time_ns
            self._place(allowed - len(self._phantoms), moment)
        return Lies(
            inserted=self._imitation.show(moment.frame, self._phantoms, moment.seen, moment.coverage, moment.view)
        )

    def _due(self, moment: Moment) -> bool:
        return self._searched_ns is None or moment.time_ns - self._searched_ns >= SEARCH_S * 1e9

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
        position, velocity = self.region.place(
            count, self._shape, concatenate([real, self._phantoms]), ground_height(moment.seen), moment.coverage, rng
        )
        k = len(position)
        placed = ObjectStates.of(
            position,
            id=self.numbers(k),
            velocity=velocity,
            size=np.tile(BOX, (k, 1)),
            yaw=np.arctan2(velocity[:, 1], velocity[:, 0]),
            class_id=np.full(k, CLASS_INDEX["car"], np.uint8),
        )
        self._phantoms = concatenate([self._phantoms, placed])
        self._born_ns = np.concatenate([self._born_ns, np.full(k, moment.time_ns, np.int64)])
