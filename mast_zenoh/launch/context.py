"""State of a run on a mesh, shared by the launcher, engines and observers."""

from __future__ import annotations

import queue
import signal
from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import zenoh
from rich.markup import escape

from mast_zenoh.config.resolved import Resolved, driver_of
from mast_zenoh.launch.launcher_protocol import RunState
from mast_zenoh.launch.supervisor import Supervisor
from mast_zenoh.mesh.control import prefix
from mast_zenoh.mesh.control.codec import InvalidMessages, Signatures
from mast_zenoh.mesh.security.control_keys import ControlKeys
from mast_zenoh.mesh.security.deployment import Deployment
from mast_zenoh.wiring.model import Wiring

#: Entry of run.json of a secure run with a viewer: the folder of the viewer's credentials.
VIEWER_CREDENTIALS = "viewer_credentials"


class Mesh(NamedTuple):
    """A mesh that the launcher has joined.

    session: the launcher's; supervisor: starts, watches and ends the nodes
    deployment: the credentials of this run; None without security
    control: the launcher's control keys, if it has not made the credentials itself
    has_router: whether the session is the router's own, so that what it subscribes to crosses no link
    zids: the Zenoh ids of all nodes that the supervisor has started; grows with them
    """

    session: zenoh.Session
    supervisor: Supervisor[Any]
    deployment: Deployment | None = None
    has_router: bool = False
    zids: Collection[str] = ()
    control: ControlKeys | None = None


@dataclass(kw_only=True)
class RunContext(RunState):
    """State of one run on a mesh, shared by the parts of the launcher; RunState has the part that decides.

    record:   run.json so far; an engine sets `endpoint` and `deployment` in it
    secure:   one of `security.levels.LEVELS`
    detours:  by node, another endpoint at which it reaches the router; set these before the run starts
    viewer:   whether observers may join the mesh; on a secure mesh they get the viewer's credentials
    awaited:  called in turn when observers can join the mesh: the nodes start when all have returned

    The launcher sets these during the run:

    first_frame_s: when the first frame began, s on the monotonic clock
    mesh:     None before it is joined
    signatures: signs control messages, with the run's keys once the mesh is joined
    invalid:  counts the control messages that the launcher has refused
    """

    folder: Path
    record: dict[str, Any]
    secure: str = "open"
    detours: dict[str, str] = field(default_factory=dict)
    viewer: bool = False
    awaited: list[Callable[[], None]] = field(default_factory=list)
    first_frame_s: float | None = field(default=None, init=False)
    mesh: Mesh | None = field(default=None, init=False)
    signatures: Signatures = field(init=False)
    invalid: InvalidMessages = field(init=False)
    _refusals: queue.SimpleQueue[str] = field(default_factory=queue.SimpleQueue, init=False)  # from Zenoh's threads

    def __post_init__(self) -> None:
        super().__post_init__()
        self.signatures = Signatures(self.run_id)
        self.invalid = InvalidMessages(self._refusals.put)

    @property
    def run_id(self) -> str:
        """The id of the run."""
        return str(self.record["id"])

    def make_deployment(self, hosts: Iterable[str], folder: Path | None = None) -> Deployment:
        """Create the credentials of all nodes of the run.

        hosts: names and addresses of the router; folder: see Deployment
        """
        return deployment_of(self.resolved, self.run_id, self.secure, hosts=hosts, viewer=self.viewer, folder=folder)

    def attach(self, mesh: Mesh) -> None:
        """Set the mesh that the launcher has joined; sign control messages from now on."""
        self.mesh = mesh
        self.signatures = Signatures(self.run_id, mesh.deployment.control if mesh.deployment else mesh.control)

    def interrupt(self) -> None:
        """End the run as Ctrl-C does; may be called from any thread."""
        self.signals.append(signal.SIGINT)

    def show_refusals(self) -> None:
        """Show refusals since the last call; only for the main thread."""
        while not self._refusals.empty():
            self.show(f"[yellow]{escape(self._refusals.get())}")


def deployment_of(resolved: Resolved, run: str, secure: str, **options: Any) -> Deployment:
    """Create the credentials of all nodes of a run; options: see Deployment."""
    wiring, nodes = Wiring.from_json(resolved.wiring), resolved.nodes
    return Deployment(secure, run, wiring, nodes, prefix=prefix(run), driver=driver_of(nodes), **options)
