"""Plausible positions of false objects: in view, outside buildings and objects."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mast_zenoh.arrays.neighbours import neighbours
from mast_zenoh.arrays.states import Bools, Floats, ObjectStates
from mast_zenoh.attacks.surroundings import UNKNOWN, Surroundings, unlimited
from mast_zenoh.tracking.duplicates import overlap
from mast_zenoh.tracking.view import SensorView

#: Visible fraction from which a box is in view, see `SensorView.visible_fraction`.
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
    """

    surroundings: Surroundings
    victims: tuple[SensorView, ...]
    time_s: float
    fused: bool = False
    ego_tracks: ObjectStates | None = None

    def visible(self, view: SensorView, boxes: Floats, occluders: Floats = _NO_OCCLUDERS) -> Bools:
        """Boxes (k, 6) x y z l w h in a view, not occluded by walls or objects (n, 6)."""
        visible = view.visible_fraction(boxes, occluders) >= IN_VIEW
        if visible.any():
            rows = visible.nonzero()[0]
            visible[rows] = ~self.surroundings.behind_walls(view.position, boxes[rows, :3])
        return np.asarray(visible)

    def visible_outside_objects(self, false: ObjectStates, real: ObjectStates, view: SensorView) -> Bools:
        """False objects (k,) visible in a view: outside buildings and real objects."""
        boxes = boxes_of(false)
        return self.visible(view, boxes, boxes_of(real)) & self._free(boxes, false, real)

    def plausible(self, false: ObjectStates, real: ObjectStates, view: SensorView) -> Bools:
        """False objects (k,) that are plausible for the victim.

        On a fused wire they need not be in its view.
        """
        return (
            self._free(boxes_of(false), false, real) if self.fused else self.visible_outside_objects(false, real, view)
        )

    def other_views(self) -> list[SensorView]:
        """Fields of view of the agents that are known and not compromised."""
        return self.surroundings.other_views(self.time_s)

    def _free(self, boxes: Floats, false: ObjectStates, real: ObjectStates) -> Bools:
        return np.asarray(~self.surroundings.inside_buildings(boxes) & ~touching(false, real))


def coverage_of(position: Floats, time_s: float = 0.0) -> Coverage:
    """Coverage of victims at (3,) or (a, 3) m with unknown sensors and surroundings."""
    return Coverage(UNKNOWN, tuple(map(unlimited, np.atleast_2d(position))), time_s)


def boxes_of(states: ObjectStates) -> Floats:
    """Boxes (n, 6) x y z l w h, m."""
    return np.concatenate([states.position, states.size], axis=1)


def touching(false: ObjectStates, real: ObjectStates) -> Bools:
    """(k,) which of k objects overlap with one of n others in the bird's-eye view."""
    touches = np.zeros(len(false), bool)
    i, j, dx, dy = neighbours(false.position, real.position, np.full(len(false), TOUCH_M))
    if len(i):
        offset = np.column_stack([dx, dy])
        overlapping = overlap(
            offset, false.size.take(i, 0), false.yaw.take(i), real.size.take(j, 0), real.yaw.take(j), 1.0
        )
        touches[i[overlapping]] = True
    return touches
