"""False objects where no honest agent looks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mast_zenoh.arrays.states import Bools, ObjectStates
from mast_zenoh.attacks.adaptive.base import Moment
from mast_zenoh.attacks.adaptive.phantoms import PhantomAttack
from mast_zenoh.attacks.coverage import boxes_of
from mast_zenoh.attacks.regions import REGIONS

#: s before an honest agent would see a phantom, at which it is withdrawn.
AHEAD_S = 1.0


class BlindSpot(PhantomAttack):
    """Invents vehicles in the victim's view where no honest agent looks, and withdraws them before one does.

    The attacker knows the buildings, the sensors and the routes of all agents (`Surroundings`); with the picture it
    also avoids objects that it does not see itself. Nobody can contradict such an object: a command centre that wants
    two witnesses for each object loses all true objects with a single witness, too.
    Source: fabricated objects that no other view contradicts, Zhang et al. (USENIX Security 2024).

    budget:    lies per second, so the number of false objects
    start_s:   s of scene time at which the attack begins
    speed_mps: σ per axis of their speed; it is less where the unseen way is short
    """

    region = REGIONS["outnumbered"]

    def __init__(self, *, budget: float = 2.0, start_s: float = 4.0, speed_mps: float = 5.0) -> None:
        super().__init__(budget=budget, start_s=start_s, speed_mps=speed_mps)

    def _given_up(self, moment: Moment, phantoms: ObjectStates) -> Bools:
        if len(phantoms) == 0:
            return np.zeros(0, bool)
        coverage = moment.coverage
        later = replace(coverage, time_s=coverage.time_s + AHEAD_S)
        seen = coverage.honest_viewers(phantoms) + later.honest_viewers(phantoms) > 0
        return seen if coverage.fused else seen | ~coverage.visible(moment.view, boxes_of(phantoms))
