"""The base class of deployment engines, which start nodes elsewhere.

mast_zenoh.deploy has the engines that come with this package.
"""

from __future__ import annotations

import sys
from abc import ABC, abstractmethod
from contextlib import ExitStack
from pathlib import Path
from typing import Any, ClassVar

from mast_zenoh.config.resolved import Resolved
from mast_zenoh.launch.context import Mesh, RunContext


class Engine(ABC):
    """Creates the mesh and the nodes of a run, and removes them afterwards.

    name: for `--engine`; default: file and name of the class
    unplugs: whether nodes can be disconnected from their networks
    run_id: id of the run, if nodes that wait for it know it already; None: a new one

    Parameters of `__init__` come from the command line: `--option KEY=VALUE`.
    """

    name: ClassVar[str]
    unplugs: ClassVar[bool] = False
    run_id: str | None = None

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        if "name" not in vars(cls):
            file = getattr(sys.modules.get(cls.__module__), "__file__", None)
            cls.name = f"{Path(file).resolve()}:{cls.__name__}" if file else cls.__name__

    @abstractmethod
    def check(self, resolved: Resolved, secure: str) -> None:
        """Raise EngineError if the run is impossible; called before anything is started."""

    @abstractmethod
    def join(self, context: RunContext, stack: ExitStack) -> Mesh:
        """Start the router and prepare the nodes; return session, supervisor, credentials.

        Callbacks on the stack remove everything, however the run ends. Signals are only collected in
        context.signals: check it in every wait. Set context.record["endpoint"] and ["deployment"], the
        latter to {"engine": name, …}: all that `status`, `logs` and `down` need.

        Raises EngineError, Interrupted.
        """

    @classmethod
    @abstractmethod
    def status(cls, folder: Path, record: dict[str, Any]) -> list[dict[str, str]]:
        """State of each node (node, state, where), from run folder and run.json alone."""

    @classmethod
    @abstractmethod
    def logs(cls, folder: Path, record: dict[str, Any], node: str | None, *, follow: bool) -> None:
        """Print the logs of one node or all to standard output."""

    @classmethod
    @abstractmethod
    def down(cls, folder: Path, record: dict[str, Any]) -> None:
        """Remove everything of a run that still exists, including credentials."""
