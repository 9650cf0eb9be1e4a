"""The base class of deployment engines, which start nodes elsewhere; mast_zenoh.deploy has ours."""

from __future__ import annotations

import sys
from abc import ABC, abstractmethod
from contextlib import ExitStack
from pathlib import Path
from typing import Any, ClassVar

from mast_zenoh.config.resolved import Resolved
from mast_zenoh.launch.context import Mesh, RunContext


class Engine(ABC):
    """Creates the mesh of a run and its nodes somewhere, and removes all of it again.

    name: as `--engine` has it; without one, the file and the name of the class
    unplugs: whether nodes can be taken off their networks

    Parameters of `__init__` come from the command line: `--option KEY=VALUE`.
    """

    name: ClassVar[str]
    unplugs: ClassVar[bool] = False

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        if "name" not in vars(cls):
            file = getattr(sys.modules.get(cls.__module__), "__file__", None)
            cls.name = f"{Path(file).resolve()}:{cls.__name__}" if file else cls.__name__

    @abstractmethod
    def check(self, resolved: Resolved, secure: str) -> None:
        """Raise EngineError for what makes the run impossible. Called before anything is started or written."""

    @abstractmethod
    def join(self, context: RunContext, stack: ExitStack) -> Mesh:
        """Start the router and prepare the nodes; the launcher's session, the nodes' supervisor and their credentials.

        Callbacks on the stack remove whatever is made, however the run ends. Signals are only noted in
        context.signals meanwhile: check it in every wait. Set context.record["endpoint"] and ["deployment"], the
        latter to {"engine": name, …}: all that `status`, `logs` and `down` need.

        Raises EngineError, Interrupted.
        """

    @classmethod
    @abstractmethod
    def status(cls, folder: Path, record: dict[str, Any]) -> list[dict[str, str]]:
        """What there is of a run, from its folder and run.json alone: node, state, where."""

    @classmethod
    @abstractmethod
    def logs(cls, folder: Path, record: dict[str, Any], node: str | None, *, follow: bool) -> None:
        """What one node or all have said, on standard output."""

    @classmethod
    @abstractmethod
    def down(cls, folder: Path, record: dict[str, Any]) -> None:
        """Take away all that is there of a run, credentials too; nothing happens where nothing is."""
