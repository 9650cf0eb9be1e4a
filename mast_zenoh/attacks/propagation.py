"""How false objects move from frame to frame. A victim's tracker confirms what moves like traffic."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar

import numpy as np

from mast_zenoh.states import ObjectStates, propagate


class Propagation(ABC):
    """Moves the false objects of an adversary."""

    #: Whether `advance` draws anything. If not it is spared a stream of its own.
    draws: ClassVar[bool] = True

    @abstractmethod
    def advance(self, states: ObjectStates, elapsed_s: float, age_s: float, rng: np.random.Generator) -> ObjectStates:
        """False objects `elapsed_s` seconds later, world frame.

        `age_s` is the time from their selection to `states`. Called once with both zero right after the
        selection, so that what a model says of velocities holds from the first frame on.
        """


class StaticPropagation(Propagation):
    """False objects stand where they were put, and say so: their velocity is zero."""

    draws = False

    def advance(self, states: ObjectStates, elapsed_s: float, age_s: float, rng: np.random.Generator) -> ObjectStates:
        return states.with_(velocity=np.zeros_like(states.velocity))


class MarkovPropagation(Propagation):
    """A random walk of the velocity: v += a·dt with a ~ N(0, `sigma_mps2`) on x and y, speed at most `max_speed_mps`.

    This is the originals' `v += dv·dt` with dv σ 0.5: in a step of dt seconds the velocity changes by σ = 0.5·dt m/s
    on each axis, so over T seconds by 0.5·sqrt(T·dt) m/s. The box turns with its velocity.
    """

    def __init__(self, *, sigma_mps2: float = 0.5, max_speed_mps: float = 30.0) -> None:
        self.sigma_mps2 = sigma_mps2
        self.max_speed_mps = max_speed_mps

    def advance(self, states: ObjectStates, elapsed_s: float, age_s: float, rng: np.random.Generator) -> ObjectStates:
        velocity = states.velocity.copy()
        velocity[:, :2] += rng.normal(0.0, 1.0, (len(states), 2)) * (self.sigma_mps2 * elapsed_s)
        speed = np.linalg.norm(velocity, axis=1, keepdims=True)
        velocity *= np.minimum(1.0, self.max_speed_mps / np.maximum(speed, 1e-12))
        yaw = np.where(speed[:, 0] > 1e-6, np.arctan2(velocity[:, 1], velocity[:, 0]), states.yaw)
        return propagate(states.with_(velocity=velocity, yaw=yaw), elapsed_s)


class TrajectoryPropagation(Propagation):
    """A planned path: constant velocity for `duration_s` seconds, then standing at its end."""

    draws = False

    def __init__(self, *, duration_s: float = 10.0) -> None:
        self.duration_s = duration_s

    def advance(self, states: ObjectStates, elapsed_s: float, age_s: float, rng: np.random.Generator) -> ObjectStates:
        remaining = self.duration_s - age_s
        moved = propagate(states, min(elapsed_s, max(remaining, 0.0)))
        # Standing from the frame in which the path is driven to its end; 1 ns absorbs the rounding of the age.
        return moved if elapsed_s < remaining - 1e-9 else moved.with_(velocity=np.zeros_like(moved.velocity))
