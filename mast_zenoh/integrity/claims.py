"""Which tracks no honest agent sends: of impossible boxes, and of one object twice."""

from __future__ import annotations

import numpy as np

from mast_zenoh.arrays.neighbours import neighbours
from mast_zenoh.arrays.states import Bools, ObjectStates
from mast_zenoh.integrity.base import Batch
from mast_zenoh.integrity.clusters import ClusterBoxes
from mast_zenoh.tracking.duplicates import ONE_OBJECT, overlap

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


def possible(states: ObjectStates, believed: Bools | None = None) -> Bools:
    """(n,) tracks of boxes that road users have, on the ground.

    believed: (n,) tracks that show where the ground is; None: all

    The ground is where the boxes stand, at the median, and rises or falls by SLOPE at most.
    """
    fine = ((states.size >= SMALLEST_M) & (states.size <= LARGEST_M)).all(axis=1)
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
