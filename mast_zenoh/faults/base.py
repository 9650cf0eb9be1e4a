"""Faults on a timeline: of messages, of detections and of processes."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, ClassVar, cast

from mast_zenoh.errors import nearest
from mast_zenoh.links.transit import FLOOD_COPIES, QUEUE_S

#: (scene time in s, action): the action is one of process_steps.ACTIONS.
Event = tuple[float, str]
#: A rule of a link as a plain dict(type=…), without `at` and `until`.
Rule = dict[str, Any]

#: The two directions of an agent's link: to the command centre and from it.
DIRECTIONS = ("up", "down")

#: The way of the agent's own detections, which no message passes between agents and command centre.
SENSOR = "sensor"

LATEST_S = 1e9  #: upper limit of the duration of a run


@dataclass(frozen=True, kw_only=True)
class Fault(ABC):
    """A failure of one or more nodes at a given time.

    at:    s of scene time; the fault begins before the first frame at or after this time
    node, nodes: its targets; give one of the two: names, roles, or "one", "minority", "majority" of the agents
                 (targets.py); an empty list: none

    A subclass overrides `rules` to act on messages or `events` to act on processes.
    Raises ValueError for invalid times and values.
    """

    at: float
    node: str | None = None
    nodes: str | tuple[str, ...] | None = None

    def __post_init__(self) -> None:
        if not 0.0 <= self.at <= LATEST_S:
            raise ValueError(f"at: found {self.at}, expected a time of 0 or more")
        if (self.node is None) == (self.nodes is None):
            raise ValueError("expected `node` or `nodes`: the targets of the fault")

    @property
    def selectors(self) -> Sequence[str]:
        """The targets as configured."""
        if self.node is not None:
            return (self.node,)
        return (self.nodes,) if isinstance(self.nodes, str) else self.nodes or ()

    @property
    @abstractmethod
    def over(self) -> float | None:
        """Scene time, s, at which the fault ends; None: at the end of the run."""

    def ways(self, role: str) -> Sequence[str]:
        """The DIRECTIONS (or SENSOR) that its rules act on, for a target with this role; none: not a target."""
        return DIRECTIONS

    def rules(self, lockstep: bool) -> Sequence[Rule]:
        """Rules for the links of its targets during the fault; empty for process faults."""
        return ()

    def events(self) -> Sequence[Event]:
        """Actions on the processes of its targets, in order."""
        return ()


def check_after(at: float, until: float | None) -> None:
    """Raise ValueError unless `until` is later than `at` or None."""
    if until is not None and not at < until <= LATEST_S:
        raise ValueError(f"until: found {until}, expected more than `at` ({at})")


@dataclass(frozen=True, kw_only=True)
class RuleFault(Fault):
    """A fault that adds a rule to links while it lasts, exact in lock-step, on the wall clock in real time.

    until: s of scene time at which it ends; None: at the end of the run
    """

    until: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        check_after(self.at, self.until)

    @property
    def over(self) -> float | None:
        return self.until

    def rules(self, lockstep: bool) -> Sequence[Rule]:
        return (self.as_rule(),)

    @abstractmethod
    def as_rule(self) -> Rule:
        """The link rule: dict(type=…), see docs/links.md."""


class _OwnParameters:
    """A fault whose own fields are the parameters of its rule; rule_type: of the rule, default: of the fault."""

    rule_type: ClassVar[str] = ""

    def as_rule(self) -> Rule:
        fault = cast("RuleFault", self)
        common = {field.name for field in fields(LinkFault)}
        own = {field.name: getattr(fault, field.name) for field in fields(fault) if field.name not in common}
        return {"type": self.rule_type or type(self).__name__, **own}


@dataclass(frozen=True, kw_only=True)
class LinkFault(RuleFault):
    """A fault of links between agents and command centre, or between peers.

    direction: "up" (what the agent, or its peer, sends), "down" (what it receives) or "both"

    Targets may also be keys of wires: agent/infra_1/tracks (published by infra_1; agent/infra_1/broadcast between
    peers), cc/picture (received by all agents).
    """

    direction: str = "both"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.direction not in (*DIRECTIONS, "both"):
            hint = nearest(self.direction, (*DIRECTIONS, "both"))
            raise ValueError(f"direction: found {self.direction!r}{hint}")

    def ways(self, role: str) -> Sequence[str]:
        return DIRECTIONS if self.direction == "both" else (self.direction,)


@dataclass(frozen=True, kw_only=True)
class Partition(_OwnParameters, LinkFault):
    """Cuts off its targets. For the command centre, all agents are cut off."""

    rule_type = "Cut"


@dataclass(frozen=True, kw_only=True)
class Loss(_OwnParameters, LinkFault):
    """Loses each message independently with this probability.

    probability: of losing a message, 0 to 1
    """

    probability: float


@dataclass(frozen=True, kw_only=True)
class BurstLoss(_OwnParameters, LinkFault):
    """Loses messages in bursts (Gilbert-Elliott).

    good_to_bad, bad_to_good: probability of a change from one message to the next, 0 to 1
    loss_good, loss_bad:      probability of losing a message in the good, or in the bad state, 0 to 1
    """

    rule_type = "GilbertElliott"
    good_to_bad: float
    bad_to_good: float
    loss_good: float = 0.0
    loss_bad: float = 1.0


@dataclass(frozen=True, kw_only=True)
class Delay(_OwnParameters, LinkFault):
    """Delays messages by mean_s with standard deviation jitter_s.

    mean_s, jitter_s: mean and standard deviation of the delay
    """

    mean_s: float
    jitter_s: float = 0.0


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
class BandwidthLimit(_OwnParameters, LinkFault):
    """Limits the bandwidth; messages that would wait longer than queue_s are lost.

    bits_per_s: bandwidth;  queue_s: maximum waiting time of a message
    """

    rule_type = "Bandwidth"
    bits_per_s: float
    queue_s: float = QUEUE_S


@dataclass(frozen=True, kw_only=True)
class Corrupt(_OwnParameters, LinkFault):
    """Flips `flips` bits of a message with this probability.

    probability: that a message is corrupted, 0 to 1;  flips: number of flipped bits
    """

    probability: float
    flips: int = 1


@dataclass(frozen=True, kw_only=True)
class Duplicate(_OwnParameters, LinkFault):
    """Repeats a message with this probability, `copies` times.

    probability: that a message is repeated, 0 to 1;  copies: number of additional copies
    """

    probability: float
    copies: int = 1


@dataclass(frozen=True, kw_only=True)
class Flood(_OwnParameters, LinkFault):
    """Repeats every message `copies` times.

    copies: number of additional copies
    """

    copies: int = FLOOD_COPIES


@dataclass(frozen=True, kw_only=True)
class Reorder(_OwnParameters, LinkFault):
    """Delays a message by by_s with this probability, so that others overtake it.

    probability: that a message is delayed, 0 to 1;  by_s: its delay
    """

    probability: float
    by_s: float = 0.1


@dataclass(frozen=True, kw_only=True)
class Impair(LinkFault):
    """Applies any link rule, built-in or user-defined: rule=dict(type="PoseError", …).

    rule: dict(type="PoseError", …), see `mast list links`
    """

    rule: dict[str, Any]

    def as_rule(self) -> Rule:
        return dict(self.rule)


@dataclass(frozen=True, kw_only=True)
class SensorFault(RuleFault):
    """A fault of the detections of agents.

    An agent stands for its first sensor. The agent's claimed view is unchanged. Targets may also be keys of wires:
    agent/infra_1/detections, agent/infra_1/detections/radar.
    """

    def ways(self, role: str) -> Sequence[str]:
        return (SENSOR,) if role == "agent" else ()


@dataclass(frozen=True, kw_only=True)
class BlindSector(_OwnParameters, SensorFault):
    """Loses all detections in a sector, which the agent still claims to see.

    azimuth_min_deg: deg, at which the sector begins, in the sensor's frame
    azimuth_max_deg: deg, at which it ends, counter-clockwise from there
    """

    azimuth_min_deg: float
    azimuth_max_deg: float


@dataclass(frozen=True, kw_only=True)
class GhostDetections(_OwnParameters, SensorFault):
    """Detects objects that are not there, again and again at the same places.

    places: m, (x, y, z) of each: x ahead and y left of the sensor, or in the world; z is always that in the world
    frame:  "sensor": the ghosts move with the sensor; "world": they stay
    probability: that a ghost is detected in a frame
    size:    m, length, width and height
    yaw_rad: rad, heading: less the sensor's, or in the world
    kind:    class
    """

    places: tuple[tuple[float, float, float], ...]
    frame: str = "world"
    probability: float = 0.9
    size: tuple[float, float, float] = (4.5, 1.8, 1.5)
    yaw_rad: float = 0.0
    kind: str = "car"


@dataclass(frozen=True, kw_only=True)
class ProcessFault(Fault):
    """A fault of the processes of its targets, always after the first frame.

    begins, ends: the actions (process_steps.ACTIONS) at `at` and at its end; a subclass with other actions overrides
    `events`
    """

    begins: ClassVar[str]
    ends: ClassVar[str] = "start"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.at == 0.0:
            raise ValueError(
                "at: found 0.0, expected a time after the first frame; use Join for nodes that start later"
            )

    def events(self) -> Sequence[Event]:
        first = (self.at, self.begins)
        return [first] if self.over is None else [first, (self.over, self.ends)]


@dataclass(frozen=True, kw_only=True)
class _Absence(ProcessFault):
    """A fault after which its targets may come back."""

    @property
    @abstractmethod
    def absence(self) -> tuple[str, float | None]:
        """Name and value of the parameter: s until they are started again; None: never."""

    def __post_init__(self) -> None:
        super().__post_init__()
        name, seconds = self.absence
        if seconds is not None and not 0.0 < seconds <= LATEST_S:
            raise ValueError(f"{name}: found {seconds}, expected more than 0")

    @property
    def over(self) -> float | None:
        seconds = self.absence[1]
        return None if seconds is None else self.at + seconds


@dataclass(frozen=True, kw_only=True)
class Kill(_Absence):
    """Kills its targets, which report no results.

    restart_after: s until they are restarted; None: never.
    """

    begins = "kill"
    restart_after: float | None = None

    @property
    def absence(self) -> tuple[str, float | None]:
        return "restart_after", self.restart_after


@dataclass(frozen=True, kw_only=True)
class Leave(_Absence):
    """Stops its targets as at the end of a run.

    return_after: s until they return; None: never.
    """

    begins = "leave"
    return_after: float | None = None

    @property
    def absence(self) -> tuple[str, float | None]:
        return "return_after", self.return_after


@dataclass(frozen=True, kw_only=True)
class Restart(_Absence):
    """Stops its targets properly and restarts them.

    down_s: s in between, at least a frame.
    """

    begins = "leave"
    down_s: float = 0.5

    @property
    def absence(self) -> tuple[str, float | None]:
        return "down_s", self.down_s


@dataclass(frozen=True, kw_only=True)
class Join(ProcessFault):
    """Starts its targets at this time instead of at the beginning."""

    @property
    def over(self) -> float | None:
        return self.at

    def events(self) -> Sequence[Event]:
        return [(self.at, "start")]


@dataclass(frozen=True, kw_only=True)
class Pause(ProcessFault):
    """Suspends its targets; then they process all messages that have arrived.

    until: s of scene time at which they resume

    In real time their processes are stopped and continued. In lock-step all nodes would wait for them; there links hold
    their messages in both directions and then deliver them in order.
    """

    begins, ends = "pause", "resume"
    until: float

    def __post_init__(self) -> None:
        super().__post_init__()
        check_after(self.at, self.until)

    @property
    def over(self) -> float | None:
        return self.until

    def rules(self, lockstep: bool) -> Sequence[Rule]:
        return ({"type": "Hold"},) if lockstep else ()


@dataclass(frozen=True, kw_only=True)
class Unplug(Pause):
    """Disconnects its targets from their networks; then they reconnect by themselves.

    until: s of scene time at which they are connected again

    Only in real time, and only if nodes have their own networks: in the containers of engine compose. Elsewhere, use
    Partition.
    """

    begins, ends = "disconnect", "connect"

    def rules(self, lockstep: bool) -> Sequence[Rule]:
        return ()
