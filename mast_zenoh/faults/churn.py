"""Faults that act on processes: nodes die, leave, join, stand still, are cut off and come back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from mast_zenoh.faults.base import LATEST_S, Event, Fault, Rule, check_after


@dataclass(frozen=True, kw_only=True)
class ProcessFault(Fault):
    """A fault that happens to the processes of its targets; never before the first frame.

    begins, ends: what is done to them at `at`, and when it is over (steps.ACTIONS); who does other things overrides
    `events`
    """

    begins: ClassVar[str]
    ends: ClassVar[str] = "start"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.at == 0.0:
            raise ValueError("at: found 0.0, expected a time after the first frame; who is to come later has a Join")

    def events(self) -> Sequence[Event]:
        """See Fault."""
        begin = (self.at, self.begins)
        return [begin] if self.over is None else [begin, (self.over, self.ends)]


def _wait(name: str, value: float | None) -> None:
    if value is not None and not 0.0 < value <= LATEST_S:
        raise ValueError(f"{name}: found {value}, expected more than 0")


@dataclass(frozen=True, kw_only=True)
class Kill(ProcessFault):
    """Its targets die at once and hand in nothing. restart_after: s until they are started again; None: never."""

    begins = "kill"
    restart_after: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        _wait("restart_after", self.restart_after)

    @property
    def over(self) -> float | None:
        """See Fault."""
        return None if self.restart_after is None else self.at + self.restart_after


@dataclass(frozen=True, kw_only=True)
class Leave(ProcessFault):
    """Its targets finish as at the end of a run. return_after: s until they come again; None: never."""

    begins = "leave"
    return_after: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        _wait("return_after", self.return_after)

    @property
    def over(self) -> float | None:
        """See Fault."""
        return None if self.return_after is None else self.at + self.return_after


@dataclass(frozen=True, kw_only=True)
class Restart(ProcessFault):
    """Its targets are ended in good order and started again. down_s: s in between, at least a frame."""

    begins = "leave"
    down_s: float = 0.5

    def __post_init__(self) -> None:
        super().__post_init__()
        _wait("down_s", self.down_s)

    @property
    def over(self) -> float | None:
        """See Fault."""
        return self.at + self.down_s


@dataclass(frozen=True, kw_only=True)
class Join(ProcessFault):
    """Its targets are not there from the beginning: they come at this time."""

    @property
    def over(self) -> float | None:
        """See Fault."""
        return self.at

    def events(self) -> Sequence[Event]:
        """See Fault."""
        return [(self.at, "start")]


@dataclass(frozen=True, kw_only=True)
class Pause(ProcessFault):
    """Its targets stand still until `until`, and then go on with all that has come for them.

    until: s of scene time at which they go on

    In real time their processes are stopped and continued. In lock-step everyone would wait for them; there a pause is
    what others see of it: links hold back what they say and hear, and then let it go in order.
    """

    begins, ends = "pause", "resume"
    until: float

    def __post_init__(self) -> None:
        super().__post_init__()
        check_after(self.at, self.until)

    @property
    def over(self) -> float | None:
        """See Fault."""
        return self.until

    def rules(self, lockstep: bool) -> Sequence[Rule]:
        """See Fault."""
        return ({"type": "Hold"},) if lockstep else ()


@dataclass(frozen=True, kw_only=True)
class Unplug(ProcessFault):
    """Its targets are taken off their networks until `until`, and go on alone; then they find back by themselves.

    until: s of scene time at which they are put back

    In real time only, and only where nodes have networks of their own: in the containers of engine compose. Anywhere
    else a Partition does it.
    """

    begins, ends = "disconnect", "connect"
    until: float

    def __post_init__(self) -> None:
        super().__post_init__()
        check_after(self.at, self.until)

    @property
    def over(self) -> float | None:
        """See Fault."""
        return self.until
