"""Faults on a timeline: of messages, of detections and of processes."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass, field, make_dataclass
from inspect import cleandoc
from typing import Any, ClassVar, get_type_hints

from mast_zenoh import links
from mast_zenoh.config import registry
from mast_zenoh.errors import nearest

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

    at: s of scene time; the fault begins before the first frame at or after this time
    on: its targets: names, roles, or "one", "minority", "majority" of the agents; an empty list: none
    node, nodes: other names of `on`; give one of the three

    A subclass overrides `rules` to act on messages or `events` to act on processes.
    Raises ValueError for invalid times and values.
    """

    at: float
    on: str | tuple[str, ...] | None = None
    node: str | None = None
    nodes: str | tuple[str, ...] | None = None

    def __post_init__(self) -> None:
        if not 0.0 <= self.at <= LATEST_S:
            raise ValueError(f"at: found {self.at}, expected a time of 0 or more")
        if [self.on, self.node, self.nodes].count(None) != 2:
            raise ValueError("expected `node` or `nodes` or `on`: the targets of the fault")

    @property
    def target_parameter(self) -> str:
        """The name of the parameter with its targets."""
        return next(name for name in ("on", "node", "nodes") if getattr(self, name) is not None)

    @property
    def selectors(self) -> Sequence[str]:
        """The targets as configured."""
        targets: str | tuple[str, ...] = getattr(self, self.target_parameter)
        return (targets,) if isinstance(targets, str) else targets

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
    """A fault that adds rules to links while it lasts, exact in lock-step, on the wall clock in real time.

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
        rule = self.as_rule()
        return (rule,) if isinstance(rule, Mapping) else rule

    @abstractmethod
    def as_rule(self) -> Rule | Sequence[Rule]:
        """The link rule: dict(type=…), see docs/how-to-scenarios.md#links; or several, in order."""


@dataclass(frozen=True, kw_only=True)
class LinkFault(RuleFault):
    """A fault of links between agents and command centre, or between peers.

    direction: "up" (what the agent, or its peer, sends), "down" (what it receives) or "both"

    Targets may also be keys of wires, or globs: agent/infra_1/tracks, cc/picture, any of a map. The wiring says which
    links, in which direction, carry them.
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
class Impair(LinkFault):
    """Applies rules of links while it lasts, shipped ones or your own.

    rule: dict(type="PoseError", …), see `mast list links`; or a list of them, in order

    Rules for detections (BlindSector, GhostDetections) act on the sensors of their targets, the others on messages.
    """

    rule: tuple[dict[str, Any], ...] | dict[str, Any]

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.rule == ():
            raise ValueError("rule: found an empty list, expected dict(type=…), or a list of them")
        for rule in (self.rule,) if isinstance(self.rule, dict) else self.rule:
            if timed := {"at", "until"} & rule.keys():
                raise ValueError(f"rule: found {min(timed)!r}, expected it beside `rule`: the fault says when it acts")

    def as_rule(self) -> Rule | Sequence[Rule]:
        return self.rule


@dataclass(frozen=True, kw_only=True)
class SensorFault(RuleFault):
    """A fault of the detections of agents.

    An agent stands for its first sensor. The agent's claimed view is unchanged. Targets may also be keys of wires:
    agent/infra_1/detections, agent/infra_1/detections/radar.
    """

    def ways(self, role: str) -> Sequence[str]:
        return (SENSOR,) if role == "agent" else ()


def _named(name: str, rule: type[links.Rule], parameters: str = "", base: Any = LinkFault, **defaults: Any) -> Any:
    """The fault of this name: `Impair` with a rule of one type, whose parameters are its own.

    parameters: of the rule, if the fault has not all of them;  defaults: those that the rule has not
    """
    known, hints = registry.parameters_of(rule), get_type_hints(rule.__init__)
    own = parameters.split() or [parameter for parameter in known if parameter not in ("at", "until")]
    values = {parameter: defaults.get(parameter, known[parameter].default) for parameter in own}

    def as_rule(fault: Any) -> Rule:
        return {"type": rule.__name__, **{parameter: getattr(fault, parameter) for parameter in own}}

    return make_dataclass(
        name,
        [
            (parameter, hints[parameter], field(default=MISSING if value is known[parameter].empty else value))
            for parameter, value in values.items()
        ],
        bases=(base,),
        namespace={
            "__module__": __name__,
            "__doc__": cleandoc(rule.__doc__ or "").partition("\n\n")[0],
            "described_by": (rule,),  # its parameters, in listings
            "as_rule": as_rule,
        },
        frozen=True,
        kw_only=True,
    )


Partition = _named("Partition", links.Cut)
Loss = _named("Loss", links.Loss)
BurstLoss = _named("BurstLoss", links.GilbertElliott)
Delay = _named("Delay", links.Delay, "mean_s jitter_s")
BandwidthLimit = _named("BandwidthLimit", links.Bandwidth)
Corrupt = _named("Corrupt", links.Corrupt)
Duplicate = _named("Duplicate", links.Duplicate)
Flood = _named("Flood", links.Flood)
Reorder = _named("Reorder", links.Reorder, by_s=0.1)
BlindSector = _named("BlindSector", links.BlindSector, base=SensorFault)
GhostDetections = _named(
    "GhostDetections", links.GhostDetections, "places frame probability size yaw_rad kind", SensorFault
)


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
    def absence(self) -> str:
        """Name of the parameter: s until they are started again; None: never."""

    def __post_init__(self) -> None:
        super().__post_init__()
        seconds = getattr(self, self.absence)
        if seconds is not None and not 0.0 < seconds <= LATEST_S:
            raise ValueError(f"{self.absence}: found {seconds}, expected more than 0")

    @property
    def over(self) -> float | None:
        seconds = getattr(self, self.absence)
        return None if seconds is None else self.at + float(seconds)


@dataclass(frozen=True, kw_only=True)
class Kill(_Absence):
    """Kills its targets, which report no results.

    restart_after: s until they are restarted; None: never.
    """

    begins, absence = "kill", "restart_after"
    restart_after: float | None = None


@dataclass(frozen=True, kw_only=True)
class Leave(_Absence):
    """Stops its targets as at the end of a run.

    return_after: s until they return; None: never.
    """

    begins, absence = "leave", "return_after"
    return_after: float | None = None


@dataclass(frozen=True, kw_only=True)
class Restart(_Absence):
    """Stops its targets properly and restarts them.

    down_s: s in between, at least a frame.
    """

    begins, absence = "leave", "down_s"
    down_s: float = 0.5


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
