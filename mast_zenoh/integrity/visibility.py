"""Who should see an object, and who sees through it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.integrity.base import Batch
from mast_zenoh.integrity.clusters import ClusterBoxes
from mast_zenoh.integrity.views import SweptView

#: Sample points of a box, in half lengths and half widths, and in half heights.
_ACROSS = (-1.0, 0.0, 1.0)
_UP = (-0.3, 0.4)
#: The same, closer together, for the share of a box and of the space around it that is free.
_AROUND = (-1.0, -0.5, 0.0, 0.5, 1.0)
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
#: Standard deviations of a claim's position within which others need not see it.
ERROR_SD = 2.0
#: m, greatest standard deviation that a track may claim in its favour.
MAX_ERROR_M = 1.0
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


def lenient_sightings(batch: Batch, boxes: ClusterBoxes) -> tuple[Sightings, Bools]:
    """What each agent sees of c boxes, and (c, a) whether it reports an object that it sees through itself.

    boxes: of the clusters. Room is given for ERROR_SD of the uncertainty that the tracks claim. What an agent sees of
    its own object is judged by its own track: another agent's must not make an honest claim look like a lie.
    """
    error = ERROR_SD * _track_error(batch)
    of_clusters = np.zeros(batch.clusters)
    np.maximum.at(of_clusters, batch.labels, error)
    seen = sightings(boxes.position, boxes.size, boxes.yaw, batch.views, of_clusters)

    def swept(tracks: Ints, view: SweptView) -> Bools:
        own = batch.states.select(tracks)
        return sightings(own.position, own.size, own.yaw, (view,), error[tracks]).swept[:, 0]

    return seen, _by_own_tracks(batch, batch.views, swept)


def free_and_occupied(
    batch: Batch, boxes: ClusterBoxes, seen: Sightings, views: Sequence[SweptView | None], range_m: float
) -> tuple[Bools, Bools]:
    """(c, a) which agents see through an object, and which see its place occupied but do not report it.

    boxes, seen: of the clusters; views: (a), those that count
    range_m: m, up to which a car whose place is occupied should be reported, see `ClusterBoxes.sight_range`

    An agent sees through an object that it reports if it sees through its own track of it.
    """

    def through_own(tracks: Ints, view: SweptView) -> Bools:
        own = batch.states.select(tracks)
        return seen_through(ClusterBoxes(own.position, own.velocity, own.size, own.yaw), (view,))[:, 0]

    own = _by_own_tracks(batch, views, through_own)
    through = np.where(batch.reported, own, seen_through(boxes, views))
    silent = occupied(boxes, seen, views) & ~batch.reported & ~through
    return through, silent & (seen.distance <= boxes.sight_range(range_m)[:, None])


def _by_own_tracks(batch: Batch, views: Sequence[SweptView | None], judge: Callable[[Ints, SweptView], Bools]) -> Bools:
    """(c, a) what `judge` says of each agent's tracks (k,) rows, given its view; False without a view or a track."""
    result = np.zeros((batch.clusters, len(views)), np.bool_)
    for column, view in enumerate(views):
        rows = batch.member[:, column]
        reported = rows >= 0
        if view is not None and reported.any():
            result[reported, column] = judge(rows[reported], view)
    return result


def occupied(boxes: ClusterBoxes, seen: Sightings, views: Sequence[SweptView | None]) -> Bools:
    """(c, a) whether the rays of the agent's sensor towards the centre of a visible box end there."""
    ends = np.zeros(seen.in_view.shape, np.bool_)
    half = 0.5 * np.hypot(boxes.size[:, 0], boxes.size[:, 1])
    for column, view in enumerate(views):
        if view is None or view.free.size == 0 or len(half) == 0:
            continue
        distance, free, _ = view.ranges(boxes.position)
        with np.errstate(invalid="ignore"):
            ends[:, column] = (free >= distance - half - BEFORE_M) & (free <= distance + half + BEHIND_M)
    return np.asarray(ends & seen.in_view)


def seen_through(boxes: ClusterBoxes, views: Sequence[SweptView | None]) -> Bools:
    """(c, a) whether the agent's sensor sees through a box and the space around it, up to FAR_M.

    A box that is displaced by OUTSIDE_M or less, e, still hides a share of w / (w + e) of its surroundings, w half its
    width, from any side. It is seen through if less than half as much is hidden.

    A view that is older than the boxes shows the places where they were then.
    """
    through = np.zeros((len(boxes.yaw), len(views)), np.bool_)
    margin = np.full(len(boxes.yaw), OUTSIDE_M)
    points = _points(boxes.position, boxes.size, boxes.yaw, margin, _AROUND)
    half_width = 0.5 * np.minimum(boxes.size[:, 0], boxes.size[:, 1])
    needed = 1.0 - 0.5 * half_width / (half_width + OUTSIDE_M)
    for column, view in enumerate(views):
        if view is None or view.free.size == 0 or len(points) == 0:
            continue
        moved = boxes.velocity * view.age_s
        distance, free, _ = view.ranges((points - moved[:, None, :]).reshape(-1, 3))
        with np.errstate(invalid="ignore"):
            share = (free > distance + BEHIND_M).reshape(points.shape[:2]).mean(axis=1)
        away = np.hypot(*((boxes.position - moved)[:, :2] - view.view.position[:2]).T)
        through[:, column] = (share > needed) & (away > OWN_M) & (away <= FAR_M)
    return through


def _track_error(batch: Batch) -> Floats:
    """(n,) m, greatest horizontal standard deviation of each track, at most MAX_ERROR_M."""
    covariance = batch.states.covariance
    variance = np.maximum(covariance[:, 0, 0], covariance[:, 1, 1])
    return np.asarray(np.sqrt(np.clip(variance, 0.0, MAX_ERROR_M**2)))


def _points(position: Floats, size: Floats, yaw: Floats, margin_m: Floats, grid: Sequence[float] = _ACROSS) -> Floats:
    """(c, p, 3) sample points of boxes that are larger by `margin_m` (c,) on each side.

    grid: of the points, in half lengths and in half widths
    """
    x, y, z = (axis.ravel() for axis in np.meshgrid(grid, grid, _UP, indexing="ij"))
    half = 0.5 * size
    flat = np.maximum(half[:, :2] + margin_m[:, None], 0.0)
    along, across = flat[:, :1] * x, flat[:, 1:] * y
    cos, sin = np.cos(yaw)[:, None], np.sin(yaw)[:, None]
    offset: Floats = np.stack([along * cos - across * sin, along * sin + across * cos, half[:, 2:] * z], axis=-1)
    return position[:, None, :] + offset
