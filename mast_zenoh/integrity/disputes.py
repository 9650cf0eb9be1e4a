"""Contradictions between agents about an object: reports, clear rays and silence."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mast_zenoh.arrays.states import Bools, Floats
from mast_zenoh.integrity.base import Batch
from mast_zenoh.integrity.claims import about, of_tracks, possible, repeated
from mast_zenoh.integrity.clusters import ClusterBoxes
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
