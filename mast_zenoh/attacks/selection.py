"""Selects the objects to insert, hide and displace (paper: attack designs)."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.matching import merge_pairs, pairs_near
from mast_zenoh.arrays.states import CLASS_INDEX, Bools, Floats, Ints, ObjectStates, canonical_order
from mast_zenoh.attacks.regions import REGIONS, Shape
from mast_zenoh.attacks.surroundings import AgentSensor, Coverage, boxes_of
from mast_zenoh.attacks.targets import Targets
from mast_zenoh.errors import nearest


def cluster_centres(objects: ObjectStates, source: Ints, radius_m: float) -> ObjectStates:
    """Merge the observations of several adversaries into one row per object.

    Position and velocity are means; other columns come from one member.

    source (n,) int64: the observer of each row. The nearest two rows of different sources are merged first, if they
    are at most `radius_m` apart in the bird's-eye view and the cluster has at most one row per source.
    """
    if len(objects) == 0:
        return objects
    order = canonical_order(objects, source)
    position, source = objects.position.take(order, 0)[:, :2], source.take(order)
    i, j, squared = pairs_near(position, radius_m)
    pairs = (source.take(i) != source.take(j)).nonzero()[0]
    label = merge_pairs(position, source, i.take(pairs), j.take(pairs), squared.take(pairs), np.inf)
    by_member = label.argsort(kind="stable")
    rows, size = order.take(by_member), np.bincount(label)
    start = size.cumsum() - size
    motion = np.concatenate([objects.position.take(rows, 0), objects.velocity.take(rows, 0)], axis=1)
    mean = np.add.reduceat(motion, start) / size[:, None]
    return objects.select(rows.take(start)).with_(position=mean[:, :3], velocity=mean[:, 3:])


RegionName = Literal[
    "paper",
    "in_view",
    "ego_path",
    "victim_only",
    "outnumbered",
    "few_witnesses",
    "many_witnesses",
    "unseen_by_ego",
]
#: Upper limit of `n_false_positives`.
MAX_FALSE_OBJECTS = 10_000


class Selection(ABC):
    """Base class of target selections.

    until_found: whether it selects in every frame until it has a target
    cluster_radius_m: m, maximum distance between rows of different adversaries for the same object; None: not merged
    """

    until_found: ClassVar[bool] = False
    cluster_radius_m: float | None = None

    def view(self, objects: ObjectStates, source: Ints | None = None) -> ObjectStates:
        """Possible targets among the objects seen; source: (n,) adversary that saw each.

        By default all objects; with a `cluster_radius_m`, the observations of several adversaries are merged.
        """
        if source is None or self.cluster_radius_m is None:
            return objects
        return cluster_centres(objects, source, self.cluster_radius_m)

    @abstractmethod
    def select(self, objects: ObjectStates, coverage: Coverage, rng: np.random.Generator) -> Targets:
        """Targets among `objects`, and false objects allowed by `coverage`.

        objects: a view, world frame

        The result must not depend on the order of the objects.
        """


@dataclass(kw_only=True, eq=False)
class UncoordinatedSelection(Selection):
    """Selects false objects, and objects to hide and move, for one adversary.

    n_false_positives:        λ of the Poisson distribution of the number of false objects
    exact_number:             whether that number is not drawn, but is `n_false_positives`, rounded
    region:                   where to place them: "in_view" of the victim, in the "ego_path", "victim_only" (outside
                              the view of other agents), "outnumbered" (where more victims than others look),
                              "few_witnesses" (where at most one honest agent looks), "many_witnesses" (two or more),
                              "unseen_by_ego", or about the victim as in the "paper"; see attacks.regions
    fraction_false_negatives: fraction of the objects to hide; uniform without replacement, rounded down, but at least
                              one if there is any object and the fraction is not zero
    fraction_translations:    fraction of the objects to displace, none of them hidden; counted in the same way
    position_std_m:           σ per axis of false objects about the victim, projected to the ground; not for "ego_path"
    velocity_std_mps:         σ per axis of their velocity, which gives their heading. Except for "paper", directions
                              follow the traffic, and objects with a short free path are slower
    box:                      m, length, width and height of false objects
    object_class:             one of states.CLASSES, the class of false objects
    translation_m:            m, displacement of moved objects, in a random direction for each
    max_distance_m:           m, greatest distance of false objects from the agent in the region "paper"

    The ground is the median z of the bottoms of the objects, or 0 without objects. False objects, hidden objects and
    displacements have separate random streams, so that changing the number of one does not affect the others.
    Raises ValueError for invalid values.
    """

    n_false_positives: float = 5.0
    exact_number: bool = False
    region: RegionName = "in_view"
    fraction_false_negatives: float = 0.2
    fraction_translations: float = 0.0
    position_std_m: float = 30.0
    velocity_std_mps: float = 10.0
    box: tuple[float, float, float] = (4.0, 2.0, 2.0)
    object_class: str = "car"
    translation_m: float = 5.0
    max_distance_m: float = 70.0

    def __post_init__(self) -> None:
        not_negative = "n_false_positives", "position_std_m", "velocity_std_mps", "translation_m", "max_distance_m"
        check("0 or more", **{name: getattr(self, name) for name in not_negative})
        if not self.n_false_positives <= MAX_FALSE_OBJECTS:
            raise ValueError(f"n_false_positives: found {self.n_false_positives}, expected at most {MAX_FALSE_OBJECTS}")
        fractions = "fraction_false_negatives", "fraction_translations"
        check("0 to 1", **{name: getattr(self, name) for name in fractions})
        if not (len(self.box) == 3 and all(length > 0.0 for length in self.box)):
            raise ValueError(f"box: found {self.box}, expected three positive lengths in m")
        if self.object_class not in CLASS_INDEX:
            hint = nearest(self.object_class, CLASS_INDEX)
            raise ValueError(f"object_class: found {self.object_class!r}, expected a class of object{hint}")
        box, class_id = np.asarray(self.box, np.float64), CLASS_INDEX[self.object_class]
        self._shape = Shape(self.position_std_m, self.velocity_std_mps, box, self.max_distance_m, class_id)

    def select(self, objects: ObjectStates, coverage: Coverage, rng: np.random.Generator) -> Targets:
        add_rng, rows_rng, offset_rng = rng.spawn(3)
        objects = objects.select(canonical_order(objects))
        n = len(objects)
        removed = _count(self.fraction_false_negatives, n)
        moved = min(_count(self.fraction_translations, n), n - removed)
        rows = rows_rng.permutation(n)
        direction = offset_rng.uniform(-np.pi, np.pi, moved)
        offset = np.column_stack([np.cos(direction), np.sin(direction), np.zeros(moved)]) * self.translation_m
        number = self.n_false_positives
        count = (round(number) if self.exact_number else int(add_rng.poisson(number))) if coverage.victims else 0
        return Targets(
            add=REGIONS[self.region].objects(count, self._shape, objects, ground_height(objects), coverage, add_rng),
            remove=objects.select(np.sort(rows[:removed])),
            move=objects.select(np.sort(rows[removed : removed + moved])),
            move_offset=offset,
            wanted=count,
        ).numbered(0)


@dataclass(kw_only=True, eq=False)
class CoordinatedSelection(UncoordinatedSelection):
    """Selects false objects, and objects to hide and move, for all adversaries.

    The objects of the adversaries are merged into clusters with at most one object of each, nearest first and at most
    `cluster_radius_m` apart; a target is hidden (moved) for every adversary. The other parameters are as in
    UncoordinatedSelection, counted for all adversaries together.

    cluster_radius_m: maximum distance between rows of different adversaries for the same object
    """

    cluster_radius_m: float = 5.0

    def __post_init__(self) -> None:
        super().__post_init__()
        check("0 or more", cluster_radius_m=self.cluster_radius_m)


def ground_height(objects: ObjectStates) -> float:
    """Ground height, m: the median z of the bottoms of the objects, 0 without objects."""
    return float(np.median(objects.position[:, 2] - objects.size[:, 2] / 2.0)) if len(objects) else 0.0


def _count(fraction: float, n: int) -> int:
    """A fraction of n objects, rounded down, but at least one.

    Zero for a fraction of zero, and without objects.
    """
    # The small term avoids rounding 0.29 of 100 down to 28.
    return max(min(1, n), int(fraction * n + 1e-9)) if fraction > 0.0 else 0


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


@dataclass(kw_only=True, eq=False)
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

    n_objects: int = 1
    horizon_s: float = 6.0
    unseen_by_ego: bool = True
    near: tuple[float, float] | None = None
    cluster_radius_m: float = 5.0

    def __post_init__(self) -> None:
        check("1 or more", n_objects=self.n_objects)
        check("more than 0", horizon_s=self.horizon_s)

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
