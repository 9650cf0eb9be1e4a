"""Real objects beside their places, with covariances that claim to be certain."""

from __future__ import annotations

import numpy as np

from mast_zenoh.attacks.adaptive.base import AdaptiveAttack, Lies, Moment
from mast_zenoh.attacks.adaptive.chosen import ChosenObjects, distance_to_ego


class Overconfidence(AdaptiveAttack):
    """Moves objects a little and claims to be certain about them, so that a fusion by covariances believes it alone.

    All objects move alike, in a direction drawn once; the offset is too small for them to be other objects. Fusion
    weighs by the inverse of the reported covariance, so a sender sets its own weight. Source: no linear combination
    withstands a single liar (Blanchard et al., Machine Learning with Adversaries, NeurIPS 2017, Lemma 1).

    offset_m:          m, from where the objects are
    covariance_factor: by which covariances are multiplied, more than 0
    budget:            lies per second, so the number of objects, those nearest to the ego first
    start_s:           s of scene time at which the attack begins
    """

    def __init__(
        self, *, offset_m: float = 1.9, covariance_factor: float = 1e-6, budget: float = 2.0, start_s: float = 4.0
    ) -> None:
        super().__init__(budget=budget, start_s=start_s)
        if not 0.0 <= offset_m < np.inf:
            raise ValueError(f"offset_m: found {offset_m}, expected 0 or more")
        if not 0.0 < covariance_factor <= 1e3:
            raise ValueError(f"covariance_factor: found {covariance_factor}, expected more than 0 and at most 1000")
        self._offset_m, self._factor = offset_m, covariance_factor
        self._direction = np.zeros(3)
        self._chosen = ChosenObjects(self._follower, self.budget, self.numbers)

    def bind(self, seed: int, name: str) -> None:
        super().bind(seed, name)
        angle = float(self.stream("direction").uniform(-np.pi, np.pi))
        self._direction = np.array([np.cos(angle), np.sin(angle), 0.0])

    def rest(self) -> None:
        self._chosen.clear()

    def lie(self, moment: Moment) -> Lies:
        numbers, rows = self._chosen.update(moment, distance_to_ego(moment))
        real = moment.seen.select(rows)
        claims = real.with_(
            position=real.position + self._offset_m * self._direction, covariance=real.covariance * self._factor
        )
        return Lies(changed=rows, claims=claims, changed_number=numbers)
