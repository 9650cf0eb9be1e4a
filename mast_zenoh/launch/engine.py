"""Where the nodes of a run live, if not on this machine as processes of the launcher. mast_zenoh.deploy has engines."""

from __future__ import annotations

from abc import ABC, abstractmethod
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import zenoh

from mast_zenoh.config.resolved import Resolved
from mast_zenoh.launch.supervisor import Supervisor

if TYPE_CHECKING:
    from mast_zenoh.launch.mesh_run import Launch


class Engine(ABC):
    """What brings a mesh and its nodes into being somewhere, and takes all of it away again.

    name: as `--engine` has it; unplugs: whether nodes can be taken off their networks
    """

    name: ClassVar[str]
    unplugs: ClassVar[bool] = False

    @abstractmethod
    def check(self, resolved: Resolved, secure: str) -> None:
        """Raise EngineError for what makes the run impossible. Called before anything is started or written."""

    @abstractmethod
    def join(self, launch: Launch, stack: ExitStack) -> tuple[zenoh.Session, Supervisor[Any]]:
        """Bring up the router and make ready the nodes; the launcher's session, and who starts the nodes.

        Whatever is made is taken away by callbacks on the stack, however the run ends. Signals are only noted in
        launch.signals meanwhile, so whoever waits looks there. launch.record["endpoint"] and ["deployment"] are set,
        the latter to {"engine": name, …}: all that `status`, `logs` and `down` need.

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
