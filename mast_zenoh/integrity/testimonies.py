"""What agents say of each object, who contradicts whom, and what an agent says that contradicts itself."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mast_zenoh.arrays.states import Bools, Ints
from mast_zenoh.integrity.base import Batch, ClusterBoxes
from mast_zenoh.integrity.disputes import about, clear, of_tracks, on_ground, plausible_size, repeated
from mast_zenoh.integrity.visibility import RayEvidence, Sightings

#: Agents that must report an object before another one's silence about it contradicts them: trackers of honest agents
#: are late by some frames, and lose objects for some.
WITNESSES = 2


@dataclass(frozen=True, slots=True, eq=False)
class Testimonies:
    """What each of `a` agents says of each of `c` objects.

    claims: (c, a) reports it, and nothing that its own sensor shows speaks against it
    denies: (c, a) all its rays pass through it;  silent: (c, a) does not report it, though its rays end there, it is
            clear to see, and WITNESSES report it
    inconsistent: (c, a) reports it, though its own sensor sees through it, and nobody else does: a tracker that has
            lost a real object goes on for some frames
    impossible:   (c, a) reports it as a box that no road user has;  repeated: (c, a) reports it for the second time
    """

    claims: Bools
    denies: Bools
    silent: Bools
    inconsistent: Bools
    impossible: Bools
    repeated: Bools

    @classmethod
    def of(cls, batch: Batch, boxes: ClusterBoxes, own: Bools, seen: Sightings, rays: RayEvidence) -> Testimonies:
        """The testimonies of a batch.

        boxes: of its clusters; own: (c, a) whether the agent sees through its own track of the object
        seen, rays: what the sensors see of the objects, and what their rays show
        """
        reported, states = batch.reported, batch.states
        impossible = of_tracks(batch, ~(plausible_size(states) & on_ground(states, batch.agent)))
        claims = reported & ~own & ~impossible
        silent = ~about(batch, boxes) & ~rays.mostly_clear & rays.ends & seen.in_view & clear(boxes.size, seen.distance)
        return cls(
            claims=claims,
            denies=seen.fully_clear & ~reported,
            silent=silent & (claims.sum(axis=1) >= WITNESSES)[:, None],
            inconsistent=reported & own & ~claims.any(axis=1, keepdims=True),
            impossible=impossible,
            repeated=of_tracks(batch, repeated(batch)),
        )

    @property
    def between(self) -> Ints:
        """(a, a) number of objects about which two agents contradict each other."""
        against = self.claims.T.astype(np.int64) @ (self.denies | self.silent)
        return np.asarray(against + against.T)

    @property
    def against_itself(self) -> Ints:
        """(a,) number of objects of which an agent's report contradicts itself."""
        return np.asarray((self.inconsistent | self.impossible | self.repeated).sum(axis=0))

    @property
    def accusations(self) -> dict[str, Bools]:
        """(c, a) what contradicts the reports of an agent, by its description.

        What an agent does not report is no accusation: the object stays in the picture as long as another one reports
        it, and things that a sensor does not see are easier to make than things that are not there (TrustFlip).
        """
        return {
            "reports objects that others see through": self.claims & self.denies.any(axis=1, keepdims=True),
            "reports objects in space that its own sensor sees through": self.inconsistent,
            "reports objects that no road user can be": self.impossible,
            "reports one object twice": self.repeated,
        }
