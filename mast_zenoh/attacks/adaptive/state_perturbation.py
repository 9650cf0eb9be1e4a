"""Real objects with false velocity, heading, size, covariance or score."""

from __future__ import annotations

import numpy as np

from mast_zenoh.arrays.geometry import wrap_angle
from mast_zenoh.attacks.adaptive.base import AdaptiveAttack, Lies, Moment
from mast_zenoh.attacks.adaptive.chosen import ChosenObjects, distance_to_ego


class StatePerturbation(AdaptiveAttack):
    """Changes all about the objects nearest to the ego but their positions.

    A false velocity spoils predictions, a small covariance gives the victim more weight in the fusion, a low score less
    credit to a true object. Objects keep their places, so that nothing is found where positions are compared.
    Source: false fields of V2X messages, VeReMi (van der Heijden et al., 2018).

    velocity_mps:      m/s added along the heading (tracks; detections have no velocity)
    heading_rad:       rad added to the heading
    size_factor, covariance_factor, score_factor: by which these are multiplied, more than 0; a score is at most 1
    budget:            lies per second, so the number of objects
    start_s:           s of scene time at which the attack begins
    """

    def __init__(
        self,
        *,
        velocity_mps: float = 5.0,
        heading_rad: float = 0.0,
        size_factor: float = 1.0,
        covariance_factor: float = 0.25,
        score_factor: float = 1.0,
        budget: float = 2.0,
        start_s: float = 4.0,
    ) -> None:
        super().__init__(budget=budget, start_s=start_s)
        factors = {
            "size_factor": size_factor,
            "covariance_factor": covariance_factor,
            "score_factor": score_factor,
        }
        for name, value in factors.items():
            if not 0.0 < value <= 1e3:
                raise ValueError(f"{name}: found {value}, expected more than 0 and at most 1000")
        for name, value in (("velocity_mps", velocity_mps), ("heading_rad", heading_rad)):
            if not abs(value) <= 1e3:
                raise ValueError(f"{name}: found {value}, expected -1000 to 1000")
        self._velocity_mps, self._heading_rad = velocity_mps, heading_rad
        self._size, self._covariance, self._score = factors.values()
        self._chosen = ChosenObjects(self._follower, self.budget, self.numbers)

    def rest(self) -> None:
        self._chosen.clear()

    def lie(self, moment: Moment) -> Lies:
        numbers, rows = self._chosen.update(moment, distance_to_ego(moment))
        real = moment.seen.select(rows)
        heading = np.column_stack([np.cos(real.yaw), np.sin(real.yaw), np.zeros(len(rows))])
        moves = np.any(real.velocity, axis=1, keepdims=True)
        claims = real.with_(
            velocity=real.velocity + self._velocity_mps * heading * moves,
            yaw=wrap_angle(real.yaw + self._heading_rad),
            size=real.size * self._size,
            covariance=real.covariance * self._covariance,
            score=np.minimum(real.score * self._score, 1.0),
        )
        return Lies(changed=rows, claims=claims, changed_number=numbers)
