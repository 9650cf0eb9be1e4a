"""What the launcher knows of a run on a mesh, and the request to stop it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from mast_zenoh.config.resolved import Resolved
from mast_zenoh.errors import RunError


class Stop:
    """Request to stop a run, with its time, reason and error.

    now_s:   a monotonic clock, s
    since:   time of the request, s; None: not requested
    problem: the first error; the run ends with it
    """

    def __init__(self, now_s: Callable[[], float]) -> None:
        self.since: float | None = None
        self.reason = "end"
        self.problem: RunError | None = None
        self._now_s = now_s

    @property
    def requested(self) -> bool:
        """Whether all nodes are asked to finish."""
        return self.since is not None

    def request(self, reason: str = "end") -> None:
        """Ask all nodes to finish from now on; only the first request counts."""
        if self.since is None:
            self.since, self.reason = self._now_s(), reason

    def note(self, problem: RunError) -> None:
        """Note the error with which the run will end; only the first counts."""
        self.problem = self.problem or problem

    def fail(self, problem: RunError, reason: str) -> None:
        """Note an error, and ask all nodes to finish."""
        self.note(problem)
        self.request(reason)


@dataclass
class RunState:
    """State of one run on a mesh.

    resolved: the current scenario; an interception replaces it
    show:     prints a permanent line, with Rich markup
    now_s:    a monotonic clock, s
    signals:  stop signals received so far
    frame:    the newest frame that has begun; -1 before the first
    joining:  a node that is started to be inserted, and the scenario with which it begins
    stop:     the request to stop, and the error
    restarted: nodes that died, and that the launcher has restarted
    losses:   of results that the driver does not see, as in run.json
    """

    resolved: Resolved
    show: Callable[[str], None]
    now_s: Callable[[], float]
    signals: list[int] = field(default_factory=list)
    frame: int = field(default=-1, init=False)
    joining: tuple[str, Resolved] | None = field(default=None, init=False)
    stop: Stop = field(init=False)
    restarted: set[str] = field(default_factory=set, init=False)
    losses: list[dict[str, Any]] = field(default_factory=list, init=False)

    def __post_init__(self) -> None:
        self.stop = Stop(self.now_s)

    def resolved_for(self, node: str) -> Resolved:
        """The scenario with which a node begins that is started now."""
        return self.joining[1] if self.joining is not None and self.joining[0] == node else self.resolved
