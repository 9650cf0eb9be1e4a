"""Visibility of objects: which sensors should see them, or see through them.

A box is sampled by points. A ray reaches a point if its direction is free as far as the point, and passes it if it is
free beyond.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mast_zenoh.arrays.matching import neighbours
from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.integrity.base import Batch, ClusterBoxes
from mast_zenoh.integrity.views import SweptView
from mast_zenoh.kernels import kernel

#: Sample points of a box, in half lengths and half widths, and in half heights.
_ACROSS = (-1.0, 0.0, 1.0)
_UP = (-0.3, 0.4)
#: The same, closer together, for the share of a box and of the space around it that is free.
_AROUND = (-1.0, -0.5, 0.0, 0.5, 1.0)


class Tolerances(NamedTuple):
    """How exactly rays show where an object is.

    inside_m, outside_m: m, by which the sample points for visibility lie inside the box, and those for seeing through
        it outside: an object whose position is wrong by less is not seen through
    behind_m: m, beyond a point: a sensor that sees farther than this sees through it
    before_m: m, before a point: a sensor that sees no farther than this does not see it
    own_m, far_m: m, on the ground: nearer to a sensor is its own carrier, and farther away its rays miss small objects
    beside_m: m, by which an object beside another one may be displaced, and by which a ray must go on behind its points
    beside_share: of these points, behind more than which it must
    in_view: share of the points inside an object that must be in view
    max_age_s: s; an older view shows where objects were, not where they are
    """

    inside_m: float = 0.4
    outside_m: float = 0.8
    behind_m: float = 1.5
    before_m: float = 1.5
    own_m: float = 4.0
    far_m: float = 70.0
    beside_m: float = 0.2
    beside_share: float = 0.7
    in_view: float = 0.6
    max_age_s: float = 0.05


TOLERANCES = Tolerances()


@kernel
def box_visibility(
    position: Floats,
    size: Floats,
    yaw: Floats,
    error_m: Floats,
    views: Sequence[SweptView | None],
    only: Ints | None,
    tolerances: Tolerances,
) -> tuple[Bools, Bools, Floats]:
    """Which boxes sensors have in view and see through, and their distances in m.

    All (c, a), of c boxes and a sensors. position: (c, 3) m, size: (c, 3) m, yaw: (c,) rad, world frame
    error_m: (c,) m, by which each position may be wrong, besides `outside_m`
    views: (a), None: sees nothing;  only: (c,) the one view that is asked about each box, then a is 1; None: all
    """
    c, a = len(position), len(views) if only is None else 1
    in_view, swept = np.zeros((c, a), np.bool_), np.zeros((c, a), np.bool_)
    distance = np.full((c, a), np.inf)
    inner = sample_points(position, size, yaw, np.full(c, -tolerances.inside_m), _ACROSS)
    outer = sample_points(position, size, yaw, tolerances.outside_m + error_m, _ACROSS)
    for rows, column, view in _asked(c, views, only):
        if abs(view.age_s) > tolerances.max_age_s:
            continue
        ranges, free, inside = view.ranges(inner[rows].reshape(-1, 3))
        away = _distance(position[rows], view)
        with np.errstate(invalid="ignore"):
            reached = inside & ~(free < ranges - tolerances.before_m)
        share = reached.reshape(len(rows), -1).mean(axis=1)
        visible = (away > tolerances.own_m) & (share >= tolerances.in_view)
        ranges, free, inside = view.ranges(outer[rows].reshape(-1, 3))
        with np.errstate(invalid="ignore"):
            through = free > ranges + tolerances.behind_m
        passed = (through | ~inside).reshape(len(rows), -1).all(axis=1)
        passed &= through.reshape(len(rows), -1).any(axis=1)
        in_view[rows, column] = visible
        swept[rows, column] = visible & (away <= tolerances.far_m) & passed
        distance[rows, column] = away
    return in_view, swept, distance


@kernel
def ray_evidence(
    position: Floats,
    velocity: Floats,
    size: Floats,
    yaw: Floats,
    views: Sequence[SweptView | None],
    only: Ints | None,
    tolerances: Tolerances,
) -> tuple[Bools, Bools]:
    """Through which boxes most rays of sensors pass, and at which they end.

    Both (c, a), of c boxes and a sensors. velocity: (c, 3) m/s, of the boxes: a view that is older than them shows the
    places where they were then; the others as in `box_visibility`

    A box that is displaced by `outside_m` or less, e, still hides a share of w / (w + e) of its surroundings, w half
    its width, from any side. It is seen through if less than half as much is hidden.
    """
    c, a = len(position), len(views) if only is None else 1
    through, ends = np.zeros((c, a), np.bool_), np.zeros((c, a), np.bool_)
    points = sample_points(position, size, yaw, np.full(c, tolerances.outside_m), _AROUND)
    needed = _needed_share(size, tolerances)
    half = 0.5 * np.hypot(size[:, 0], size[:, 1])
    for rows, column, view in _asked(c, views, only):
        if view.free.size == 0:
            continue
        moved = velocity[rows] * view.age_s
        ranges, free, _ = view.ranges((points[rows] - moved[:, None, :]).reshape(-1, 3))
        with np.errstate(invalid="ignore"):
            share = (free > ranges + tolerances.behind_m).reshape(len(rows), -1).mean(axis=1)
        away = _distance(position[rows] - moved, view)
        near = (away > tolerances.own_m) & (away <= tolerances.far_m)
        through[rows, column] = (share > needed[rows]) & near
        ranges, free, _ = view.ranges(position[rows])
        with np.errstate(invalid="ignore"):
            reached = free >= ranges - half[rows] - tolerances.before_m
            ends[rows, column] = reached & (free <= ranges + half[rows] + tolerances.behind_m)
    return through, ends


@kernel
def outside_view(
    position: Floats,
    size: Floats,
    yaw: Floats,
    margin_m: Floats,
    views: Sequence[SweptView | None],
    only: Ints,
    tolerances: Tolerances,
) -> Bools:
    """(c,) boxes of which no point is in the field of view of one sensor each; a box at the sensor itself is inside.

    margin_m: (c,) m, by which boxes are larger on each side; only: (c,) the view of each; the others as in
    `box_visibility`
    """
    result = np.zeros(len(position), np.bool_)
    points = sample_points(position, size, yaw, margin_m, _ACROSS)
    for rows, _, view in _asked(len(position), views, only):
        inside = view.ranges(points[rows].reshape(-1, 3))[2].reshape(len(rows), -1).any(axis=1)
        result[rows] = ~inside & (_distance(position[rows], view) > tolerances.own_m)
    return result


@kernel
def passed_beside(
    position: Floats, size: Floats, yaw: Floats, views: Sequence[SweptView | None], tolerances: Tolerances
) -> Bools:
    """(c, a) boxes behind most of whose points the rays of sensors go on, as exactly as `beside_m`.

    The parameters are those of `box_visibility`.
    """
    result = np.zeros((len(position), len(views)), np.bool_)
    points = sample_points(position, size, yaw, np.full(len(position), tolerances.beside_m), _AROUND)
    for rows, column, view in _asked(len(position), views, None):
        ranges, free, _ = view.ranges(points.reshape(-1, 3))
        with np.errstate(invalid="ignore"):
            share = (free > ranges + tolerances.beside_m).reshape(len(position), -1).mean(axis=1)
        far = _distance(position, view) > tolerances.own_m
        result[rows, column] = (share > tolerances.beside_share) & far
    return result


def _asked(c: int, views: Sequence[SweptView | None], only: Ints | None) -> Iterator[tuple[Ints, int, SweptView]]:
    """Views, the rows of boxes that each is asked about, the column of its answers."""
    for number, view in enumerate(views):
        rows = np.arange(c) if only is None else np.flatnonzero(only == number)
        if view is not None and len(rows):
            yield rows, number if only is None else 0, view


def _needed_share(size: Floats, tolerances: Tolerances) -> Floats:
    """(c,) share of the points in and around boxes that rays must pass, see `ray_evidence`. size: (c, 3) m"""
    half_width = 0.5 * np.minimum(size[:, 0], size[:, 1])
    return np.asarray(1.0 - 0.5 * half_width / (half_width + tolerances.outside_m))


def _distance(position: Floats, view: SweptView) -> Floats:
    """(k,) m on the ground from a sensor to positions (k, 3)."""
    return np.asarray(np.hypot(*(position[:, :2] - view.view.position[:2]).T))


def sample_points(position: Floats, size: Floats, yaw: Floats, margin_m: Floats, grid: Sequence[float]) -> Floats:
    """(c, p, 3) sample points of enlarged boxes.

    margin_m: (c,) m, by which they are larger on each side; grid: of the points, in half lengths and in half widths
    """
    x, y, z = (axis.ravel() for axis in np.meshgrid(grid, grid, _UP, indexing="ij"))
    half = 0.5 * size
    flat = np.maximum(half[:, :2] + margin_m[:, None], 0.0)
    along, across = flat[:, :1] * x, flat[:, 1:] * y
    cos, sin = np.cos(yaw)[:, None], np.sin(yaw)[:, None]
    offset: Floats = np.stack([along * cos - across * sin, along * sin + across * cos, half[:, 2:] * z], axis=-1)
    return position[:, None, :] + offset


#: m, farther away the rays of a sensor miss small objects.
FAR_M = TOLERANCES.far_m
#: s; an older view shows where objects were, not where they are.
MAX_AGE_S = TOLERANCES.max_age_s
#: Least share of the space in and around a box that must be in view to judge it.
LEAST_IN_VIEW = 0.25
#: Standard deviations of a claim's position within which others need not see it.
ERROR_SD = 2.0
#: m, between the outlines of two objects that are beside each other.
BESIDE_M = 1.5
#: m, from a sensor, nearer than which only a part of what stands there is in its view.
NEARBY_M = 6.0
#: m, greatest standard deviation that a track may claim in its favour.
MAX_ERROR_M = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Sightings:
    """What `a` sensors see of `c` objects.

    in_view: (c, a) whether the object is in the field of view, not hidden behind something else
    fully_clear: (c, a) whether all rays pass through it and the space around it: there is no such object
    distance: (c, a) m; infinite from a sensor without a view, or with an old one
    """

    in_view: Bools
    fully_clear: Bools
    distance: Floats


@dataclass(frozen=True, slots=True, eq=False)
class RayEvidence:
    """What the rays of `a` sensors show of `c` objects.

    mostly_clear: (c, a) whether most rays pass through it and the space around it
    ends: (c, a) whether rays towards it end there
    """

    mostly_clear: Bools
    ends: Bools


def sightings(
    position: Floats, size: Floats, yaw: Floats, views: Sequence[SweptView | None], error_m: Floats | None = None
) -> Sightings:
    """What each of a sensors sees of c boxes.

    position: (c, 3) m, size: (c, 3) m, yaw: (c,) rad, world frame; views: (a), None: sees nothing
    error_m: (c,) m, by which each position may be wrong, besides that of an honest track
    """
    error = np.zeros(len(position)) if error_m is None else error_m
    return Sightings(*box_visibility(position, size, yaw, error, views, None, TOLERANCES))


def current(views: Sequence[SweptView | None]) -> tuple[SweptView | None, ...]:
    """The views (a) that are not too old to count against their agents; else None."""
    return tuple(None if view is None or abs(view.age_s) > MAX_AGE_S else view for view in views)


def lenient_sightings(batch: Batch, boxes: ClusterBoxes) -> tuple[Sightings, Bools]:
    """What agents see of boxes, and whether they report objects that they see through.

    The latter (c, a). boxes: of the clusters. Room is given for ERROR_SD of the uncertainty that the tracks claim. What
    an agent sees of its own object is judged by its own track: another agent's must not make an honest claim look like
    a lie.
    """
    states, error = batch.states, ERROR_SD * _track_error(batch)
    of_clusters = np.zeros(batch.clusters)
    np.maximum.at(of_clusters, batch.labels, error)
    seen = sightings(boxes.position, boxes.size, boxes.yaw, batch.views, of_clusters)
    _, own, _ = box_visibility(states.position, states.size, states.yaw, error, batch.views, batch.agent, TOLERANCES)
    return seen, _by_own_tracks(batch, own)


def rays_at(batch: Batch, boxes: ClusterBoxes, views: Sequence[SweptView | None]) -> RayEvidence:
    """What the rays of the agents' sensors show of the objects of a batch.

    boxes: of the clusters; views: (a), those that count

    Whether an agent sees through an object that it reports is judged by its own track of it.
    """
    states = batch.states
    own, _ = ray_evidence(states.position, states.velocity, states.size, states.yaw, views, batch.agent, TOLERANCES)
    through, ends = ray_evidence(boxes.position, boxes.velocity, boxes.size, boxes.yaw, views, None, TOLERANCES)
    return RayEvidence(np.where(batch.reported, _by_own_tracks(batch, own), through), ends)


def out_of_view(batch: Batch) -> Bools:
    """(n,) tracks that are outside their agent's own field of view, with room for errors; none of an agent without one.

    What is only hidden behind something else is inside: trackers go on with it for good reasons.
    """
    states = batch.states
    margin = TOLERANCES.outside_m + ERROR_SD * _track_error(batch)
    views = current(batch.views)
    return outside_view(states.position, states.size, states.yaw, margin, views, batch.agent, TOLERANCES)


def better_known(boxes: ClusterBoxes, witnesses: Ints) -> tuple[Ints, Ints, Floats]:
    """Pairs of an object (p,) and one beside it (p,) that is better known, and the way (p, 2) m to the other one.

    boxes: of c clusters; witnesses: (c,) number of agents that claim each, or whose sensor is on it
    """
    half = 0.5 * np.hypot(boxes.size[:, 0], boxes.size[:, 1])
    i, j, dx, dy = neighbours(boxes.position, boxes.position, half + half.max(initial=0.0) + BESIDE_M)
    beside = (np.hypot(dx, dy) <= half[i] + half[j] + BESIDE_M) & (witnesses[j] > witnesses[i])
    return i[beside], j[beside], np.column_stack([dx[beside], dy[beside]])


def carrying(boxes: ClusterBoxes, views: Sequence[SweptView | None]) -> Bools:
    """(c, a) objects that an agent's sensor is on."""
    places = np.array([np.full(2, np.nan) if view is None else view.view.position[:2] for view in views]).reshape(-1, 2)
    return boxes.cover(places).T


def passed_to_others(
    batch: Batch, boxes: ClusterBoxes, rays: RayEvidence, voter: Bools, beside: tuple[Ints, Ints, Floats]
) -> Bools:
    """(c, a) objects beside a better known one through which the rays of a sensor that has that one in view go on.

    boxes, rays: of the clusters; voter: (a,) agents that count; beside: see `better_known`

    Rays end at the other object, whose errors are known to be small because agents agree about it. So they show more
    exactly than those that pass into the open whether something is before it. What is behind it, they don't show.
    """
    result = np.zeros(rays.ends.shape, np.bool_)
    i, j, _ = beside
    if not len(i):
        return result
    judged, row = np.unique(i, return_inverse=True)
    seen = np.zeros((len(judged), len(voter)), np.bool_)
    np.logical_or.at(seen, row, rays.ends[j] | batch.reported[j])
    views = current(batch.views)
    passed = passed_beside(boxes.position[judged], boxes.size[judged], boxes.yaw[judged], views, TOLERANCES)
    result[judged] = passed & seen & voter & ~batch.reported[judged]
    return result


def passed_nearby(batch: Batch, boxes: ClusterBoxes, seen: Sightings, voter: Bools) -> Bools:
    """(c, a) objects beside a sensor that it sees through, of what is in its view there, and does not report.

    boxes, seen: of the clusters; voter: (a,) agents that count. Not what the sensor is on.
    """
    result = np.zeros(batch.reported.shape, np.bool_)
    half = 0.5 * np.hypot(boxes.size[:, 0], boxes.size[:, 1])
    beside = (half[:, None] < seen.distance) & (seen.distance <= NEARBY_M)
    near, agent = np.nonzero(beside & ~batch.reported & voter)
    if len(near):
        result[near, agent] = _clear_in_view(boxes.select(near), batch.views, agent)
    return result


def silent_about(batch: Batch, boxes: ClusterBoxes, seen: Sightings, rays: RayEvidence, range_m: float) -> Bools:
    """(c, a) which agents see the place of an object occupied but do not report it.

    boxes, seen, rays: of the clusters
    range_m: m, up to which a car whose place is occupied should be reported, see `ClusterBoxes.sight_range`
    """
    near = seen.distance <= boxes.sight_range(range_m)[:, None]
    return np.asarray(rays.ends & seen.in_view & ~batch.reported & ~rays.mostly_clear & near)


def seen_through(boxes: ClusterBoxes, views: Sequence[SweptView | None]) -> Bools:
    """(c, a) whether most of a sensor's rays pass through a box and around it.

    See `ray_evidence`.
    """
    return ray_evidence(boxes.position, boxes.velocity, boxes.size, boxes.yaw, views, None, TOLERANCES)[0]


def clear_in_view(boxes: ClusterBoxes, view: SweptView) -> Bools:
    """(c,) whether most rays of a sensor pass through a box and around it, of those in its field of view.

    As `seen_through`, but also close to the sensor, whose rays pass over the lower parts of what stands there: at least
    `LEAST_IN_VIEW` of a box must be in the field of view. What carries the sensor counts as clear, as its rays pass it.
    """
    return _clear_in_view(boxes, (view,), np.zeros(len(boxes.yaw), np.int64))


def _clear_in_view(boxes: ClusterBoxes, views: Sequence[SweptView | None], only: Ints) -> Bools:
    """(c,) the same of one sensor for each box. only: (c,) the view of each"""
    result = np.zeros(len(boxes.yaw), np.bool_)
    age_s = np.array([0.0 if view is None else view.age_s for view in views])[only]
    position = boxes.position - boxes.velocity * age_s[:, None]
    points = sample_points(position, boxes.size, boxes.yaw, np.full(len(position), TOLERANCES.outside_m), _AROUND)
    needed = _needed_share(boxes.size, TOLERANCES)
    for rows, _, view in _asked(len(position), views, only):
        if not view.free.size:
            continue
        ranges, free, inside = view.ranges(points[rows].reshape(-1, 3))
        with np.errstate(invalid="ignore"):
            through = (free > ranges + TOLERANCES.behind_m).reshape(len(rows), -1).mean(axis=1)
        in_view = inside.reshape(len(rows), -1).mean(axis=1)
        clear = (in_view >= LEAST_IN_VIEW) & (through > needed[rows] * in_view)
        result[rows] = clear & (_distance(position[rows], view) <= TOLERANCES.far_m)
    return result


def _by_own_tracks(batch: Batch, of_tracks: Bools) -> Bools:
    """(c, a) what is true of each agent's track of each object; False without one.

    of_tracks: (n, 1)
    """
    result = np.zeros(batch.reported.shape, np.bool_)
    cluster, agent = batch.reported.nonzero()
    result[cluster, agent] = of_tracks[batch.member[cluster, agent], 0]
    return result


def _track_error(batch: Batch) -> Floats:
    """(n,) m, greatest horizontal standard deviation of tracks, at most MAX_ERROR_M."""
    covariance = batch.states.covariance
    variance = np.maximum(covariance[:, 0, 0], covariance[:, 1, 1])
    return np.asarray(np.sqrt(np.clip(variance, 0.0, MAX_ERROR_M**2)))
