"""The launcher as a service of a compose file, which starts the containers of the nodes.

The nodes ask the launcher for their files, and begin when they get them. With `mast-node --again` a node that the
scenario has killed asks again. So the launcher needs no access to the container engine: it knows from the mesh which
nodes are up. Nodes and router leave when the launcher has gone, so none ends before it.
"""

from __future__ import annotations

import fcntl
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import zenoh

from mast_zenoh.config.resolved import Resolved
from mast_zenoh.control import control_prefix
from mast_zenoh.control.signatures import Signatures
from mast_zenoh.deploy.compose import document
from mast_zenoh.deploy.compose.certificates import LOCK
from mast_zenoh.deploy.compose.engine import Compose
from mast_zenoh.deploy.compose.started_nodes import StartedNodes
from mast_zenoh.deploy.joining import join
from mast_zenoh.errors import BackendError
from mast_zenoh.launch.context import Mesh, RunContext
from mast_zenoh.runtime.mesh import hosting
from mast_zenoh.security.credentials import Credentials

#: How long nodes and router stay after the launcher has gone, s; its container has ended by then.
PATIENCE_S = 3.0

#: Process steps that nodes carry out themselves.
_ACTIONS = ("kill", "leave", "start")

_ROUTER_S = 60.0  # for the router to come up


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
        run, logs = self._run, context.folder / "logs"
        context.record["endpoint"] = self._endpoint
        context.record["deployment"] = {"engine": self.name, "label": f"{document.LABEL}={run}"}
        keys = None if self._credentials is None else hosting.control_keys(self._credentials)
        signatures = Signatures(run, keys)

        def tell(node: str, word: bytes) -> None:
            what = f"leave/{node}"
            self._session.put(f"{control_prefix(run)}/{what}", signatures.sign(what, word))

        nodes = StartedNodes(self._session, run, tell, lambda name: document.container(run, name), logs)
        return Mesh(self._session, stack.enter_context(nodes), control=keys)


@contextmanager
def joined(endpoint: str, run: str, folder: Path | None) -> Iterator[zenoh.Session]:
    """The launcher's session, with which it is present until it has concluded the run.

    Raises as `joining.join`.
    """
    with ExitStack() as stack:
        if folder is not None:
            lock = stack.enter_context((folder / LOCK).open("rb"))
            fcntl.flock(lock, fcntl.LOCK_EX)
        session = join(endpoint, Credentials.read(folder) if folder else None, _ROUTER_S)
        stack.enter_context(session)
        stack.callback(session.liveliness().declare_token(f"{control_prefix(run)}/launcher").undeclare)
        yield session


def check_steps(resolved: Resolved) -> None:
    """Raise BackendError for process steps that need access to the container engine."""
    for step in resolved.steps:
        if step.action not in _ACTIONS:
            raise BackendError(
                f"{step.action} of {step.node!r} (before frame {step.frame}): a launcher inside a compose file has no "
                f"access to Docker, expected only {', '.join(_ACTIONS)}: play it with mast deploy up --engine compose"
            )
