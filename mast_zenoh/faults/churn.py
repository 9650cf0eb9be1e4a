"""Faults of processes: kill, leave, restart, join, pause and unplug."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from mast_zenoh.faults.base import LATEST_S, Event, Fault, Rule, check_after


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


def _check_wait(name: str, value: float | None) -> None:
    if value is not None and not 0.0 < value <= LATEST_S:
        raise ValueError(f"{name}: found {value}, expected more than 0")


@dataclass(frozen=True, kw_only=True)
class Kill(ProcessFault):
    """Kills its targets, which report no results.

    restart_after: s until they are restarted; None: never.
    """

    begins = "kill"
    restart_after: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_wait("restart_after", self.restart_after)

    @property
    def over(self) -> float | None:
        return None if self.restart_after is None else self.at + self.restart_after


@dataclass(frozen=True, kw_only=True)
class Leave(ProcessFault):
    """Stops its targets as at the end of a run.

    return_after: s until they return; None: never.
    """

    begins = "leave"
    return_after: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_wait("return_after", self.return_after)

    @property
    def over(self) -> float | None:
        return None if self.return_after is None else self.at + self.return_after


@dataclass(frozen=True, kw_only=True)
class Restart(ProcessFault):
    """Stops its targets properly and restarts them.

    down_s: s in between, at least a frame.
    """

    begins = "leave"
    down_s: float = 0.5

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_wait("down_s", self.down_s)

    @property
    def over(self) -> float | None:
        return self.at + self.down_s


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
class Unplug(ProcessFault):
    """Disconnects its targets from their networks; then they reconnect by themselves.

    until: s of scene time at which they are connected again

    Only in real time, and only if nodes have their own networks: in the containers of engine compose. Elsewhere, use
    Partition.
    """

    begins, ends = "disconnect", "connect"
    until: float

    def __post_init__(self) -> None:
        super().__post_init__()
        check_after(self.at, self.until)

    @property
    def over(self) -> float | None:
        return self.until
