"""What the launcher's protocol asks for: carried out on the mesh, or by the simulated one."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any

from mast_zenoh.config.resolved import Resolved

DRIVER_TIMEOUT_S = 60.0  #: for the driver to answer `rewire`

#: A query that waits for an answer: of Zenoh, or of the simulated mesh.
Query = Any


class LauncherActions(ABC):
    """The actions of the launcher."""

    @abstractmethod
    def stop(self, reason: str) -> None:
        """Ask all nodes to finish."""

    @abstractmethod
    def leave(self, node: str, reason: str) -> None:
        """Ask a node to finish."""

    @abstractmethod
    def rewire(self, payload: bytes, answered: Callable[[bytes | None], None]) -> None:
        """Ask the driver for a change of the wiring.

        answered: called once with its answer; None: it has not answered in time
        """

    @abstractmethod
    def answer(self, query: Query, payload: bytes) -> None:
        """Answer a query."""

    @abstractmethod
    def refuse(self, query: Query, error: Exception) -> None:
        """Answer a query with an error, and count it if the request was invalid."""

    @abstractmethod
    def adopt(self, resolved: Resolved, joining: tuple[str, Resolved] | None) -> None:
        """Have nodes that start from now on begin with this scenario.

        joining: a node that is started to be inserted, and the scenario with which it begins
        """

    @abstractmethod
    def record(self, change: dict[str, Any]) -> None:
        """Record a change of the wiring in run.json."""

    @abstractmethod
    def last_log_line(self, node: str) -> str:
        """The last line of a node's log, "" if there is none."""
