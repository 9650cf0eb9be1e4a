"""False objects in the ego's lane."""

from __future__ import annotations

import numpy as np

from mast_zenoh.arrays.states import Bools, ObjectStates
from mast_zenoh.attacks.adaptive.base import Moment
from mast_zenoh.attacks.adaptive.phantoms import PhantomAttack
from mast_zenoh.attacks.ego_path import PATH_AHEAD_M, path_ahead
from mast_zenoh.attacks.regions import LANE_M, REGIONS

#: m; a phantom nearer to the ego than this would be hit: it is withdrawn.
NEAREST_M = 6.0


class GhostAhead(PhantomAttack):
    """Puts vehicles into the ego's lane, 10 to 60 m ahead of it, so that it brakes.

    A phantom that the ego would hit, or that is no longer on its path, is withdrawn, and another one is placed. The
    attacker knows the ego's route. Source: the "front-near" spoofing of Cao et al. (CCS 2019), in collaborative
    perception Zhang et al. (USENIX Security 2024).

    budget:    lies per second, so the number of false objects
    start_s:   s of scene time at which the attack begins
    speed_mps: σ per axis of their speed, at most half of the ego's; 0: they stand
    """

    region = REGIONS["ego_path"]

    def __init__(self, *, budget: float = 2.0, start_s: float = 4.0, speed_mps: float = 0.0) -> None:
        super().__init__(budget=budget, start_s=start_s, speed_mps=speed_mps)

    def _given_up(self, moment: Moment, phantoms: ObjectStates) -> Bools:
        path = path_ahead(moment.coverage)
        if path is None or len(phantoms) == 0:
            return np.ones(len(phantoms), bool)
        offset = phantoms.position[:, :2] - path.corners[0]
        distance = np.hypot(offset[:, 0], offset[:, 1])
        off_path = path.offset(phantoms.position) > LANE_M + 1.0  # samples of the path are 1 m apart
        return np.asarray(off_path | (distance < NEAREST_M) | (distance > PATH_AHEAD_M[1] + NEAREST_M))
