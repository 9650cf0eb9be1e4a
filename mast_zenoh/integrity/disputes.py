"""Contradictions between agents about an object, and tracks that no honest agent sends."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mast_zenoh.arrays.matching import neighbours
from mast_zenoh.arrays.states import Bools, Floats, Ints, ObjectStates
from mast_zenoh.integrity.base import Batch, ClusterBoxes
from mast_zenoh.integrity.visibility import RayEvidence, Sightings
from mast_zenoh.tracking.tracks import ONE_OBJECT, overlap

#: m, length, width and height of road users: from a small child to the longest and highest vehicles that Directive
#: 96/53/EC allows (18.75, 2.6 and 4.0 m), with half a metre for errors.
SMALLEST_M, LARGEST_M = (0.1, 0.1, 0.3), (19.25, 3.1, 4.5)
#: Steepest slope of the ground, and m by which the lower edge of a box may be off.
SLOPE, HEIGHT_ERROR_M = 0.12, 1.5
#: Share of ONE_OBJECT from which two tracks of one agent are of one object: trackers merge those at ONE_OBJECT, and
#: a batch moves them to another time.
REPEATED = 0.8 * ONE_OBJECT
#: m, from an object, within which an agent's track may be of it: it is not silent about the object. The clusterer's
#: radius.
ABOUT_M = 2.0


def plausible_size(states: ObjectStates) -> Bools:
    """(n,) tracks of boxes that road users have."""
    return np.asarray(((states.size >= SMALLEST_M) & (states.size <= LARGEST_M)).all(axis=1))


def on_ground(states: ObjectStates, agent: Ints) -> Bools:
    """(n,) tracks of boxes that stand on the ground.

    agent: (n,) rows of the agents. The ground is where the boxes of most agents stand, each at its median: one agent
    with many boxes does not move it. It rises or falls by SLOPE at most.
    """
    if len(states) <= 2:
        return np.ones(len(states), np.bool_)
    bottom = states.position[:, 2] - 0.5 * states.size[:, 2]
    middles = [
        [*np.median(states.position[agent == row, :2], axis=0), np.median(bottom[agent == row])]
        for row in np.unique(agent).tolist()
    ]
    x, y, height = np.median(np.array(middles), axis=0)
    away = np.hypot(states.position[:, 0] - x, states.position[:, 1] - y)
    return np.asarray(np.abs(bottom - height) <= HEIGHT_ERROR_M + SLOPE * away)


def possible(states: ObjectStates, believed: Bools | None = None) -> Bools:
    """(n,) tracks of boxes that road users have, on the ground.

    believed: (n,) tracks that show where the ground is; None: all

    The ground is where the boxes stand, at the median, and rises or falls by SLOPE at most.
    """
    fine = plausible_size(states)
    shown = np.ones(len(states), np.bool_) if believed is None else believed
    if shown.sum() > 2:
        bottom = states.position[:, 2] - 0.5 * states.size[:, 2]
        middle = np.median(states.position[shown, :2], axis=0)
        away = np.hypot(*(states.position[:, :2] - middle).T)
        fine &= np.abs(bottom - np.median(bottom[shown])) <= HEIGHT_ERROR_M + SLOPE * away
    return np.asarray(fine)


def of_tracks(batch: Batch, tracks: Bools) -> Bools:
    """(c, a) whether the agent reports the object by one of some tracks (n,)."""
    result = np.zeros(batch.reported.shape, np.bool_)
    result[batch.labels[tracks], batch.agent[tracks]] = True
    return result


def repeated(batch: Batch) -> Bools:
    """(n,) tracks that overlap an earlier one of the same agent, by id, so far that both are of one object."""
    states = batch.states
    result = np.zeros(len(states), np.bool_)
    reach = REPEATED * np.maximum(np.maximum(states.size[:, 0], states.size[:, 1]), 0.0)
    i, j, dx, dy = neighbours(states.position, states.position, np.minimum(reach, LARGEST_M[0]))
    pair = (batch.agent[i] == batch.agent[j]) & (i != j) & (states.id[i] <= states.id[j])
    i, j, offset = i[pair], j[pair], np.column_stack([dx[pair], dy[pair]])
    same = overlap(offset, states.size[i], states.yaw[i], states.size[j], states.yaw[j], REPEATED)
    result[j[same]] = True
    return result


def about(batch: Batch, boxes: ClusterBoxes) -> Bools:
    """(c, a) whether the agent has a track within ABOUT_M of the object, in any cluster. boxes: of the clusters"""
    result = batch.reported.copy()
    i, j, _, _ = neighbours(boxes.position, batch.states.position, np.full(batch.clusters, ABOUT_M))
    result[i, batch.agent[j]] = True
    return result


#: Minimum number of viewers to settle a dispute: of two agents, either may be wrong.
MIN_VIEWERS = 3
#: sr; an object that looks smaller may go unnoticed (a lidar with 0.2 by 0.9 degrees has some 50 returns of this).
CLEAR_SR = 2.5e-3
#: m, farther away is not clear.
CLEAR_M = 60.0


@dataclass(frozen=True, slots=True, eq=False)
class Disputes:
    """What the majority of the viewers of each of `c` objects says about each of `a` agents.

    contradicted: (c, a) reports an object that the majority sees through
    overlooked:   (c, a) sees through an object that the majority reports
    silent:       (c, a) does not report an object that others do, though its rays end there and it is clear to see
    inconsistent: (c, a) reports an object that its own sensor sees through
    impossible:   (c, a) reports an object that no road user can be;  repeated: (c, a) reports one for the second time
    confirming, contradicting: (c,) sums of the weights of those that report the object, and see through it
    """

    contradicted: Bools
    overlooked: Bools
    silent: Bools
    inconsistent: Bools
    impossible: Bools
    repeated: Bools
    confirming: Floats
    contradicting: Floats

    @property
    def accusations(self) -> dict[str, Bools]:
        """(c, a) what counts against an agent, by its description."""
        return {
            "reports objects that others see through": self.contradicted,
            "reports objects in space that its own sensor sees through": self.inconsistent,
            "claims to see through objects that others report": self.overlooked,
            "does not report objects that it should see": self.silent,
            "reports objects that no road user can be": self.impossible,
            "reports one object twice": self.repeated,
        }


def disputes(
    batch: Batch, boxes: ClusterBoxes, own: Bools, seen: Sightings, rays: RayEvidence, weight: Floats
) -> Disputes:
    """Settle the disputes about the objects of a batch by the majority of their viewers.

    boxes: of the clusters; own: (c, a) whether the agent sees through its own track of the object
    seen, rays: what the sensors see of the objects, and what their rays show
    weight: (a,) 0 to 1, of each agent's vote

    An agent that reports an object confirms it if its own sensor sees its place, and does not see through it: liars
    that report what they cannot see have no vote. An agent that most rays pass speaks for an object that is reported
    as little as one that all rays pass, but only the latter accuses.
    A dispute of fewer than MIN_VIEWERS agents counts against nobody, and so does a tie. Nobody is silent about an
    object beside which it has a track: another agent may have divided a cluster by two tracks of one object.
    """
    reported = batch.reported
    impossible = of_tracks(batch, ~possible(batch.states, weight[batch.agent] > 0.0))
    claims = reported & ~own & ~impossible
    confirms = claims & (seen.in_view | rays.ends)
    denies = seen.fully_clear & ~reported
    doubts = rays.mostly_clear & ~reported
    voter = weight > 0.0
    confirming, contradicting = confirms @ weight, denies @ weight
    viewers = (claims & voter).sum(axis=1) + (doubts & voter).sum(axis=1)
    settled = viewers >= MIN_VIEWERS
    false, true = settled & (contradicting > confirming), settled & (confirming > doubts @ weight)
    silent = ~about(batch, boxes) & ~rays.mostly_clear & rays.ends & seen.in_view & clear(boxes.size, seen.distance)
    return Disputes(
        contradicted=false[:, None] & reported,
        overlooked=true[:, None] & denies,
        silent=silent & true[:, None],
        inconsistent=reported & own,
        impossible=impossible,
        repeated=of_tracks(batch, repeated(batch)),
        confirming=confirming,
        contradicting=contradicting,
    )


def clear(size: Floats, distance: Floats) -> Bools:
    """(c, a) whether objects of a size (c, 3) m are easy to see from (c, a) m."""
    area = 0.5 * (size[:, 0] + size[:, 1]) * size[:, 2]
    return np.asarray((distance <= CLEAR_M) & (area[:, None] >= CLEAR_SR * distance**2))
