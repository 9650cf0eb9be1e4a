"""The engine that all deployments share: it starts a run, supervises its nodes, keeps their logs and removes the rest.

`DeploymentEngine` goes through the steps of a startup. What differs between platforms is in its `DeployedNodes`: how
the router and a node are started, suspended, ended and observed there.
"""

from __future__ import annotations

import json
import os
import socket
import threading
import time
from abc import abstractmethod
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any, ClassVar, TypeVar

import zenoh

from mast_zenoh import kernels, run_folder
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.errors import CredentialsError, DiskFull, EngineError, Interrupted
from mast_zenoh.launch.context import Mesh, RunContext
from mast_zenoh.launch.engine import Engine
from mast_zenoh.launch.supervisor import Child, Supervisor
from mast_zenoh.mesh.security import explain, levels
from mast_zenoh.mesh.security.credentials import UNREACHED, Credentials
from mast_zenoh.mesh.security.deployment import Deployment
from mast_zenoh.mesh.session import open_client

CREDENTIALS = "credentials"  # folder in the run folder, while the run lasts
ROUTER_SETTINGS = "router.json"

_TRY_MS = 2000
_POLL_S = 0.05

#: Bytes for logs, tables and figures, and a reserve for other programs.
_ALWAYS_BYTES = 64 << 20

#: Bytes of a recording per frame and node, generously: tracks and detections of some fifty objects.
_RECORDED_BYTES = 16 << 10

#: Variables that affect floating-point results: OpenBLAS sums in a different order on other processors, unless its
#: kernels are named. The number of threads is fixed for nodes, and does not affect results.
NUMERIC_VARIABLES = ("OPENBLAS_CORETYPE", "OPENBLAS_L2_SIZE", "NPY_DISABLE_CPU_FEATURES", "NPY_ENABLE_CPU_FEATURES")

#: The class of an engine's nodes.
C = TypeVar("C", bound=Child)


class DeployedNodes(Supervisor[C]):
    """The nodes of one run on a platform, from the preparation of their machines to the removal of what is left.

    router: name of the router's log; router_s: time for the router to come up, s
    grace_s, kill_s: longest times from SIGTERM to SIGKILL, and from that to the end of a node, s
    """

    router: ClassVar[str] = "router"
    router_s: ClassVar[float] = 60.0
    grace_s: ClassVar[float] = 0.0
    kill_s: ClassVar[float] = 30.0

    def __init__(self, context: RunContext, stack: ExitStack) -> None:
        super().__init__()
        self.context = context
        self.stack = stack
        self.logs = context.folder / "logs"

    # -- startup -------------------------------------------------------------------------------------------------

    @abstractmethod
    def prepare(self) -> dict[str, Any]:
        """Install what is missing; returns all that `status`, `logs` and `down` need, for run.json."""

    @abstractmethod
    def remove(self) -> None:
        """Remove everything of the run that still exists; called however the run ends."""

    @abstractmethod
    def router_hosts(self) -> list[str]:
        """Names and addresses of the router."""

    @abstractmethod
    def start_router(self, deployment: Deployment) -> str:
        """Start the router, and prepare the nodes; returns the endpoint tcp/HOST:PORT for the launcher."""

    def open_session(self, endpoint: str, deployment: Deployment) -> zenoh.Session:
        """Open the launcher's session."""
        return join(endpoint, deployment.launcher, self.router_s, lambda: self.context.signals)

    def begin(self, deployment: Deployment) -> None:
        """Complete the preparation of the nodes, now that the router is reached."""

    # -- supervision ---------------------------------------------------------------------------------------------

    @abstractmethod
    def router_ended(self) -> str | None:
        """What has ended the router, in words; None while it runs."""

    @abstractmethod
    def signal(self, children: list[C], word: str) -> None:
        """Ask nodes to leave ("TERM"), or end them ("KILL"), without waiting for it."""

    def look(self) -> None:
        """Update what is known of the router and the nodes, if the platform does not report it."""

    def running(self) -> list[C]:
        """The running nodes; raises EngineError if the router has ended."""
        self.look()
        if ending := self.router_ended():
            raise EngineError(f"the router{ending}; see logs/{self.router}.log")
        return super().running()

    def end(self, grace_s: float) -> None:
        """Resume and reconnect all nodes, then end them: SIGTERM, wait, SIGKILL."""
        self.look()
        self.resume(super().running())
        self.connect(super().running())
        for word, seconds in (("TERM", max(grace_s, self.grace_s)), ("KILL", self.kill_s)):
            running = super().running()
            if not running:
                break
            for child in running:
                child.notes.append(f"told to leave by SIG{word}")
            self.signal(running, word)
            self.wait(lambda: not super(DeployedNodes, self).running(), seconds)

    def wait(self, condition: Callable[[], bool], seconds: float) -> bool:
        """Wait for a condition on the known states; False after `seconds`."""
        deadline = time.monotonic() + seconds
        while not condition():
            if time.monotonic() > deadline:
                return False
            threading.Event().wait(_POLL_S)
            self.look()
        return True


class DeploymentEngine(Engine):
    """An engine whose nodes fetch their files over the mesh."""

    @abstractmethod
    def nodes(self, context: RunContext, stack: ExitStack) -> DeployedNodes[Any]:
        """The nodes of a run, of which nothing exists yet."""

    def join(self, context: RunContext, stack: ExitStack) -> Mesh:
        nodes = self.nodes(context, stack)
        context.record["deployment"] = {"engine": self.name, **nodes.prepare()}
        run_folder.write_json(context.folder / "run.json", context.record)
        stack.callback(nodes.remove)
        deployment = stack.enter_context(context.make_deployment(nodes.router_hosts(), context.folder / CREDENTIALS))
        endpoint = levels.endpoint(context.secure, nodes.start_router(deployment))
        context.record["endpoint"] = endpoint
        session = stack.enter_context(nodes.open_session(endpoint, deployment))
        nodes.begin(deployment)
        return Mesh(session, nodes, deployment)


def join(
    endpoint: str, credentials: Credentials | None, seconds: float, stopped: Callable[[], object] = lambda: False
) -> zenoh.Session:
    """Open the launcher's session as soon as the router at an endpoint answers.

    stopped: whether the run has been interrupted

    Raises Interrupted, EngineError if the router does not answer in time, CredentialsError if authentication fails.
    """
    deadline = time.monotonic() + seconds
    while True:
        if stopped():
            raise Interrupted("stopped by Ctrl-C or SIGTERM")
        try:
            return open_client(endpoint, credentials, try_ms=_TRY_MS)
        except zenoh.ZError as error:
            why = str(error)
        if credentials is not None:
            reasons = explain(credentials, endpoint)
            if any(UNREACHED not in reason for reason in reasons) and time.monotonic() > deadline:
                raise CredentialsError("; ".join(reasons))
            why = "; ".join(reasons) or why
        if time.monotonic() > deadline:
            raise EngineError(f"the router at {endpoint} cannot be reached within {seconds:.0f} s: {why}")
        threading.Event().wait(0.1)


def write_settings(folder: Path, router: Mapping[str, Any]) -> None:
    """Write the router's settings, which hold its key, into a folder, with modes 0700 and 0600."""
    folder.mkdir(mode=0o700, exist_ok=True)  # or a mounted one
    handle = os.open(folder / ROUTER_SETTINGS, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    with os.fdopen(handle, "w", encoding="utf-8") as file:
        json.dump(router, file, separators=(",", ":"))


def numeric_environment(launcher_environment: Mapping[str, str] = os.environ) -> dict[str, str]:
    """The launcher's variables that nodes need to get the same results wherever they run.

    If the launcher does not use this package's compiled kernels, its nodes do not either.
    """
    values = {name: launcher_environment[name] for name in NUMERIC_VARIABLES if name in launcher_environment}
    return values | ({"MAST_KERNELS": "numpy"} if kernels.USED == "numpy" else {})


def free_port() -> int:
    """A TCP port of this machine at which nothing listens."""
    with socket.socket() as probe:
        probe.bind(("", 0))
        return int(probe.getsockname()[1])


def needed_space(resolved: Resolved) -> int:
    """Bytes that a run may need in its folder."""
    recorded = any(spec.role == "recorder" for spec in resolved.nodes.values())
    return _ALWAYS_BYTES + (_RECORDED_BYTES * resolved.frames * len(resolved.nodes) if recorded else 0)


def check_space(place: Path, needed: int) -> None:
    """Raise DiskFull if a path's file system has less space; the path may not exist."""
    folder = place.absolute()
    while not folder.exists():
        folder = folder.parent
    status = os.statvfs(folder)
    free = status.f_bavail * status.f_frsize
    if free < needed:
        raise DiskFull(f"{place}: {free >> 20} MiB are free, {needed >> 20} MiB may be needed; name another with --out")
