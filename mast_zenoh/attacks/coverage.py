"""Plausible positions of false objects: in view, outside buildings and objects."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mast_zenoh.arrays.neighbours import neighbours
from mast_zenoh.arrays.states import Bools, Floats, Ints, ObjectStates
from mast_zenoh.attacks.surroundings import UNKNOWN, Surroundings, unlimited
from mast_zenoh.tracking.duplicates import overlap
from mast_zenoh.tracking.view import SensorView

#: Least visible fraction of a box in view, see `SensorView.visible_fraction`.
IN_VIEW = 0.5
#: m; road users whose centres are farther apart do not overlap.
TOUCH_M = 20.0
_NO_OCCLUDERS = np.zeros((0, 6))


@dataclass(frozen=True, slots=True, eq=False)
class Coverage:
    """Fields of view of the agents at one time.

    surroundings: the attacker's prior knowledge
    victims:      fields of view of the compromised agents
    time_s:       s since the start of the scene
    fused:        the objects on the wire come from several agents (a picture) and need not be in a victim's view
    ego_tracks:   the ego's own tracks, world frame, if an adversary intercepts them; None: unknown
    agents:       (k, 3) m, all agents that the attacker knows, compromised or not; None: the victims' sensors
    """

    surroundings: Surroundings
    victims: tuple[SensorView, ...]
    time_s: float
    fused: bool = False
    ego_tracks: ObjectStates | None = None
    agents: Floats | None = None

    def visible(self, view: SensorView, boxes: Floats, occluders: Floats = _NO_OCCLUDERS) -> Bools:
        """Boxes (k, 6) x y z l w h in a view, not occluded by walls or objects (n, 6)."""
        visible = view.visible_fraction(boxes, occluders) >= IN_VIEW
        if visible.any():
            rows = visible.nonzero()[0]
            visible[rows] = ~self.surroundings.behind_walls(view.position, boxes[rows, :3])
        return np.asarray(visible)

    def visible_outside_objects(
        self, false_objects: ObjectStates, real_objects: ObjectStates, view: SensorView
    ) -> Bools:
        """(k,) whether false objects are visible, outside buildings and real objects."""
        boxes = boxes_of(false_objects)
        return self.visible(view, boxes, boxes_of(real_objects)) & self._free(boxes, false_objects, real_objects)

    def plausible(self, false_objects: ObjectStates, real_objects: ObjectStates, view: SensorView) -> Bools:
        """(k,) whether false objects are plausible for the victim; see `fused`."""
        return (
            self._free(boxes_of(false_objects), false_objects, real_objects)
            if self.fused
            else self.visible_outside_objects(false_objects, real_objects, view)
        )

    def other_views(self) -> list[SensorView]:
        """Fields of view of the agents that are known and not compromised."""
        return self.surroundings.other_views(self.time_s)

    def honest_viewers(self, objects: ObjectStates, wanted: Bools | None = None) -> Ints:
        """(k,) number of agents that are not compromised and look at each object, past walls.

        wanted: (k,) for which objects, the others count as seen by nobody
        """
        rows = np.arange(len(objects)) if wanted is None else wanted.nonzero()[0]
        boxes, counts = boxes_of(objects)[rows], np.zeros(len(objects), np.int64)
        for view in self.other_views():
            counts[rows] += self.visible(view, boxes)
        return counts

    def _free(self, boxes: Floats, false_objects: ObjectStates, real_objects: ObjectStates) -> Bools:
        return np.asarray(~self.surroundings.inside_buildings(boxes) & ~touching(false_objects, real_objects))


def coverage_of(position: Floats, time_s: float = 0.0) -> Coverage:
    """Coverage of victims at (3,) or (a, 3) m with unknown sensors and surroundings."""
    return Coverage(UNKNOWN, tuple(map(unlimited, np.atleast_2d(position))), time_s)


def boxes_of(states: ObjectStates) -> Floats:
    """Boxes (n, 6) x y z l w h, m."""
    return np.concatenate([states.position, states.size], axis=1)


def touching(false_objects: ObjectStates, real_objects: ObjectStates) -> Bools:
    """(k,) whether each of k objects overlaps one of n others in the bird's-eye view."""
    touches = np.zeros(len(false_objects), bool)
    i, j, dx, dy = neighbours(false_objects.position, real_objects.position, np.full(len(false_objects), TOUCH_M))
    if len(i):
        offset = np.column_stack([dx, dy])
        overlapping = overlap(
            offset,
            false_objects.size.take(i, 0),
            false_objects.yaw.take(i),
            real_objects.size.take(j, 0),
            real_objects.yaw.take(j),
            1.0,
        )
        touches[i[overlapping]] = True
    return touches
