"""Buildings along the pavements of a junction."""

from __future__ import annotations

import numpy as np

from mast_zenoh.arrays.states import Floats
from mast_zenoh.scenes.generated.junction import PAVEMENT, PAVEMENT_END, REACH, Arm, corners

_GAP = 3.0  # m, between two buildings


def rows_of_buildings(arms: tuple[Arm, ...], random: np.random.Generator) -> tuple[tuple[Floats, ...], Floats]:
    """Outlines, each (4, 2) m, and heights (B,) m, of rows along every arm.

    The rows have a random density and are on both sides of every arm.
    No building overlaps a road, a pavement or another building.
    """
    occupied = [
        _rectangle(arm, 0.0, REACH + 60.0, -arm.half_width - PAVEMENT, arm.half_width + PAVEMENT) for arm in arms
    ]
    outlines: list[Floats] = []
    heights: list[float] = []
    for a, arm in enumerate(arms):
        for side, mouth in ((1.0, corners(arms, a, PAVEMENT)[0]), (-1.0, corners(arms, a - 1, PAVEMENT)[-1])):
            direction = np.array([np.cos(arm.angle), np.sin(arm.angle)])
            x = float(mouth @ direction) + random.uniform(0.5, 5.0)
            density = random.uniform(0.7, 1.0)  # fraction of this side that is built on
            while x < PAVEMENT_END:
                length, depth = random.uniform(10.0, 26.0), random.uniform(9.0, 18.0)
                front = arm.half_width + PAVEMENT + random.choice([0.5, 0.5, 4.0])
                height, is_built = random.choice([4.5, 7.5, 10.5, 13.5, 19.5]), random.random() < density
                low, high = sorted((side * front, side * (front + depth)))
                outline = _rectangle(arm, x, x + length, low, high)
                if not is_built:
                    x += length
                elif not any(_overlap(outline, other) for other in occupied):
                    occupied.append(_rectangle(arm, x - _GAP, x + length + _GAP, low - _GAP, high + _GAP))
                    outlines.append(outline)
                    heights.append(float(height))
                    x += length + random.choice([_GAP, _GAP, 9.0])
                else:
                    x += 4.0
    return tuple(outlines), np.array(heights)


def _rectangle(arm: Arm, x_low: float, x_high: float, y_low: float, y_high: float) -> Floats:
    return arm.world(np.array([[x_low, y_low], [x_high, y_low], [x_high, y_high], [x_low, y_high]]))


def _overlap(one: Floats, other: Floats) -> bool:
    """Whether two convex outlines overlap: no side of either separates them."""
    for outline in (one, other):
        side = np.roll(outline, -1, axis=0) - outline
        normal = np.stack([-side[:, 1], side[:, 0]])
        first, second = one @ normal, other @ normal
        if np.any((first.max(axis=0) <= second.min(axis=0)) | (second.max(axis=0) <= first.min(axis=0))):
            return False
    return True
