"""Which objects an adversary invents, hides and displaces (paper, section on attack designs)."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar, Literal

import numpy as np

from mast_zenoh.arrays.ordering import canonical_order
from mast_zenoh.arrays.states import CLASS_INDEX, Ints, ObjectStates
from mast_zenoh.attacks.clusters import cluster_centres
from mast_zenoh.attacks.coverage import Coverage
from mast_zenoh.attacks.regions import REGIONS, Shape
from mast_zenoh.attacks.targets import Targets
from mast_zenoh.errors import nearest

#: Upper limit of `n_false_positives`.
MOST_FALSE = 10_000


class Selection(ABC):
    """Chooses an adversary's targets, once or from time to time.

    until_found: whether it selects in every frame until it has a target
    """

    until_found: ClassVar[bool] = False

    def view(self, objects: ObjectStates, source: Ints | None = None) -> ObjectStates:
        """The objects that can be targets, given those seen; `source` (n,) says which adversary saw each.

        The objects as they are, unless a selection joins what several adversaries see of one object.
        """
        return objects

    @abstractmethod
    def select(self, objects: ObjectStates, coverage: Coverage, rng: np.random.Generator) -> Targets:
        """Targets among `objects` (a view, world frame), and false objects where `coverage` allows them.

        The result may depend on `rng` and on the set of objects, not on their order.
        """


class UncoordinatedSelection(Selection):
    """One adversary by itself: false objects round its victim, a part of the victim's objects hidden or moved.

    n_false_positives:        λ of the Poisson distribution of the number of false objects
    region:                   where they are put: "in_view" of the victim, in the "ego_path", "victim_only" (no other
                              agent looks there), or about the victim as in the "paper"; see attacks.regions
    fraction_false_negatives: part of the objects to hide; uniform without replacement, rounded down, but at least
                              one if there is any object and the fraction is not zero
    fraction_translations:    part of the objects to displace, none of them hidden; counted in the same way
    position_std_m:           σ per axis of false objects about the victim, projected to the ground; not for "ego_path"
    velocity_std_mps:         σ per axis of their velocity; they head where they go. Except for "paper", directions are
                              those of the traffic, and an object with a short way to go is slower
    box:                      m, length, width and height of false objects
    object_class:             one of states.CLASSES, the class of false objects
    translation_m:            m, how far objects are displaced, in a direction drawn per object

    The ground is the median foot of the objects, z = 0 when there is none. False objects, hidden objects and
    displacements come from three streams, so that changing the number of one changes no draw of another.
    Raises ValueError for values that make no sense.
    """

    def __init__(
        self,
        *,
        n_false_positives: float = 5.0,
        region: Literal["paper", "in_view", "ego_path", "victim_only"] = "in_view",
        fraction_false_negatives: float = 0.2,
        fraction_translations: float = 0.0,
        position_std_m: float = 30.0,
        velocity_std_mps: float = 10.0,
        box: tuple[float, float, float] = (4.0, 2.0, 2.0),
        object_class: str = "car",
        translation_m: float = 5.0,
    ) -> None:
        self.n_false_positives = n_false_positives
        self.region = REGIONS[region]
        self.fraction_false_negatives = fraction_false_negatives
        self.fraction_translations = fraction_translations
        self.position_std_m = position_std_m
        self.velocity_std_mps = velocity_std_mps
        self.box = np.asarray(box, np.float64)
        self.translation_m = translation_m
        for name in ("n_false_positives", "position_std_m", "velocity_std_mps", "translation_m"):
            self._expect(name, getattr(self, name) >= 0.0, "0 or more")
        self._expect("n_false_positives", n_false_positives <= MOST_FALSE, f"at most {MOST_FALSE}")
        for name in ("fraction_false_negatives", "fraction_translations"):
            self._expect(name, 0.0 <= getattr(self, name) <= 1.0, "0 to 1")
        self._expect("box", self.box.shape == (3,) and bool(np.all(self.box > 0.0)), "three positive lengths in m")
        if object_class not in CLASS_INDEX:
            hint = nearest(object_class, CLASS_INDEX)
            raise ValueError(f"object_class: found {object_class!r}, expected a class of object{hint}")
        self.class_id = CLASS_INDEX[object_class]

    def _expect(self, name: str, condition: bool, expected: str) -> None:
        if not condition:
            raise ValueError(f"{name}: found {getattr(self, name)}, expected {expected}")

    def select(self, objects: ObjectStates, coverage: Coverage, rng: np.random.Generator) -> Targets:
        for_add, for_rows, for_offset = rng.spawn(3)
        objects = objects.select(canonical_order(objects))
        n = len(objects)
        removed = _part(self.fraction_false_negatives, n)
        moved = min(_part(self.fraction_translations, n), n - removed)
        rows = for_rows.permutation(n)
        direction = for_offset.uniform(-np.pi, np.pi, moved)
        offset = np.column_stack([np.cos(direction), np.sin(direction), np.zeros(moved)]) * self.translation_m
        count = int(for_add.poisson(self.n_false_positives)) if coverage.victims else 0
        return Targets(
            add=self._false_objects(count, objects, coverage, for_add),
            remove=objects.select(np.sort(rows[:removed])),
            move=objects.select(np.sort(rows[removed : removed + moved])),
            move_offset=offset,
            wanted=count,
        ).numbered(0)

    def _false_objects(
        self, count: int, real: ObjectStates, coverage: Coverage, rng: np.random.Generator
    ) -> ObjectStates:
        shape = Shape(self.position_std_m, self.velocity_std_mps, self.box)
        position, velocity = self.region.place(count, shape, real, ground_height(real), coverage, rng)
        return ObjectStates.of(
            position,
            velocity=velocity,
            size=np.tile(self.box, (len(position), 1)),
            yaw=np.arctan2(velocity[:, 1], velocity[:, 0]),
            class_id=np.full(len(position), self.class_id, np.uint8),
        )


class CoordinatedSelection(UncoordinatedSelection):
    """A coordinator for all its adversaries: false objects round any of the victims, whole clusters hidden or moved.

    What the adversaries see is joined into clusters of at most one object of each, nearest first and no farther
    apart than `cluster_radius_m`; a target is then hidden (moved) for every adversary. The other parameters are
    those of UncoordinatedSelection, counted for all adversaries together.

    cluster_radius_m: within which objects seen by different adversaries are one
    """

    def __init__(
        self,
        *,
        n_false_positives: float = 5.0,
        region: Literal["paper", "in_view", "ego_path", "victim_only"] = "in_view",
        fraction_false_negatives: float = 0.2,
        fraction_translations: float = 0.0,
        position_std_m: float = 30.0,
        velocity_std_mps: float = 10.0,
        box: tuple[float, float, float] = (4.0, 2.0, 2.0),
        object_class: str = "car",
        translation_m: float = 5.0,
        cluster_radius_m: float = 5.0,
    ) -> None:
        super().__init__(
            n_false_positives=n_false_positives,
            region=region,
            fraction_false_negatives=fraction_false_negatives,
            fraction_translations=fraction_translations,
            position_std_m=position_std_m,
            velocity_std_mps=velocity_std_mps,
            box=box,
            object_class=object_class,
            translation_m=translation_m,
        )
        self.cluster_radius_m = cluster_radius_m
        self._expect("cluster_radius_m", cluster_radius_m >= 0.0, "0 or more")

    def view(self, objects: ObjectStates, source: Ints | None = None) -> ObjectStates:
        return objects if source is None else cluster_centres(objects, source, self.cluster_radius_m)


def ground_height(objects: ObjectStates) -> float:
    """m: the median foot of the objects, 0 when there is none."""
    return float(np.median(objects.position[:, 2] - objects.size[:, 2] / 2.0)) if len(objects) else 0.0


def _part(fraction: float, n: int) -> int:
    """How many of n objects a fraction is: rounded down, at least one of any, none for a fraction of zero."""
    # The small term keeps 0.29 of 100 at 29 where the product falls just short of it.
    return max(min(1, n), int(fraction * n + 1e-9)) if fraction > 0.0 else 0
