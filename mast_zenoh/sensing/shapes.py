"""Shapes of road users: each class is a few convex parts inside its box, so that a lidar does not see bricks.

A part is a frustum: a rectangle at its lower and another one at its upper height, both along the axes of the box. Rays
pass below cars, over bonnets and between the wheels and the rider of a bicycle, as they do in recorded scans.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mast_zenoh.arrays.states import CLASS_INDEX, CLASSES, Floats, Ints, within_runs

#: Parts, in the order of CLASSES, vans last, each with its lower and its upper rectangle as (z, x from, x to, y half):
#: shares of the box's height, length and width, z from 0 to 1, x and y from -0.5 to 0.5. Heights and lengths are those
#: of common vehicles (a saloon car, a rigid truck, a city bus) and of a standing person (Drillis and Contini 1966,
#: figure 1).
_PARTS = (
    ("unknown", (0.00, -0.50, 0.50, 0.50), (1.00, -0.50, 0.50, 0.50)),
    ("car", (0.15, -0.50, 0.50, 0.50), (0.56, -0.50, 0.48, 0.49)),
    ("car", (0.56, -0.48, 0.24, 0.47), (1.00, -0.34, 0.06, 0.36)),
    ("truck", (0.16, -0.50, 0.50, 0.42), (0.30, -0.50, 0.50, 0.42)),
    ("truck", (0.30, 0.27, 0.50, 0.49), (0.86, 0.27, 0.47, 0.47)),
    ("truck", (0.30, -0.50, 0.23, 0.50), (1.00, -0.50, 0.23, 0.50)),
    ("bus", (0.10, -0.50, 0.50, 0.50), (1.00, -0.50, 0.48, 0.48)),
    ("motorcycle", (0.00, -0.50, 0.50, 0.15), (0.50, -0.45, 0.36, 0.22)),
    ("motorcycle", (0.45, -0.25, 0.15, 0.40), (0.86, -0.05, 0.17, 0.50)),
    ("motorcycle", (0.86, 0.03, 0.15, 0.20), (1.00, 0.03, 0.15, 0.18)),
    ("bicycle", (0.00, -0.50, 0.50, 0.05), (0.40, -0.48, 0.48, 0.07)),
    ("bicycle", (0.20, -0.14, 0.06, 0.20), (0.55, -0.16, 0.00, 0.26)),
    ("bicycle", (0.55, -0.16, 0.06, 0.34), (0.87, 0.00, 0.18, 0.42)),
    ("bicycle", (0.87, 0.06, 0.18, 0.16), (1.00, 0.06, 0.17, 0.15)),
    ("pedestrian", (0.00, -0.35, 0.35, 0.32), (0.48, -0.28, 0.28, 0.36)),
    ("pedestrian", (0.48, -0.28, 0.28, 0.40), (0.82, -0.26, 0.26, 0.50)),
    ("pedestrian", (0.82, -0.17, 0.20, 0.15), (1.00, -0.17, 0.20, 0.15)),
    ("van", (0.13, -0.50, 0.50, 0.50), (0.50, -0.50, 0.48, 0.50)),
    ("van", (0.50, -0.50, 0.42, 0.49), (1.00, -0.49, 0.26, 0.45)),
)
#: (p, 2, 5) of all parts: z from the middle, x from, x to, y from, y to. By class, vans last: how many, and the first.
_UNIT = np.array([[(z - 0.5, back, front, -y, y) for z, back, front, y in part] for _, *part in _PARTS])
_COUNT = np.array([sum(kind == name for kind, *_ in _PARTS) for name in (*CLASSES, "van")])
_FIRST = np.cumsum(_COUNT) - _COUNT
#: m: a car that is higher than this is a van, or a lorry on the chassis of one.
_VAN_M = 1.85


@dataclass(frozen=True, eq=False)
class Parts:
    """The convex parts of n objects, in the axes of their boxes, from the middle of each box.

    first: (n + 1,) int64, of the parts of object i: first[i] to first[i + 1]
    low, high: (p, 5) float64 m, of each part's lower and upper rectangle: z, x from, x to, y from, y to
    """

    first: Ints
    low: Floats
    high: Floats

    @classmethod
    def of(cls, class_id: Ints, size: Floats) -> Parts:
        """The parts of objects of classes (n,), `states.CLASSES`, with boxes (n, 3) m."""
        is_van = (class_id == CLASS_INDEX["car"]) & (size[:, 2] > _VAN_M)
        kind = np.where(is_van, len(CLASSES), class_id)
        count = _COUNT[kind]
        row = np.repeat(_FIRST[kind], count) + within_runs(count)
        first = np.concatenate([[0], np.cumsum(count)])
        scale = np.repeat(size[:, (2, 0, 0, 1, 1)], count, axis=0)
        return cls(first, _UNIT[row, 0] * scale, _UNIT[row, 1] * scale)

    @classmethod
    def boxes(cls, size: Floats) -> Parts:
        """Objects (n, 3) m that fill their boxes."""
        return cls.of(np.zeros(len(size), np.int64), size)
