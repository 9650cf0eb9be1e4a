"""Faults that act on messages: rules of the links between agents and command centre, for a time."""

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
    """A fault that the links of its targets carry out, exactly in lock-step, on the wall clock in real time.

    until:     s of scene time at which it is healed; None: it lasts to the end
    direction: "up" (to the command centre), "down" (from it) or "both"

    Targets may also be keys of wires: agent/infra_1/tracks (what infra_1 says), cc/picture (what all agents hear).
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
        """See Fault."""
        return self.until

    def ways(self, role: str) -> Sequence[str]:
        """See Fault."""
        return DIRECTIONS if self.direction == "both" else (self.direction,)

    def rules(self, lockstep: bool) -> Sequence[Rule]:
        """See Fault."""
        return (self.as_rule(),)

    @abstractmethod
    def as_rule(self) -> Rule:
        """The rule of the link: dict(type=…), see docs/links.md."""


@dataclass(frozen=True, kw_only=True)
class Partition(LinkFault):
    """Its targets are cut off: nothing gets through. Of the command centre: every agent is."""

    def as_rule(self) -> Rule:
        """See LinkFault."""
        return {"type": "Cut"}


@dataclass(frozen=True, kw_only=True)
class Loss(LinkFault):
    """Each message is lost with this probability, whatever became of the one before.

    probability: of losing a message, 0 to 1
    """

    probability: float

    def as_rule(self) -> Rule:
        """See LinkFault."""
        return {"type": "Loss", "probability": self.probability}


@dataclass(frozen=True, kw_only=True)
class BurstLoss(LinkFault):
    """Messages are lost in bursts (Gilbert-Elliott): the channel is good or bad, and changes between two messages.

    good_to_bad, bad_to_good: probability of a change from one message to the next, 0 to 1
    loss_good, loss_bad:      probability of losing a message in the good, or in the bad state, 0 to 1
    """

    good_to_bad: float
    bad_to_good: float
    loss_good: float = 0.0
    loss_bad: float = 1.0

    def as_rule(self) -> Rule:
        """See LinkFault."""
        names = ("good_to_bad", "bad_to_good", "loss_good", "loss_bad")
        return {"type": "GilbertElliott", **{name: getattr(self, name) for name in names}}


@dataclass(frozen=True, kw_only=True)
class Delay(LinkFault):
    """Messages arrive late.

    mean_s, jitter_s: mean and standard deviation of the delay
    """

    mean_s: float
    jitter_s: float = 0.0

    def as_rule(self) -> Rule:
        """See LinkFault."""
        return {"type": "Delay", "mean_s": self.mean_s, "jitter_s": self.jitter_s}


@dataclass(frozen=True, kw_only=True)
class SlowNode(LinkFault):
    """A node takes longer than it should: what it says comes late, what it hears does not.

    delay_s: how much longer

    What a slow broker or command centre says is the picture.
    """

    delay_s: float

    def ways(self, role: str) -> Sequence[str]:
        """See Fault."""
        return ("up",) if role == "agent" else ("down",)

    def as_rule(self) -> Rule:
        """See LinkFault."""
        return {"type": "Delay", "mean_s": self.delay_s}


@dataclass(frozen=True, kw_only=True)
class BandwidthLimit(LinkFault):
    """A link carries no more than this.

    bits_per_s: that it carries;  queue_s: how long a message may wait for its turn before it is lost
    """

    bits_per_s: float
    queue_s: float = QUEUE_S

    def as_rule(self) -> Rule:
        """See LinkFault."""
        return {"type": "Bandwidth", "bits_per_s": self.bits_per_s, "queue_s": self.queue_s}


@dataclass(frozen=True, kw_only=True)
class Corrupt(LinkFault):
    """In a message, with this probability, some bits come out wrong.

    probability: that a message is corrupted, 0 to 1;  flips: bits that are flipped in it
    """

    probability: float
    flips: int = 1

    def as_rule(self) -> Rule:
        """See LinkFault."""
        return {"type": "Corrupt", "probability": self.probability, "flips": self.flips}


@dataclass(frozen=True, kw_only=True)
class Duplicate(LinkFault):
    """Some messages arrive more than once.

    probability: that a message is repeated, 0 to 1;  copies: how many more of it arrive
    """

    probability: float
    copies: int = 1

    def as_rule(self) -> Rule:
        """See LinkFault."""
        return {"type": "Duplicate", "probability": self.probability, "copies": self.copies}


@dataclass(frozen=True, kw_only=True)
class Flood(LinkFault):
    """Every message arrives many times.

    copies: how many more of each arrive
    """

    copies: int = FLOOD_COPIES

    def as_rule(self) -> Rule:
        """See LinkFault."""
        return {"type": "Flood", "copies": self.copies}


@dataclass(frozen=True, kw_only=True)
class Reorder(LinkFault):
    """Some messages are held up, so that others overtake them.

    probability: that a message is held up, 0 to 1;  by_s: for how long
    """

    probability: float
    by_s: float = 0.1

    def as_rule(self) -> Rule:
        """See LinkFault."""
        return {"type": "Reorder", "probability": self.probability, "by_s": self.by_s}


@dataclass(frozen=True, kw_only=True)
class Impair(LinkFault):
    """Any rule of a link, for a time: one of ours or your own.

    rule: dict(type="PoseError", …), see `mast list links`
    """

    rule: dict[str, Any]

    def as_rule(self) -> Rule:
        """See LinkFault."""
        return dict(self.rule)
