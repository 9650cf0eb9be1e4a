"""Choosing the object whose absence matters most: the one that comes nearest to the ego."""

from __future__ import annotations

import numpy as np

from mast_zenoh.attacks.clusters import cluster_centres
from mast_zenoh.attacks.coverage import Coverage, boxes_of
from mast_zenoh.attacks.ordering import canonical_order
from mast_zenoh.attacks.selection import Selection
from mast_zenoh.attacks.surroundings import AgentSensor
from mast_zenoh.attacks.targets import Targets
from mast_zenoh.states import Bools, Floats, Ints, ObjectStates

#: m; an object that is nearer than this to where the ego is, is the ego.
EGO_M = 3.0
#: m; an object that the ego cannot see is chosen before others only if it comes nearer than this.
CONFLICT_M = 25.0
#: s, between two times at which the distance from the ego is looked at.
STEP_S = 0.25


class ConflictSelection(Selection):
    """Hides the objects that come nearest to the ego within `horizon_s`, at constant velocity; inserts nothing.

    n_objects:        how many to hide
    horizon_s:        s, how far ahead the attacker looks
    unseen_by_ego:    choose among the objects that the ego cannot see itself for most of that time, if there are any:
                      it learns of them from others alone
    near:             (x, y) m, world frame: choose the objects nearest to this place instead
    cluster_radius_m: m, within which rows of different adversaries are one object

    The ego's place is that of its known route. Without one, and without `near`, nothing is hidden. Raises ValueError
    for values that make no sense.
    """

    def __init__(
        self,
        *,
        n_objects: int = 1,
        horizon_s: float = 6.0,
        unseen_by_ego: bool = True,
        near: tuple[float, float] | None = None,
        cluster_radius_m: float = 5.0,
    ) -> None:
        if n_objects < 1:
            raise ValueError(f"n_objects: found {n_objects}, expected 1 or more")
        if not horizon_s > 0.0:
            raise ValueError(f"horizon_s: found {horizon_s}, expected more than 0")
        self.n_objects = n_objects
        self.horizon_s = horizon_s
        self.unseen_by_ego = unseen_by_ego
        self.near = near
        self.cluster_radius_m = cluster_radius_m

    def view(self, objects: ObjectStates, source: Ints | None = None) -> ObjectStates:
        """See Selection."""
        return objects if source is None else cluster_centres(objects, source, self.cluster_radius_m)

    def select(self, objects: ObjectStates, coverage: Coverage, rng: np.random.Generator) -> Targets:
        """See Selection."""
        objects = objects.select(canonical_order(objects))
        cost = self._cost(objects, coverage)
        chosen = np.argsort(cost, kind="stable")[: self.n_objects]
        chosen = chosen[np.isfinite(cost[chosen])]
        none = ObjectStates.empty()
        return Targets(none, objects.select(np.sort(chosen)), none, np.zeros((0, 3))).numbered(0)

    def _cost(self, objects: ObjectStates, coverage: Coverage) -> Floats:
        """(n,) m from where the object is wanted or from the ego; infinite for what is not to be hidden."""
        if self.near is not None:
            offset = objects.position[:, :2] - self.near
            return np.hypot(offset[:, 0], offset[:, 1])
        ego = coverage.surroundings.ego_sensor
        if ego is None or len(objects) == 0:
            return np.full(len(objects), np.inf)
        ahead = np.arange(0.0, self.horizon_s + 1e-9, STEP_S)
        path = np.array([ego.route.at(coverage.time_s + s)[0][:2] for s in ahead])
        places = objects.position[:, None, :2] + objects.velocity[:, None, :2] * ahead[:, None]
        apart = np.linalg.norm(places - path, axis=2)
        cost = np.where(apart[:, 0] < EGO_M, np.inf, apart.min(axis=1))
        if self.unseen_by_ego:
            unseen = self._unseen(ego, objects, places, coverage, apart[:, 0] >= EGO_M) & np.isfinite(cost)
            unseen &= cost <= CONFLICT_M
            if unseen.any():
                cost = np.where(unseen, cost, np.inf)
        return cost

    @staticmethod
    def _unseen(ego: AgentSensor, objects: ObjectStates, places: Floats, coverage: Coverage, others: Bools) -> Bools:
        """(n,) which objects the ego cannot see for most of the time ahead; places (n, t, 2) m.

        others: (n,) which objects are not the ego, and can hide one another; where they are later is not looked at
        """
        boxes, unseen = boxes_of(objects), np.zeros(len(objects))
        samples = range(0, places.shape[1], round(1.0 / STEP_S))
        for sample in samples:
            boxes[:, :2] = places[:, sample]
            view = ego.view(*ego.route.at(coverage.time_s + sample * STEP_S))
            screens = boxes[others] if sample == 0 else boxes[:0]
            unseen += ~coverage.visible(view, boxes, screens)
        return np.asarray(2.0 * unseen > len(samples))
