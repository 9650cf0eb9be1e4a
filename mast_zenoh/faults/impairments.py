"""Faults of messages: temporary rules of links between agents and command centre."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from mast_zenoh.errors import nearest
from mast_zenoh.faults.base import DIRECTIONS, Fault, Rule, check_after
from mast_zenoh.links.copies import FLOOD_COPIES
from mast_zenoh.links.timing import QUEUE_S


@dataclass(frozen=True, kw_only=True)
class LinkFault(Fault):
    """A fault of links, exact in lock-step, on the wall clock in real time.

    until:     s of scene time at which it ends; None: at the end of the run
    direction: "up" (to the command centre), "down" (from it) or "both"

    Targets may also be keys of wires: agent/infra_1/tracks (published by infra_1), cc/picture (received by all agents).
    """

    until: float | None = None
    direction: str = "both"

    def __post_init__(self) -> None:
        super().__post_init__()
        check_after(self.at, self.until)
        if self.direction not in (*DIRECTIONS, "both"):
            hint = nearest(self.direction, (*DIRECTIONS, "both"))
            raise ValueError(f"direction: found {self.direction!r}{hint}")

    @property
    def over(self) -> float | None:
        return self.until

    def ways(self, role: str) -> Sequence[str]:
        return DIRECTIONS if self.direction == "both" else (self.direction,)

    def rules(self, lockstep: bool) -> Sequence[Rule]:
        return (self.as_rule(),)

    @abstractmethod
    def as_rule(self) -> Rule:
        """The link rule: dict(type=…), see docs/links.md."""


@dataclass(frozen=True, kw_only=True)
class Partition(LinkFault):
    """Cuts off its targets. For the command centre, all agents are cut off."""

    def as_rule(self) -> Rule:
        return {"type": "Cut"}


@dataclass(frozen=True, kw_only=True)
class Loss(LinkFault):
    """Loses each message independently with this probability.

    probability: of losing a message, 0 to 1
    """

    probability: float

    def as_rule(self) -> Rule:
        return {"type": "Loss", "probability": self.probability}


@dataclass(frozen=True, kw_only=True)
class BurstLoss(LinkFault):
    """Loses messages in bursts (Gilbert-Elliott).

    good_to_bad, bad_to_good: probability of a change from one message to the next, 0 to 1
    loss_good, loss_bad:      probability of losing a message in the good, or in the bad state, 0 to 1
    """

    good_to_bad: float
    bad_to_good: float
    loss_good: float = 0.0
    loss_bad: float = 1.0

    def as_rule(self) -> Rule:
        names = ("good_to_bad", "bad_to_good", "loss_good", "loss_bad")
        return {"type": "GilbertElliott", **{name: getattr(self, name) for name in names}}


@dataclass(frozen=True, kw_only=True)
class Delay(LinkFault):
    """Delays messages by mean_s with standard deviation jitter_s.

    mean_s, jitter_s: mean and standard deviation of the delay
    """

    mean_s: float
    jitter_s: float = 0.0

    def as_rule(self) -> Rule:
        return {"type": "Delay", "mean_s": self.mean_s, "jitter_s": self.jitter_s}


@dataclass(frozen=True, kw_only=True)
class SlowNode(LinkFault):
    """Delays the messages that a node publishes, but not the messages that it receives.

    delay_s: delay of each message

    For the broker and the command centre, this is the picture.
    """

    delay_s: float

    def ways(self, role: str) -> Sequence[str]:
        return ("up",) if role == "agent" else ("down",)

    def as_rule(self) -> Rule:
        return {"type": "Delay", "mean_s": self.delay_s}


@dataclass(frozen=True, kw_only=True)
class BandwidthLimit(LinkFault):
    """Limits the bandwidth; messages that would wait longer than queue_s are lost.

    bits_per_s: bandwidth;  queue_s: maximum waiting time of a message
    """

    bits_per_s: float
    queue_s: float = QUEUE_S

    def as_rule(self) -> Rule:
        return {"type": "Bandwidth", "bits_per_s": self.bits_per_s, "queue_s": self.queue_s}


@dataclass(frozen=True, kw_only=True)
class Corrupt(LinkFault):
    """Flips `flips` bits of a message with this probability.

    probability: that a message is corrupted, 0 to 1;  flips: number of flipped bits
    """

    probability: float
    flips: int = 1

    def as_rule(self) -> Rule:
        return {"type": "Corrupt", "probability": self.probability, "flips": self.flips}


@dataclass(frozen=True, kw_only=True)
class Duplicate(LinkFault):
    """Repeats a message with this probability, `copies` times.

    probability: that a message is repeated, 0 to 1;  copies: number of additional copies
    """

    probability: float
    copies: int = 1

    def as_rule(self) -> Rule:
        return {"type": "Duplicate", "probability": self.probability, "copies": self.copies}


@dataclass(frozen=True, kw_only=True)
class Flood(LinkFault):
    """Repeats every message `copies` times.

    copies: number of additional copies
    """

    copies: int = FLOOD_COPIES

    def as_rule(self) -> Rule:
        return {"type": "Flood", "copies": self.copies}


@dataclass(frozen=True, kw_only=True)
class Reorder(LinkFault):
    """Delays a message by by_s with this probability, so that others overtake it.

    probability: that a message is delayed, 0 to 1;  by_s: its delay
    """

    probability: float
    by_s: float = 0.1

    def as_rule(self) -> Rule:
        return {"type": "Reorder", "probability": self.probability, "by_s": self.by_s}


@dataclass(frozen=True, kw_only=True)
class Impair(LinkFault):
    """Applies any link rule, built-in or user-defined: rule=dict(type="PoseError", …).

    rule: dict(type="PoseError", …), see `mast list links`
    """

    rule: dict[str, Any]

    def as_rule(self) -> Rule:
        return dict(self.rule)
