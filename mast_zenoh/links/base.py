"""Messages in transit, the detections in them, and the base class of rules."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import ClassVar, NamedTuple

import numpy as np

from mast_zenoh.arrays.geometry import heading, rotation_from_quaternion, rotation_from_yaw, wrap_angle
from mast_zenoh.arrays.states import Detections, Floats

NANOSECONDS = 1e9


class SenderPose(NamedTuple):
    """Pose of a link's agent in an earlier frame.

    time_ns: of the frame; position: (3,) m; rotation: (4,) active quaternion; velocity: (3,) m/s; turn_rate: rad/s
    """

    time_ns: int
    position: Floats
    rotation: Floats
    velocity: Floats
    turn_rate: float

    @classmethod
    def after(
        cls, previous: SenderPose | None, time_ns: int, position: Floats, rotation: Floats, velocity: Floats
    ) -> SenderPose:
        """The pose at `time_ns`; the rate of turning is that since the previous pose."""
        rate = 0.0
        if previous is not None and time_ns > previous.time_ns:
            turn = _heading(rotation) - _heading(previous.rotation)
            rate = float(wrap_angle(np.array(turn))) / (time_ns - previous.time_ns) * NANOSECONDS
        return cls(time_ns, position, rotation, velocity, rate)

    def at(self, time_ns: int) -> tuple[Floats, Floats]:
        """Position (3,) m and rotation (3, 3) at a time, for an agent that moves and turns on as before."""
        elapsed = (time_ns - self.time_ns) / NANOSECONDS
        turn = rotation_from_yaw(self.turn_rate * elapsed)
        return self.position + self.velocity * elapsed, turn @ rotation_from_quaternion(self.rotation)


class Sensed(NamedTuple):
    """The detections in a message, with their sensor.

    detections: sensor frame
    mount_position: (3,) m, mount_rotation: (3, 3) active: of the sensor in the agent's frame
    pose: of the agent; None: not known yet
    """

    detections: Detections
    mount_position: Floats
    mount_rotation: Floats
    pose: SenderPose | None


def _heading(quaternion: Floats) -> float:
    return float(heading(rotation_from_quaternion(quaternion)))


MAX_DELAY_S = 600.0  #: upper limit of the delay by one rule


class Passage(NamedTuple):
    """One copy of a message in transit through a link, with the effects so far.

    Effects are from the rules that were already applied.

    time_ns:  scene time of its passage: the newest clock's
    now_ns:   time on the clock for delays: the same in lock-step, the wall clock in real time
    size:     bytes of the message; 0 unless a rule of the link needs it
    position: (3,) m, world frame, of the link's agent in an earlier frame; None if unknown
    referenced: whether its columns are relative to the sender's pose
    copy:     0 for the message itself, from 1 for copies made in transit
    delay_ns: total delay so far
    overtakes: whether it may overtake earlier messages
    skew_ns:  error of the time in its header
    shift, turn: m (x, y) and rad, error of the sender's pose
    flips:    positions of flipped bits, as fractions (0 to 1) of its length
    sensed:   its detections; None if there are none, or unless a rule of the link needs them
    """

    time_ns: int
    now_ns: int
    size: int = 0
    position: Floats | None = None
    referenced: bool = False
    copy: int = 0
    delay_ns: int = 0
    overtakes: bool = False
    skew_ns: int = 0
    shift: tuple[float, float] = (0.0, 0.0)
    turn: float = 0.0
    flips: tuple[float, ...] = ()
    sensed: Sensed | None = None


class Rule(ABC):
    """Acts on the messages of one wire for a time.

    at, until: s of scene time at which it starts to act, and at which it stops; None: to the end

    A rule may have state (a queue, a channel); every wire has its own instances. Its random numbers are passed in: one
    row for every message on the wire, even while the rule is inactive, so that rules do not affect each other's random
    numbers. Raises ValueError for invalid parameters.
    """

    fate: ClassVar[str]  #: its effect on a message: one of links.FATES
    of_sender: ClassVar[bool] = False  #: whether these are the sender's: the same for its tracks and its view
    needs_size: ClassVar[bool] = False  #: whether it needs the size of the message
    needs_position: ClassVar[bool] = False  #: whether it needs the position of the agent
    needs_frame: ClassVar[bool] = False  #: whether it needs to know if there is a frame of reference
    needs_detections: ClassVar[bool] = False  #: whether it needs the detections in the message

    def __init__(self, at: float = 0.0, until: float | None = None) -> None:
        expect("at", at, math.isfinite(at) and at >= 0.0, "0 s or more")
        if until is not None:
            expect("until", until, math.isfinite(until) and until > at, f"more than `at`, which is {at}, or None")
        self.at, self.until = at, until
        self._from_ns = round(at * NANOSECONDS)
        self._before_ns = None if until is None else round(until * NANOSECONDS)

    def active(self, time_ns: int) -> bool:
        """Whether the rule is active at a scene time."""
        return self._from_ns <= time_ns and (self._before_ns is None or time_ns < self._before_ns)

    def sample(self, rng: np.random.Generator, count: int) -> Floats:
        """Random numbers (count, k) for the next `count` messages of the wire."""
        return np.empty((count, 0))

    def sample_copy(self, row: Sequence[float], rng: np.random.Generator) -> Sequence[float]:
        """Random numbers for an additional copy of the message with the random numbers `row`."""
        sampled: Sequence[float] = self.sample(rng, 1)[0].tolist()
        return sampled

    def restamps_s(self, duration_s: float) -> float:
        """Largest magnitude of `skew_ns`, s; overridden by rules that set it."""
        return 0.0

    @abstractmethod
    def apply(self, passage: Passage, row: Sequence[float]) -> tuple[Passage, ...]:
        """Apply the rule; returns zero or more copies, the message itself first."""


class RandomRule(Rule):
    """A rule that acts on some messages, drawn independently, with one uniform number for each.

    probability: that it acts on a message
    """

    def __init__(self, probability: float, at: float = 0.0, until: float | None = None) -> None:
        super().__init__(at, until)
        expect_probability("probability", probability)
        self.probability = probability

    def sample(self, rng: np.random.Generator, count: int) -> Floats:
        """Uniform random numbers (count, 1)."""
        return rng.random((count, 1))


def expect(name: str, value: object, condition: bool, expected: str) -> None:
    """Raise ValueError if a condition on a parameter does not hold."""
    if not condition:
        raise ValueError(f"{name}: found {value}, expected {expected}")


def expect_probability(name: str, value: float) -> None:
    """Raise ValueError unless a value is a probability."""
    expect(name, value, 0.0 <= value <= 1.0, "0 to 1")


def expect_duration(name: str, value: float) -> None:
    """Raise ValueError unless a duration is within 0 to MAX_DELAY_S seconds."""
    expect(name, value, 0.0 <= value <= MAX_DELAY_S, f"0 to {MAX_DELAY_S:.0f} s")
