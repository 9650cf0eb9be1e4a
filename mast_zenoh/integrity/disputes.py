"""Contradictions between agents about an object: reports, clear rays and silence."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mast_zenoh.arrays.states import Bools, Floats
from mast_zenoh.integrity.visibility import RayEvidence, Sightings

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
    confirming, contradicting: (c,) sums of the weights of those that report the object, and see through it
    """

    contradicted: Bools
    overlooked: Bools
    silent: Bools
    inconsistent: Bools
    confirming: Floats
    contradicting: Floats


def disputes(reported: Bools, own: Bools, size: Floats, seen: Sightings, rays: RayEvidence, weight: Floats) -> Disputes:
    """Settle the disputes about c objects by the majority of their viewers.

    reported: (c, a) whether the agent reports the object; own: (c, a) and its sensor sees through its own track of it
    size: (c, 3) m; seen: what the sensors see of the objects
    rays: what they show of the objects
    weight: (a,) 0 to 1, of each agent's vote

    An agent that reports an object confirms it if its own sensor sees its place, and does not see through it: liars
    that report what they cannot see have no vote. An agent that most rays pass speaks for an object that is reported
    as little as one that all rays pass, but only the latter accuses.
    A dispute of fewer than MIN_VIEWERS agents counts against nobody, and so does a tie.
    """
    claims = reported & ~own
    confirms = claims & (seen.in_view | rays.ends)
    denies = seen.fully_clear & ~reported
    doubts = rays.mostly_clear & ~reported
    voter = weight > 0.0
    confirming, contradicting = confirms @ weight, denies @ weight
    viewers = (claims & voter).sum(axis=1) + (doubts & voter).sum(axis=1)
    settled = viewers >= MIN_VIEWERS
    false, true = settled & (contradicting > confirming), settled & (confirming > doubts @ weight)
    return Disputes(
        contradicted=false[:, None] & reported,
        overlooked=true[:, None] & denies,
        silent=true[:, None] & ~reported & ~rays.mostly_clear & rays.ends & seen.in_view & clear(size, seen.distance),
        inconsistent=reported & own,
        confirming=confirming,
        contradicting=contradicting,
    )


def clear(size: Floats, distance: Floats) -> Bools:
    """(c, a) whether objects of a size (c, 3) m are easy to see from (c, a) m."""
    area = 0.5 * (size[:, 0] + size[:, 1]) * size[:, 2]
    return np.asarray((distance <= CLEAR_M) & (area[:, None] >= CLEAR_SR * distance**2))
