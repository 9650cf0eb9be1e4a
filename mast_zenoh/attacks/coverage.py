"""Where false objects could be real at one time: in the victims' view, outside buildings, not in other objects."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mast_zenoh.arrays.neighbours import neighbours
from mast_zenoh.arrays.states import Bools, Floats, ObjectStates
from mast_zenoh.attacks.surroundings import UNKNOWN, Surroundings, unlimited
from mast_zenoh.tracking.duplicates import overlap
from mast_zenoh.tracking.view import SensorView

#: Share of a box that must be in the field of view, see `SensorView.expects`.
IN_VIEW = 0.5
#: m; two road users whose centres are farther apart do not touch.
TOUCH_M = 20.0
_NO_SCREENS = np.zeros((0, 6))


@dataclass(frozen=True, slots=True, eq=False)
class Coverage:
    """What is covered by whom at one time.

    surroundings: what the attacker knows in advance
    victims:      what the sensors of the compromised agents cover
    time_s:       s since the scene began
    fused:        the objects on the wire are of several agents (a picture): they need not be in a victim's view
    ego_tracks:   the ego's own tracks, world frame, if one of the adversaries sits on them; None: not known
    """

    surroundings: Surroundings
    victims: tuple[SensorView, ...]
    time_s: float
    fused: bool = False
    ego_tracks: ObjectStates | None = None

    def visible(self, view: SensorView, boxes: Floats, screens: Floats = _NO_SCREENS) -> Bools:
        """(k,) whether boxes (k, 6) x y z l w h are in a view and behind neither walls nor objects (n, 6)."""
        seen = view.expects(boxes, screens) >= IN_VIEW
        if seen.any():
            rows = seen.nonzero()[0]
            seen[rows] = ~self.surroundings.behind_walls(view.position, boxes[rows, :3])
        return np.asarray(seen)

    def seen(self, false: ObjectStates, real: ObjectStates, view: SensorView) -> Bools:
        """(k,) which false objects the victim with this view could see: in view, in no building, in no real object."""
        boxes = boxes_of(false)
        return self.visible(view, boxes, boxes_of(real)) & self._free(boxes, false, real)

    def plausible(self, false: ObjectStates, real: ObjectStates, view: SensorView) -> Bools:
        """(k,) which false objects could be among the victim's: on a fused wire they need not be in its view."""
        return self._free(boxes_of(false), false, real) if self.fused else self.seen(false, real, view)

    def others(self) -> list[SensorView]:
        """What the sensors of agents cover that are not compromised, as far as they are known."""
        return self.surroundings.other_views(self.time_s)

    def _free(self, boxes: Floats, false: ObjectStates, real: ObjectStates) -> Bools:
        return np.asarray(~self.surroundings.inside_buildings(boxes) & ~touching(false, real))


def coverage_of(position: Floats, time_s: float = 0.0) -> Coverage:
    """The coverage of victims at (3,) or (a, 3) m of whose sensors and surroundings nothing is known."""
    return Coverage(UNKNOWN, tuple(map(unlimited, np.atleast_2d(position))), time_s)


def boxes_of(states: ObjectStates) -> Floats:
    """(n, 6) x y z l w h, m."""
    return np.concatenate([states.position, states.size], axis=1)


def touching(false: ObjectStates, real: ObjectStates) -> Bools:
    """(k,) which of k objects overlap with one of n others, seen from above."""
    touches = np.zeros(len(false), bool)
    i, j, dx, dy = neighbours(false.position, real.position, np.full(len(false), TOUCH_M))
    if len(i):
        offset = np.column_stack([dx, dy])
        both = overlap(offset, false.size.take(i, 0), false.yaw.take(i), real.size.take(j, 0), real.yaw.take(j), 1.0)
        touches[i[both]] = True
    return touches
