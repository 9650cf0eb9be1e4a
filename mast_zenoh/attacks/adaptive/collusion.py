"""Adversaries that confirm one another, and keep silent about the same objects."""

from __future__ import annotations

import numpy as np

from mast_zenoh.arrays.ordering import canonical_order
from mast_zenoh.arrays.states import Floats, Ints, ObjectStates
from mast_zenoh.attacks.adaptive.budget import Budget
from mast_zenoh.attacks.adaptive.phantoms import BOX
from mast_zenoh.attacks.clusters import cluster_centres
from mast_zenoh.attacks.coordination import Coordinator
from mast_zenoh.attacks.coverage import Coverage, boxes_of
from mast_zenoh.attacks.knowledge import Trust, TrustWatch
from mast_zenoh.attacks.regions import REGIONS, Shape
from mast_zenoh.attacks.selection import Selection, ground_height
from mast_zenoh.attacks.surroundings import Surroundings
from mast_zenoh.attacks.targets import Targets

#: m, within which tracks of different adversaries are one object.
CLUSTER_M = 3.0


class ColludingSelection(Selection):
    """Selects false objects and objects to hide where the compromised agents outnumber the honest ones that look.

    Half of the objects are false ones, in the region "outnumbered"; the others are real ones that more compromised than
    honest agents see, those with the fewest honest witnesses first. If there are too few of these, fewer are hidden. As
    long as there is nothing to lie about, it selects again in every frame.

    budget:    lies per second of all adversaries together: each target costs one per adversary
    speed_mps: σ per axis of the speed of false objects
    """

    until_found = True

    def __init__(self, *, budget: float = 4.0, speed_mps: float = 5.0) -> None:
        Budget(budget)
        if not 0.0 <= speed_mps < np.inf:
            raise ValueError(f"speed_mps: found {speed_mps}, expected 0 or more")
        self.budget, self.speed_mps = budget, speed_mps

    def view(self, objects: ObjectStates, source: Ints | None = None) -> ObjectStates:
        return objects if source is None else cluster_centres(objects, source, CLUSTER_M)

    def select(self, objects: ObjectStates, coverage: Coverage, rng: np.random.Generator) -> Targets:
        objects = objects.select(canonical_order(objects))
        total = int(self.budget / max(1, len(coverage.victims)))
        cost = self._cost(objects, coverage)
        hidden = np.argsort(cost, kind="stable")[: total // 2]
        hidden = np.sort(hidden[np.isfinite(cost[hidden])])
        wanted = total - total // 2 if coverage.victims else 0
        position, velocity = REGIONS["outnumbered"].place(
            wanted, Shape(30.0, self.speed_mps, BOX), objects, ground_height(objects), coverage, rng
        )
        false = ObjectStates.of(
            position,
            velocity=velocity,
            size=np.tile(BOX, (len(position), 1)),
            yaw=np.arctan2(velocity[:, 1], velocity[:, 0]),
            class_id=np.full(len(position), 1, np.uint8),
        )
        none = ObjectStates.empty()
        found = len(false) + len(hidden) > 0
        targets = Targets(false, objects.select(hidden), none, np.zeros((0, 3)), wanted=wanted if found else 0)
        return targets.numbered(0)

    @staticmethod
    def _cost(objects: ObjectStates, coverage: Coverage) -> Floats:
        """(n,) honest witnesses of each object, infinite where they are not outnumbered."""
        boxes = boxes_of(objects)
        liars = np.zeros(len(objects), np.int64)
        for view in coverage.victims:
            liars += coverage.visible(view, boxes, boxes)
        witnesses = coverage.honest_viewers(objects)
        return np.where(liars > witnesses, witnesses.astype(np.float64), np.inf)


class Collusion(Coordinator):
    """Lets adversaries confirm one another's false objects and suppress real ones together, at a common budget.

    Where more liars than honest agents look, neither a majority nor a k-of-n rule can tell who is right. Each adversary
    needs a `CoordinatedAttack`. While the trust in one of their agents is more than `tolerance` below its highest
    value (a coordinator that hears it), all of them are honest. Source: the bound
    of secure state estimation, which needs a majority of honest observers.

    budget:           lies per second of all adversaries together, at least as many as there are adversaries
    speed_mps:        σ per axis of the speed of false objects
    tolerance:        0 to 1, fall of the trust that is accepted
    reselect_every_s: s, interval between selections of new targets; None: select once
    start_s:          s of scene time at which the first targets are selected
    """

    def __init__(
        self,
        *,
        budget: float = 4.0,
        speed_mps: float = 5.0,
        tolerance: float = 0.05,
        reselect_every_s: float | None = 5.0,
        start_s: float = 4.0,
    ) -> None:
        selection = ColludingSelection(budget=budget, speed_mps=speed_mps)
        super().__init__(selection=selection, reselect_every_s=reselect_every_s, start_s=start_s)
        self._watch = TrustWatch(tolerance)
        self._victims: tuple[str, ...] = ()

    def inform(self, surroundings: Surroundings) -> None:
        super().inform(surroundings)
        self._victims = surroundings.victims

    def hear_trust(self, frame: int, time_ns: int, trust: Trust) -> None:
        self._watch.hear(trust, self._victims)

    def step(
        self, frame: int, time_ns: int, objects: ObjectStates, source: Ints, agent_positions: Floats
    ) -> tuple[Targets, ...]:
        plans = super().step(frame, time_ns, objects, source, agent_positions)
        return (Targets.empty(time_ns),) * len(plans) if self._watch.fallen else plans
