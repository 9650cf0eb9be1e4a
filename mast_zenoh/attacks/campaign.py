"""Life cycle of a set of targets: selection, motion, reselection.

A victim's tracker confirms false objects only if they move like traffic: along their heading, with bounded acceleration
and yaw rate.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.geometry import wrap_angle
from mast_zenoh.arrays.states import Floats, ObjectStates, propagate
from mast_zenoh.attacks.regions import MAX_ACCELERATION_MPS2
from mast_zenoh.attacks.selection import Selection
from mast_zenoh.attacks.surroundings import Coverage
from mast_zenoh.attacks.targets import Targets
from mast_zenoh.streams import stream

#: rad/s and m: maximum yaw rate and minimum turning radius of a car.
MAX_YAW_RATE, MIN_TURN_RADIUS_M = 0.6, 5.0


class Propagation(ABC):
    """Moves the false objects of an adversary."""

    #: Whether `advance` uses random numbers; if not, no stream is created for it.
    draws: ClassVar[bool] = True

    @abstractmethod
    def advance(self, states: ObjectStates, elapsed_s: float, age_s: float, rng: np.random.Generator) -> ObjectStates:
        """Move false objects by `elapsed_s` seconds, world frame.

        `age_s` is the time from their selection to `states`. Called once with both zero right after the selection, so
        that the model's velocities apply from the first frame.
        """


class StaticPropagation(Propagation):
    """False objects at rest: constant position, zero velocity."""

    draws = False

    def advance(self, states: ObjectStates, elapsed_s: float, age_s: float, rng: np.random.Generator) -> ObjectStates:
        return states.with_(velocity=np.zeros_like(states.velocity))


@dataclass(kw_only=True, eq=False)
class MarkovPropagation(Propagation):
    """A random walk of the velocity: v += a·dt, a ~ N(0, `sigma_mps2`) on x and y.

    sigma_mps2: standard deviation of the acceleration on each axis;  max_speed_mps: upper limit of the speed

    This is the originals' `v += dv·dt` with dv σ 0.5: in a step of dt seconds the velocity changes by σ = 0.5·dt m/s
    on each axis, so over T seconds by 0.5·sqrt(T·dt) m/s. Of each change, the component along the heading is
    bounded by MAX_ACCELERATION_MPS2 and never reverses the object; the lateral one turns it by MAX_YAW_RATE at most.
    """

    sigma_mps2: float = 0.5
    max_speed_mps: float = 30.0

    def advance(self, states: ObjectStates, elapsed_s: float, age_s: float, rng: np.random.Generator) -> ObjectStates:
        change = rng.normal(0.0, 1.0, (len(states), 2)) * (self.sigma_mps2 * elapsed_s)
        speed, yaw = _speed_and_heading(states)
        forward, left = _unit_vectors(yaw)
        limit = MAX_ACCELERATION_MPS2 * elapsed_s
        along = np.clip((change * forward).sum(axis=1), -limit, limit)
        lateral = (change * left).sum(axis=1)
        turn_limit = np.minimum(MAX_YAW_RATE, speed / MIN_TURN_RADIUS_M) * elapsed_s
        yaw = wrap_angle(yaw + np.clip(lateral / np.maximum(speed, 1e-6), -turn_limit, turn_limit))
        top_speed = np.maximum(self.max_speed_mps, speed - limit)  # an object that starts too fast brakes
        speed = np.clip(speed + along, 0.0, top_speed)
        return _move_along(states, yaw, speed, speed * elapsed_s)


@dataclass(kw_only=True, eq=False)
class TrajectoryPropagation(Propagation):
    """A planned path: constant velocity for `duration_s`, then braking to a stop.

    duration_s: s, of constant velocity;  braking_mps2: deceleration after it

    Raises ValueError for a deceleration that is not positive.
    """

    draws = False

    duration_s: float = 10.0
    braking_mps2: float = MAX_ACCELERATION_MPS2

    def __post_init__(self) -> None:
        check("more than 0", braking_mps2=self.braking_mps2)

    def advance(self, states: ObjectStates, elapsed_s: float, age_s: float, rng: np.random.Generator) -> ObjectStates:
        if age_s > 0.0 and age_s + elapsed_s <= self.duration_s:
            return propagate(states, elapsed_s)  # the heading has followed the velocity since the first step
        speed, yaw = _speed_and_heading(states)
        cruising = min(max(self.duration_s - age_s, 0.0), elapsed_s)
        final_speed = np.maximum(speed - self.braking_mps2 * (elapsed_s - cruising), 0.0)
        distance = speed * cruising + (speed**2 - final_speed**2) / (2.0 * self.braking_mps2)
        return _move_along(states, yaw, final_speed, distance)


def _speed_and_heading(states: ObjectStates) -> tuple[Floats, Floats]:
    """Speeds (n,) m/s over ground, and headings (n,) rad.

    The heading follows the velocity, or the box for objects at rest.
    """
    vx, vy = states.velocity[:, 0], states.velocity[:, 1]
    speed = np.hypot(vx, vy)
    return speed, np.where(speed > 1e-6, np.arctan2(vy, vx), states.yaw)


def _unit_vectors(yaw: Floats) -> tuple[Floats, Floats]:
    """(n, 2) unit vectors along and to the left of headings."""
    c, s = np.cos(yaw), np.sin(yaw)
    return np.column_stack([c, s]), np.column_stack([-s, c])


def _move_along(states: ObjectStates, yaw: Floats, speed: Floats, distance: Floats) -> ObjectStates:
    """Move the objects by `distance` (n,) m along headings `yaw` (n,).

    speed: (n,) m/s, the new speeds
    """
    forward = np.column_stack([np.cos(yaw), np.sin(yaw), np.zeros(len(yaw))])
    return states.with_(
        position=states.position + forward * distance[:, None], velocity=forward * speed[:, None], yaw=yaw
    )


NANOSECONDS = 1e9

COUNTS = ("selected", "placed", "wanted")

_UNUSED = np.random.default_rng(0)  # for models without random numbers: creating a stream is slow


class Campaign:
    """Selects and propagates targets for an uncoordinated adversary or a coordinator.

    There are no targets before `start_s` seconds of scene time. New ones are selected every `reselect_every_s` seconds
    (None: never), and with `Selection.until_found` in every frame until there is one.
    Random streams: (seed, scene, name, "selection" | "propagation", frame).
    counts: number of objects selected to be hidden or moved, of false objects placed, and of false objects wanted

    Raises ValueError for an interval that is not positive, and for a start before the start of the scene.
    """

    def __init__(
        self, selection: Selection, propagation: Propagation, reselect_every_s: float | None, start_s: float
    ) -> None:
        if reselect_every_s is not None and not reselect_every_s > 0.0:
            raise ValueError(f"reselect_every_s: found {reselect_every_s}, expected more than 0, or None")
        check("0 or more, finite", start_s=start_s)
        self._selection = selection
        self._propagation = propagation
        self._every_ns = None if reselect_every_s is None else round(reselect_every_s * NANOSECONDS)
        self._start_ns = round(start_s * NANOSECONDS)
        self._selected_ns: int | None = None
        self._targets = Targets.empty()
        self._time_ns = 0
        self._numbers_used = 0
        self.counts = dict.fromkeys(COUNTS, 0)
        self._seed, self._scene, self._name = 0, "", ""

    def bind(self, seed: int, scene: str, name: str) -> None:
        """Set the random streams, named by (seed, scene, name, purpose, frame)."""
        self._seed, self._scene, self._name = seed, scene, name

    def begin(self, frame: int, time_ns: int, scene: Callable[[], tuple[ObjectStates, Coverage]]) -> Targets | None:
        """The targets at `time_ns`, None before the start.

        scene: called if new targets are due, for objects as in `Selection.view`, and the coverage
        """
        if time_ns < self._start_ns:
            return None
        selected_ns = self._selected_ns
        if selected_ns is None or (self._every_ns is not None and time_ns - selected_ns >= self._every_ns):
            chosen = self._selection.select(*scene(), self._stream("selection", frame))
            targets = chosen.numbered(self._numbers_used)
            self._numbers_used += len(targets)
            placed = len(targets.add)
            wanted = placed if targets.wanted is None else targets.wanted
            for name, count in zip(COUNTS, (len(targets) - placed, placed, wanted), strict=True):
                self.counts[name] += count
            if len(targets) or not self._selection.until_found:
                self._selected_ns = time_ns
            elapsed, age = 0.0, 0.0
        else:
            elapsed = (time_ns - self._time_ns) / NANOSECONDS
            age = (self._time_ns - selected_ns) / NANOSECONDS
            stored = self._targets
            targets = replace(stored, remove=propagate(stored.remove, elapsed), move=propagate(stored.move, elapsed))
        rng = self._stream("propagation", frame) if self._propagation.draws else _UNUSED
        add = self._propagation.advance(targets.add, elapsed, age, rng)
        return replace(targets, add=add, time_ns=time_ns)

    def store(self, targets: Targets, time_ns: int) -> None:
        """Store the current targets, after they have followed their objects."""
        self._targets, self._time_ns = targets, time_ns

    def _stream(self, purpose: str, frame: int) -> np.random.Generator:
        return stream(self._seed, self._scene, self._name, purpose, frame)


def shortfall(counts: Mapping[str, int]) -> str:
    """Describe the targets that could not be found or placed; "" if none.

    counts: see `Attack.counts`
    """
    if "wanted" not in counts:
        return ""
    if counts["wanted"] > counts["placed"]:
        return f"no place for {counts['wanted'] - counts['placed']} of {counts['wanted']} false objects in its region"
    return "" if counts["selected"] or counts["placed"] else "no target was found"
