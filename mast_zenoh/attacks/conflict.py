"""Choosing the object whose absence matters most: the one that comes nearest to the ego."""

from __future__ import annotations

import numpy as np

from mast_zenoh.arrays.ordering import canonical_order
from mast_zenoh.arrays.states import Bools, Floats, Ints, ObjectStates
from mast_zenoh.attacks.clusters import cluster_centres
from mast_zenoh.attacks.coverage import Coverage, boxes_of
from mast_zenoh.attacks.selection import Selection
from mast_zenoh.attacks.surroundings import AgentSensor
from mast_zenoh.attacks.targets import Targets

#: m; an object that is nearer than this to where the ego is, is the ego.
EGO_M = 3.0
#: m; an object that stays out of the ego's sight comes before one that does not only if it comes nearer than this.
CONFLICT_M = 25.0
#: m; an object with one of the ego's own tracks nearer than this is seen by the ego.
SEEN_M = 1.5
#: m from `near` beyond which nothing is hidden.
NEAR_M = 20.0
#: s, between two times at which the distance from the ego is looked at.
STEP_S = 0.25


class ConflictSelection(Selection):
    """Hides the objects that come nearest to the ego within `horizon_s`, at constant velocity; inserts nothing.

    n_objects:        how many to hide
    horizon_s:        s, how far ahead the attacker looks
    unseen_by_ego:    choose among the objects that the ego does not see itself when they are chosen: first those within
                      CONFLICT_M that stay out of its sight for most of `horizon_s`, then the others, then any object
    near:             (x, y) m, world frame: choose the objects nearest to this place instead, at most NEAR_M from it
    cluster_radius_m: m, within which rows of different adversaries are one object

    The ego sees what is in its own tracks, or, if no adversary sits on these, what its sensor has in view. Its place is
    that of its known route. Without one, and without `near`, nothing is hidden. While there is nothing to hide, it
    selects again in every frame. Raises ValueError for values that make no sense.
    """

    until_found = True

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
            distance = np.linalg.norm(objects.position[:, :2] - self.near, axis=1)
            return np.where(distance <= NEAR_M, distance, np.inf)
        ego = coverage.surroundings.ego_sensor
        if ego is None or len(objects) == 0:
            return np.full(len(objects), np.inf)
        ahead = np.arange(0.0, self.horizon_s + 1e-9, STEP_S)
        path = np.array([ego.route.at(coverage.time_s + s)[0][:2] for s in ahead])
        places = objects.position[:, None, :2] + objects.velocity[:, None, :2] * ahead[:, None]
        apart = np.linalg.norm(places - path, axis=2)
        cost = np.where(apart[:, 0] < EGO_M, np.inf, apart.min(axis=1))
        return self._first_unseen(cost, ego, objects, places, coverage) if self.unseen_by_ego else cost

    def _first_unseen(
        self, cost: Floats, ego: AgentSensor, objects: ObjectStates, places: Floats, coverage: Coverage
    ) -> Floats:
        """(n,) the cost (n,), infinite for objects that the ego sees, as long as others remain; places (n, t, 2) m."""
        out_of_sight = self._out_of_sight(ego, objects, places, coverage, np.isfinite(cost))
        unseen = out_of_sight[:, 0] if coverage.ego_tracks is None else ~near_any(objects, coverage.ego_tracks)
        stays_unseen = unseen & (2 * out_of_sight.sum(axis=1) > out_of_sight.shape[1]) & (cost <= CONFLICT_M)
        for group in (stays_unseen, unseen):
            if np.isfinite(cost[group]).any():
                return np.where(group, cost, np.inf)
        return cost

    @staticmethod
    def _out_of_sight(
        ego: AgentSensor, objects: ObjectStates, places: Floats, coverage: Coverage, others: Bools
    ) -> Bools:
        """(n, s) which objects are out of the ego's sight at each second ahead; places (n, t, 2) m.

        Out of range and of the field of view, behind buildings, or behind other objects where these are then.
        others: (n,) which objects are not the ego, and can hide one another
        """
        boxes, columns = boxes_of(objects), []
        for sample in range(0, places.shape[1], round(1.0 / STEP_S)):
            boxes[:, :2] = places[:, sample]
            view = ego.view(*ego.route.at(coverage.time_s + sample * STEP_S))
            columns.append(~coverage.visible(view, boxes, boxes[others]))
        return np.stack(columns, axis=1)


def near_any(objects: ObjectStates, tracks: ObjectStates) -> Bools:
    """(n,) which objects have one of the tracks within SEEN_M."""
    offset = objects.position[:, None, :2] - tracks.position[None, :, :2]
    near: Bools = (np.linalg.norm(offset, axis=2) < SEEN_M).any(axis=1)
    return near
