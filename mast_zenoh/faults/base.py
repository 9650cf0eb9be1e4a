"""What a fault is: a time, a target, and what it comes to for links or for processes."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

#: (time in s, action): an entry of steps.ACTIONS at a time of the scene
Event = tuple[float, str]
#: a rule of a link as a plain dict(type=…), without `at` and `until`
Rule = dict[str, Any]

#: The two ways through an agent's link: to the command centre, and from it.
DIRECTIONS = ("up", "down")

LATEST_S = 1e9  #: no run lasts so long


@dataclass(frozen=True, kw_only=True)
class Fault(ABC):
    """Something goes wrong at a time, for one or for several nodes.

    at:    s of scene time; it begins before the first frame that is not earlier
    node, nodes: whom it hits, one of the two: names, roles, or "one", "minority", "majority" of the agents (targets.py)

    A subclass overrides `rules` or `events`: it acts on messages, or on processes.
    Raises ValueError for times and figures that make no sense.
    """

    at: float
    node: str | None = None
    nodes: str | tuple[str, ...] | None = None

    def __post_init__(self) -> None:
        if not 0.0 <= self.at <= LATEST_S:
            raise ValueError(f"at: found {self.at}, expected a time of 0 or more")
        if (self.node is None) == (self.nodes is None) or self.nodes == ():
            raise ValueError("expected `node` or `nodes`: whom it hits")

    @property
    def aims(self) -> Sequence[str]:
        """What the user wrote as targets."""
        if self.node is not None:
            return (self.node,)
        return (self.nodes,) if isinstance(self.nodes, str) else self.nodes or ()

    @property
    @abstractmethod
    def over(self) -> float | None:
        """s of scene time at which it is healed; None: at the end of the run."""

    def ways(self, role: str) -> Sequence[str]:
        """Which of DIRECTIONS its rules act on, where its target is a node of this role."""
        return DIRECTIONS

    def rules(self, lockstep: bool) -> Sequence[Rule]:
        """What the links of its targets do while it lasts; empty: it acts on processes."""
        return ()

    def events(self) -> Sequence[Event]:
        """What happens to the processes of its targets, in order."""
        return ()


def check_after(at: float, until: float | None) -> None:
    """Raises ValueError unless `until` is later than `at`, or None."""
    if until is not None and not at < until <= LATEST_S:
        raise ValueError(f"until: found {until}, expected more than `at` ({at})")
