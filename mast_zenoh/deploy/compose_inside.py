"""A compose file that plays a run by itself: its launcher, the nodes beside it, and the maker of their certificates.

Compose starts the containers. The nodes ask the launcher for their files, and begin when they get them. With
`mast-node --again` a node that the scenario has killed asks again. So the launcher needs no access to the container
engine: it knows from the mesh which nodes are up. Nodes and router leave when the launcher has gone, so none ends
before it.
"""

from __future__ import annotations

import fcntl
import tempfile
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import IO, Any

import zenoh

from mast_zenoh.config.resolved import NodeSpec, Resolved
from mast_zenoh.deploy import documents
from mast_zenoh.deploy.compose import Compose
from mast_zenoh.deploy.engine import join, write_settings
from mast_zenoh.errors import BackendError, EngineError
from mast_zenoh.launch.context import Mesh, RunContext, deployment_of
from mast_zenoh.launch.supervisor import Child, Supervisor
from mast_zenoh.mesh import hosting
from mast_zenoh.mesh.control import control_prefix, flow, prefix
from mast_zenoh.mesh.control.codec import Signatures
from mast_zenoh.mesh.control.key_marks import control_mark
from mast_zenoh.mesh.hosting import UP
from mast_zenoh.mesh.security.credentials import Credentials
from mast_zenoh.mesh.session import direct

#: How long nodes and router stay after the launcher has gone, s; its container has ended by then.
PATIENCE_S = 3.0

_ACTIONS = ("kill", "leave", "start")  # process steps that nodes carry out themselves
_LOCK = "lock"  # next to the launcher's credentials: locked as long as its process lives
_LAUNCHER_S = 600.0  # for the launcher to come
_ROUTER_S = 60.0  # for the router to come up
_UP_S = 120.0  # for a node to come up
_KILL_S = 30.0  # for a killed node to leave the mesh


def check_steps(resolved: Resolved) -> None:
    """Raise BackendError for process steps that need access to the container engine."""
    for step in resolved.steps:
        if step.action not in _ACTIONS:
            raise BackendError(
                f"{step.action} of {step.node!r} (before frame {step.frame}): a launcher inside a compose file has no "
                f"access to Docker, expected only {', '.join(_ACTIONS)}: play it with mast deploy up --engine compose"
            )


# -- certificates ------------------------------------------------------------------------------------------------


def make_credentials(resolved: Resolved, run: str, secure: str, folder: Path) -> None:
    """Write the credentials of all services below a folder, and wait until the launcher has ended.

    folder: has a folder for each service, a file system in memory that lasts as long as a container uses it
    """
    with tempfile.TemporaryDirectory() as made:
        deployment = deployment_of(resolved, run, secure, hosts=[documents.ROUTER], folder=Path(made))
        assert deployment.launcher is not None
        assert deployment.control is not None
        for name in resolved.nodes:
            Credentials.read(Path(made) / name).write(folder / name)
    write_settings(folder / documents.ROUTER, deployment.router)
    own = folder / documents.LAUNCHER
    replace(deployment.launcher, control=deployment.control.to_json()).write(own)
    with (own / _LOCK).open("wb") as lock:
        (Path(tempfile.gettempdir()) / UP).touch()  # healthy: the others may start
        deadline = time.monotonic() + _LAUNCHER_S
        while _is_free(lock):
            if time.monotonic() > deadline:
                raise EngineError(f"the launcher has not come within {_LAUNCHER_S:.0f} s")
            threading.Event().wait(0.1)
        fcntl.flock(lock, fcntl.LOCK_EX)


def _is_free(lock: IO[bytes]) -> bool:
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    fcntl.flock(lock, fcntl.LOCK_UN)
    return True


# -- the launcher ------------------------------------------------------------------------------------------------


@contextmanager
def joined(endpoint: str, run: str, folder: Path | None) -> Iterator[zenoh.Session]:
    """The launcher's session, with which it is present until it has concluded the run.

    Raises as `engine.join`.
    """
    with ExitStack() as stack:
        if folder is not None:
            lock = stack.enter_context((folder / _LOCK).open("rb"))
            fcntl.flock(lock, fcntl.LOCK_EX)
        session = join(endpoint, Credentials.read(folder) if folder else None, _ROUTER_S)
        stack.enter_context(session)
        stack.callback(session.liveliness().declare_token(f"{control_prefix(run)}/launcher").undeclare)
        yield session


class Inside(Compose):
    """The containers of the compose file in which this launcher is a service.

    session: on the run's mesh, open until the process ends: nodes stay as long
    folder:  of the launcher's credentials; None: an open mesh
    """

    unplugs = False

    def __init__(self, run: str, session: zenoh.Session, endpoint: str, folder: Path | None) -> None:
        super().__init__()
        self.run_id = self._run = run
        self._session = session
        self._endpoint = endpoint
        self._credentials = folder

    def check(self, resolved: Resolved, secure: str) -> None:
        """Nothing: the file was checked when it was written."""

    def join(self, context: RunContext, stack: ExitStack) -> Mesh:
        run = self._run
        context.record["endpoint"] = self._endpoint
        context.record["deployment"] = {"engine": self.name, "label": f"{documents.LABEL}={run}"}
        keys = None if self._credentials is None else hosting.control_keys(self._credentials)
        signatures = Signatures(run, keys)

        def tell(node: str, word: bytes) -> None:
            what = f"leave/{node}"
            key, payload = f"{control_prefix(run)}/{what}", signatures.sign(what, word)
            self._session.put(key, payload, attachment=control_mark(what))

        nodes = StartedNodes(self._session, run, tell, context.folder / "logs")
        return Mesh(self._session, stack.enter_context(nodes), control=keys)


class StartedNode(Child):
    """A node that Compose has started."""

    def __init__(self, name: str, spec: NodeSpec, container: str) -> None:
        super().__init__(name, spec)
        self.container = container
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

    tell: sends a node a word on `@control/leave/NODE`
    logs: folder for the nodes' logs, which stay empty: the containers have them
    """

    def __init__(self, session: zenoh.Session, run: str, tell: Callable[[str, bytes], None], logs: Path) -> None:
        super().__init__()
        self._run = run
        self._tell = tell
        self._logs = logs
        self._changed = threading.Condition()
        alive, handler = f"{prefix(run)}/alive/*", direct(self._note)
        self._subscriber = session.liveliness().declare_subscriber(alive, handler, history=True)

    def __enter__(self) -> StartedNodes:
        return self

    def __exit__(self, *_: object) -> None:
        self._subscriber.undeclare()  # type: ignore[no-untyped-call]

    def is_started(self, name: str) -> bool:
        child = self.children.get(name)
        return child is not None and child.code is None and not child.handed_in

    def start(self, name: str, spec: NodeSpec) -> None:
        (self._logs / f"{name}.log").touch()
        self.children[name] = StartedNode(name, spec, documents.container(self._run, name))

    def _restart(self, child: StartedNode) -> None:
        child.reset()

    def end_now(self, child: StartedNode) -> None:
        self._tell(child.name, flow.KILL.encode())
        with self._changed:
            if not self._changed.wait_for(lambda: not child.up, _KILL_S):
                raise EngineError(f"{child.name} does not leave: see `docker logs {child.container}`")
        child.code = -9

    def _suspend(self, child: StartedNode) -> None:
        raise BackendError(f"{child.name} cannot be paused here")  # refused before the run

    def _resume(self, children: Iterable[StartedNode]) -> None:
        assert not list(children)

    def end(self, grace_s: float) -> None:
        """Nodes leave with the launcher; those that still run are noted."""
        for child in self.running():
            child.notes.append("leaves with the launcher")

    def _note(self, token: zenoh.Sample) -> None:
        """Note that a node comes up or leaves, in Zenoh's thread."""
        child = self.children.get(str(token.key_expr).rpartition("/")[2])
        if child is None:
            return
        with self._changed:
            child.up = token.kind == zenoh.SampleKind.PUT
            child.seen |= child.up
            self._changed.notify_all()
