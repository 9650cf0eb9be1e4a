"""The nodes of a run that Compose has started, as the launcher beside them knows them: from the mesh."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import zenoh

from mast_zenoh.config.resolved import NodeSpec
from mast_zenoh.control import flow, prefix
from mast_zenoh.errors import BackendError, EngineError
from mast_zenoh.launch.supervisor import Child, Supervisor

_UP_S = 120.0  # for a node to come up
_KILL_S = 30.0  # for a killed node to leave the mesh


class StartedNode(Child):
    """A node that Compose has started. changed: notified when it comes up or leaves"""

    def __init__(self, name: str, spec: NodeSpec, container: str, changed: threading.Condition) -> None:
        super().__init__(name, spec)
        self.container = container
        self.changed = changed
        self.reset()

    def reset(self) -> None:
        """Wait for it to come up, from now on."""
        self.since = time.monotonic()
        self.seen = self.up = False
        self.code: int | None = None

    @property
    def exit(self) -> int | None:
        if self.handed_in and not self.up:
            return 0
        if self.code is None and (self.lost or (not self.seen and time.monotonic() - self.since > _UP_S)):
            return 1
        return self.code

    @property
    def lost(self) -> bool:
        """Whether it has left the mesh."""
        return self.seen and not self.up

    @property
    def ended(self) -> str:
        if self.exit != 1:
            return super().ended
        why = "it has left the mesh without results" if self.lost else f"it has not come up within {_UP_S:.0f} s"
        return "; ".join([*self.notes, f"{why}: see `docker logs {self.container}`"])

    def where(self) -> dict[str, Any]:
        return {"container": self.container}


class StartedNodes(Supervisor[StartedNode]):
    """The nodes of a run that Compose has started; a context manager that watches which nodes are on the mesh.

    tell: sends a node a word on `@control/leave/NODE`;  container: gives the name of a node's container
    logs: folder for the nodes' logs, which stay empty: the containers have them
    """

    def __init__(
        self,
        session: zenoh.Session,
        run: str,
        tell: Callable[[str, bytes], None],
        container: Callable[[str], str],
        logs: Path,
    ) -> None:
        super().__init__()
        self._tell = tell
        self._container = container
        self._logs = logs
        self._changed = threading.Condition()
        handler: Any = zenoh.handlers.Callback(self._note, indirect=False)
        self._subscriber = session.liveliness().declare_subscriber(f"{prefix(run)}/alive/*", handler, history=True)

    def __enter__(self) -> StartedNodes:
        return self

    def __exit__(self, *_: object) -> None:
        self._subscriber.undeclare()  # type: ignore[no-untyped-call]

    def is_started(self, name: str) -> bool:
        child = self.children.get(name)
        return child is not None and child.code is None and not child.handed_in

    def start(self, name: str, spec: NodeSpec) -> None:
        (self._logs / f"{name}.log").touch()
        self.children[name] = StartedNode(name, spec, self._container(name), self._changed)

    def _restart(self, child: StartedNode) -> None:
        child.reset()

    def end_now(self, child: StartedNode) -> None:
        self._tell(child.name, flow.KILL.encode())
        if not self._until(lambda: not child.up, _KILL_S):
            raise EngineError(f"{child.name} does not leave: see `docker logs {child.container}`")
        child.code = -9

    def _suspend(self, child: StartedNode) -> None:
        raise BackendError(f"{child.name} cannot be paused here")  # refused before the run

    def _resume(self, children: Iterable[StartedNode]) -> None:
        assert not list(children)

    def dispose(self, child: StartedNode) -> None:
        """Nothing to release."""

    def end(self, grace_s: float) -> None:
        """Nodes leave with the launcher; those that still run are noted."""
        for child in self.running():
            child.notes.append("leaves with the launcher")

    def _until(self, condition: Callable[[], bool], seconds: float) -> bool:
        with self._changed:
            return self._changed.wait_for(condition, seconds)

    def _note(self, token: zenoh.Sample) -> None:
        """Note that a node comes up or leaves, in Zenoh's thread."""
        child = self.children.get(str(token.key_expr).rpartition("/")[2])
        if child is None:
            return
        with self._changed:
            child.up = token.kind == zenoh.SampleKind.PUT
            child.seen |= child.up
            self._changed.notify_all()
