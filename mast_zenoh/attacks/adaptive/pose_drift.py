"""A compromised positioning: the agent believes that it is elsewhere."""

from __future__ import annotations

import numpy as np

from mast_zenoh.arrays.states import Floats, ObjectStates
from mast_zenoh.attacks.base import Attack
from mast_zenoh.attacks.campaign import NANOSECONDS, check_start
from mast_zenoh.attacks.surroundings import Surroundings
from mast_zenoh.attacks.targets import Tampering, Targets
from mast_zenoh.streams import stream


class PoseDrift(Attack):
    """Moves the pose that an agent believes by an offset that grows slowly; on the wire `pose`.

    The agent then misplaces all its objects by as much. Source: spoofing of a vehicle's positioning, Shen et al.
    (USENIX Security 2020). It has no budget: every object of the agent is moved.

    rate_mps: m/s by which the offset grows, in a direction drawn once
    limit_m:  m, largest offset
    start_s:  s of scene time at which the attack begins
    """

    def __init__(self, *, rate_mps: float = 0.2, limit_m: float = 2.0, start_s: float = 4.0) -> None:
        check_start(start_s)
        for name, value in (("rate_mps", rate_mps), ("limit_m", limit_m)):
            if not 0.0 < value < np.inf:
                raise ValueError(f"{name}: found {value}, expected more than 0")
        self._rate_mps, self._limit_m, self._start_s = rate_mps, limit_m, start_s
        self._direction = np.array([1.0, 0.0, 0.0])
        self._scene = ""

    def inform(self, surroundings: Surroundings) -> None:
        self._scene = surroundings.scene

    def bind(self, seed: int, name: str) -> None:
        angle = float(stream(seed, self._scene, name, "direction").uniform(-np.pi, np.pi))
        self._direction = np.array([np.cos(angle), np.sin(angle), 0.0])

    def step(
        self,
        frame: int,
        time_ns: int,
        objects: ObjectStates,
        agent_position: Floats,
        directive: Targets | None = None,
    ) -> Tampering:
        return Tampering.nothing(len(objects))

    def forge_pose(self, frame: int, time_ns: int, position: Floats) -> Floats:
        offset_m = min(self._rate_mps * (time_ns / NANOSECONDS - self._start_s), self._limit_m)
        return position if offset_m <= 0.0 else position + offset_m * self._direction
