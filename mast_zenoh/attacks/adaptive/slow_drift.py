"""Real objects that drift away slowly."""

from __future__ import annotations

import numpy as np

from mast_zenoh.attacks.adaptive.base import AdaptiveAttack, Lies, Moment
from mast_zenoh.attacks.adaptive.chosen import ChosenObjects, distance_to_ego
from mast_zenoh.attacks.knowledge import Trust, TrustWatch


class SlowDrift(AdaptiveAttack):
    """Moves the objects nearest to the ego by an offset that grows so slowly that no single message is suspicious.

    Each object drifts in a direction drawn once; its velocity agrees with the drift. While the trust in the victim is
    more than `tolerance` below its highest value (an attacker that hears it), offsets shrink at the same rate.
    Source: biases that stay below a detector's threshold, Murguia and Ruths (2019); small shifts of objects, PosePert
    (arXiv 2605.01301).

    rate_mps:  m/s by which an offset grows
    limit_m:   m, largest offset
    tolerance: 0 to 1, fall of the trust that is accepted
    budget:    lies per second, so the number of objects that drift
    start_s:   s of scene time at which the attack begins
    """

    def __init__(
        self,
        *,
        rate_mps: float = 0.2,
        limit_m: float = 2.0,
        tolerance: float = 0.05,
        budget: float = 2.0,
        start_s: float = 4.0,
    ) -> None:
        super().__init__(budget=budget, start_s=start_s)
        for name, value in (("rate_mps", rate_mps), ("limit_m", limit_m)):
            if not 0.0 < value < np.inf:
                raise ValueError(f"{name}: found {value}, expected more than 0")
        self._rate_mps, self._limit_m = rate_mps, limit_m
        self._watch = TrustWatch(tolerance)
        self._chosen = ChosenObjects(self._follower, self.budget, self.numbers)
        self._offset_m: dict[int, float] = {}  # by number
        self._direction: dict[int, float] = {}

    def hear_trust(self, frame: int, time_ns: int, trust: Trust) -> None:
        self._watch.hear(trust, self._surroundings.victims)

    def rest(self) -> None:
        self._chosen.clear()

    def lie(self, moment: Moment) -> Lies:
        numbers, rows = self._chosen.update(moment, distance_to_ego(moment))
        rate = -self._rate_mps if self._watch.fallen else self._rate_mps
        offset, speed, angle = np.zeros((3, len(rows)))
        for i, number in enumerate(numbers.tolist()):
            before = self._offset_m.get(number, 0.0)
            after = min(max(before + rate * moment.elapsed_s, 0.0), self._limit_m)
            self._offset_m[number] = offset[i] = after
            speed[i] = rate if after != before and 0.0 < after < self._limit_m else 0.0
            if number not in self._direction:
                self._direction[number] = float(self.stream("direction", number).uniform(-np.pi, np.pi))
            angle[i] = self._direction[number]
        real = moment.seen.select(rows)
        direction = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(len(angle))])
        moves = np.where(real.velocity.any(axis=1), speed, 0.0)  # detections have no velocity
        claims = real.with_(
            position=real.position + direction * offset[:, None], velocity=real.velocity + direction * moves[:, None]
        )
        return Lies(changed=rows, claims=claims, changed_number=numbers)
