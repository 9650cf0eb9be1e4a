"""Base class of faults: a time, targets, and effects on links or processes."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

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
                 (targets.py)

    A subclass overrides `rules` to act on messages or `events` to act on processes.
    Raises ValueError for invalid times and values.
    """

    at: float
    node: str | None = None
    nodes: str | tuple[str, ...] | None = None

    def __post_init__(self) -> None:
        if not 0.0 <= self.at <= LATEST_S:
            raise ValueError(f"at: found {self.at}, expected a time of 0 or more")
        if (self.node is None) == (self.nodes is None) or self.nodes == ():
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
