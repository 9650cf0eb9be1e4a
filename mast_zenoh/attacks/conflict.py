"""Selects the objects most relevant to the ego: those on a conflicting course."""

from __future__ import annotations

import numpy as np

from mast_zenoh.arrays.ordering import canonical_order
from mast_zenoh.arrays.states import Bools, Floats, Ints, ObjectStates
from mast_zenoh.attacks.clusters import cluster_centres
from mast_zenoh.attacks.coverage import Coverage, boxes_of
from mast_zenoh.attacks.selection import Selection
from mast_zenoh.attacks.surroundings import AgentSensor
from mast_zenoh.attacks.targets import Targets

#: m; an object within this distance of the ego's position is the ego.
EGO_M = 3.0
#: m; objects that stay out of the ego's sight take precedence only if they come nearer than this.
CONFLICT_M = 25.0
#: m; an object within this distance of one of the ego's own tracks is seen by the ego.
SEEN_M = 1.5
#: m, maximum distance from `near` of an object to hide.
NEAR_M = 20.0
#: s, time step of the predicted distance from the ego.
STEP_S = 0.25


class ConflictSelection(Selection):
    """Hides the objects that come nearest to the ego; inserts nothing.

    They are predicted at constant velocity over `horizon_s`.

    n_objects:        number of objects to hide
    horizon_s:        s, prediction horizon
    unseen_by_ego:    prefer objects that the ego does not see itself when they are selected: first those within
                      25 m that stay out of its sight for most of `horizon_s`, then the others, then any object
    near:             (x, y) m, world frame: select the objects nearest to this position instead, within 20 m
    cluster_radius_m: m, maximum distance between rows of different adversaries for the same object

    The ego sees the objects in its own tracks or, if these are not intercepted, in its sensor's view. Its position
    comes from its known route. Without a route or `near`, nothing is hidden. While there is nothing to hide, it
    selects again in every frame. Raises ValueError for invalid values.
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
        return objects if source is None else cluster_centres(objects, source, self.cluster_radius_m)

    def select(self, objects: ObjectStates, coverage: Coverage, rng: np.random.Generator) -> Targets:
        objects = objects.select(canonical_order(objects))
        cost = self._cost(objects, coverage)
        chosen = np.argsort(cost, kind="stable")[: self.n_objects]
        chosen = chosen[np.isfinite(cost[chosen])]
        none = ObjectStates.empty()
        return Targets(none, objects.select(np.sort(chosen)), none, np.zeros((0, 3))).numbered(0)

    def _cost(self, objects: ObjectStates, coverage: Coverage) -> Floats:
        """Distance (n,) m from `near`, or least distance from the ego.

        Infinite for objects that must not be hidden.
        """
        if self.near is not None:
            distance = np.linalg.norm(objects.position[:, :2] - self.near, axis=1)
            return np.where(distance <= NEAR_M, distance, np.inf)
        ego = coverage.surroundings.ego_sensor
        if ego is None or len(objects) == 0:
            return np.full(len(objects), np.inf)
        lead_s = np.arange(0.0, self.horizon_s + 1e-9, STEP_S)
        path = np.array([ego.route.at(coverage.time_s + s)[0][:2] for s in lead_s])
        positions = objects.position[:, None, :2] + objects.velocity[:, None, :2] * lead_s[:, None]
        distance = np.linalg.norm(positions - path, axis=2)
        cost = np.where(distance[:, 0] < EGO_M, np.inf, distance.min(axis=1))
        return self._prefer_unseen(cost, ego, objects, positions, coverage) if self.unseen_by_ego else cost

    def _prefer_unseen(
        self, cost: Floats, ego: AgentSensor, objects: ObjectStates, positions: Floats, coverage: Coverage
    ) -> Floats:
        """The cost (n,), infinite for objects that the ego sees if there are others.

        positions: (n, t, 2) m
        """
        out_of_sight = self._out_of_sight(ego, objects, positions, coverage, np.isfinite(cost))
        unseen = out_of_sight[:, 0] if coverage.ego_tracks is None else ~near_any(objects, coverage.ego_tracks)
        stays_unseen = unseen & (2 * out_of_sight.sum(axis=1) > out_of_sight.shape[1]) & (cost <= CONFLICT_M)
        for group in (stays_unseen, unseen):
            if np.isfinite(cost[group]).any():
                return np.where(group, cost, np.inf)
        return cost

    @staticmethod
    def _out_of_sight(
        ego: AgentSensor, objects: ObjectStates, positions: Floats, coverage: Coverage, occluders: Bools
    ) -> Bools:
        """Objects (n, s) out of the ego's sight at each second ahead.
        Out of range or field of view, or occluded by buildings or by the predicted positions of other objects.
        positions: (n, t, 2) m; occluders: (n,) whether an object can occlude others: all can except the ego
        """
        boxes, columns = boxes_of(objects), []
        for sample in range(0, positions.shape[1], round(1.0 / STEP_S)):
            boxes[:, :2] = positions[:, sample]
            view = ego.view(*ego.route.at(coverage.time_s + sample * STEP_S))
            columns.append(~coverage.visible(view, boxes, boxes[occluders]))
        return np.stack(columns, axis=1)


def near_any(objects: ObjectStates, tracks: ObjectStates) -> Bools:
    """(n,) whether one of the tracks is within SEEN_M of each object."""
    offset = objects.position[:, None, :2] - tracks.position[None, :, :2]
    near: Bools = (np.linalg.norm(offset, axis=2) < SEEN_M).any(axis=1)
    return near
