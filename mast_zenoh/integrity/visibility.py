"""Visibility of objects: which sensors should see them, and which see through them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mast_zenoh.arrays.states import Bools, Floats
from mast_zenoh.integrity.base import Batch
from mast_zenoh.integrity.clusters import ClusterBoxes
from mast_zenoh.integrity.rays import TOLERANCES, box_visibility, ray_evidence
from mast_zenoh.integrity.views import SweptView

#: m, farther away the rays of a sensor miss small objects.
FAR_M = TOLERANCES.far_m
#: s; an older view shows where objects were, not where they are.
MAX_AGE_S = TOLERANCES.max_age_s
#: Standard deviations of a claim's position within which others need not see it.
ERROR_SD = 2.0
#: m, greatest standard deviation that a track may claim in its favour.
MAX_ERROR_M = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Sightings:
    """What `a` sensors see of `c` objects.

    in_view: (c, a) whether the object is in the field of view, not hidden behind something else
    fully_clear: (c, a) whether all rays pass through it and the space around it: there is no such object
    distance: (c, a) m
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
    """The views (a) that are not too old to be held against their agents; None for the others."""
    return tuple(None if view is None or abs(view.age_s) > MAX_AGE_S else view for view in views)


def lenient_sightings(batch: Batch, boxes: ClusterBoxes) -> tuple[Sightings, Bools]:
    """What each agent sees of c boxes, and (c, a) whether it reports an object that it sees through itself.

    boxes: of the clusters. Room is given for ERROR_SD of the uncertainty that the tracks claim. What an agent sees of
    its own object is judged by its own track: another agent's must not make an honest claim look like a lie.
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


def silent_about(batch: Batch, boxes: ClusterBoxes, seen: Sightings, rays: RayEvidence, range_m: float) -> Bools:
    """(c, a) which agents see the place of an object occupied but do not report it.

    boxes, seen, rays: of the clusters
    range_m: m, up to which a car whose place is occupied should be reported, see `ClusterBoxes.sight_range`
    """
    near = seen.distance <= boxes.sight_range(range_m)[:, None]
    return np.asarray(rays.ends & seen.in_view & ~batch.reported & ~rays.mostly_clear & near)


def seen_through(boxes: ClusterBoxes, views: Sequence[SweptView | None]) -> Bools:
    """(c, a) whether most of a sensor's rays pass through a box and the space around it, see `ray_evidence`."""
    return ray_evidence(boxes.position, boxes.velocity, boxes.size, boxes.yaw, views, None, TOLERANCES)[0]


def _by_own_tracks(batch: Batch, of_tracks: Bools) -> Bools:
    """(c, a) what is true of each agent's track of each object; False without one. of_tracks: (n, 1)"""
    result = np.zeros(batch.reported.shape, np.bool_)
    cluster, agent = batch.reported.nonzero()
    result[cluster, agent] = of_tracks[batch.member[cluster, agent], 0]
    return result


def _track_error(batch: Batch) -> Floats:
    """(n,) m, greatest horizontal standard deviation of each track, at most MAX_ERROR_M."""
    covariance = batch.states.covariance
    variance = np.maximum(covariance[:, 0, 0], covariance[:, 1, 1])
    return np.asarray(np.sqrt(np.clip(variance, 0.0, MAX_ERROR_M**2)))
