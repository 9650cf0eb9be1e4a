"""Who should see an object, and who sees through it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mast_zenoh.arrays.states import Bools, Floats
from mast_zenoh.integrity.base import Batch
from mast_zenoh.integrity.views import SweptView

#: Sample points of a box, in half lengths and half widths, and in half heights.
_ACROSS = (-1.0, 0.0, 1.0)
_UP = (-0.3, 0.4)
#: m, by which the sample points for visibility lie inside the box, and those for seeing through it outside: an object
#: whose position is wrong by less is not seen through.
INSIDE_M, OUTSIDE_M = 0.4, 0.8
#: m, beyond a point: a sensor that sees farther than this sees through it.
BEHIND_M = 1.5
#: m, before a point: a sensor that sees no farther than this does not see it.
BEFORE_M = 1.5
#: m, on the ground: nearer to a sensor is its own carrier, and farther away its rays miss small objects.
OWN_M, FAR_M = 4.0, 70.0
#: s; an older view shows where objects were, not where they are.
MAX_AGE_S = 0.05
#: Share of the points inside an object that must be in view.
IN_VIEW = 0.6


@dataclass(frozen=True, slots=True, eq=False)
class Sightings:
    """What a sensors see of c objects.

    in_view: (c, a) whether the object is in the field of view, not hidden behind something else
    swept:   (c, a) whether the sensor sees through it: there is no such object
    distance: (c, a) m
    """

    in_view: Bools
    swept: Bools
    distance: Floats


def sightings(
    position: Floats, size: Floats, yaw: Floats, views: Sequence[SweptView | None], error_m: Floats | None = None
) -> Sightings:
    """What each of a sensors sees of c boxes.

    position: (c, 3) m, size: (c, 3) m, yaw: (c,) rad, world frame; views: (a), None: sees nothing
    error_m: (c,) m, by which each position may be wrong, besides OUTSIDE_M
    """
    c, a = len(position), len(views)
    in_view, swept = np.zeros((c, a), np.bool_), np.zeros((c, a), np.bool_)
    distance = np.full((c, a), np.inf)
    if c == 0:
        return Sightings(in_view, swept, distance)
    inner = _points(position, size, yaw, np.full(c, -INSIDE_M))
    outer = _points(position, size, yaw, OUTSIDE_M + (np.zeros(c) if error_m is None else error_m))
    p = inner.shape[1]
    for column, view in enumerate(views):
        if view is None or abs(view.age_s) > MAX_AGE_S:
            continue
        ranges, free, inside = view.ranges(inner.reshape(-1, 3))
        away = np.hypot(*(position[:, :2] - view.view.position[:2]).T)
        with np.errstate(invalid="ignore"):
            reached = inside & ~(free < ranges - BEFORE_M)
        visible = (away > OWN_M) & (reached.reshape(c, p).mean(axis=1) >= IN_VIEW)
        ranges, free, inside = view.ranges(outer.reshape(-1, 3))
        with np.errstate(invalid="ignore"):
            through = free > ranges + BEHIND_M
        open_ = (through | ~inside).reshape(c, p).all(axis=1) & through.reshape(c, p).any(axis=1)
        in_view[:, column] = visible
        swept[:, column] = visible & (away <= FAR_M) & open_
        distance[:, column] = away
    return Sightings(in_view, swept, distance)


def own_sightings(batch: Batch, error_m: Floats) -> Bools:
    """(c, a) whether an agent reports an object although its sensor sees through its own track of it.

    error_m: (n,) m, by which the position of each track may be wrong
    """
    through = np.zeros((batch.clusters, len(batch.agents)), np.bool_)
    for column, view in enumerate(batch.views):
        rows = batch.member[:, column]
        reported = rows >= 0
        if view is None or not reported.any():
            continue
        tracks = rows[reported]
        states = batch.states.select(tracks)
        seen = sightings(states.position, states.size, states.yaw, (view,), error_m[tracks])
        through[reported, column] = seen.swept[:, 0]
    return through


def _points(position: Floats, size: Floats, yaw: Floats, margin_m: Floats) -> Floats:
    """(c, p, 3) sample points of boxes that are larger by `margin_m` (c,) on each side."""
    x, y, z = (grid.ravel() for grid in np.meshgrid(_ACROSS, _ACROSS, _UP, indexing="ij"))
    half = 0.5 * size
    flat = np.maximum(half[:, :2] + margin_m[:, None], 0.0)
    along, across = flat[:, :1] * x, flat[:, 1:] * y
    cos, sin = np.cos(yaw)[:, None], np.sin(yaw)[:, None]
    offset: Floats = np.stack([along * cos - across * sin, along * sin + across * cos, half[:, 2:] * z], axis=-1)
    return position[:, None, :] + offset
