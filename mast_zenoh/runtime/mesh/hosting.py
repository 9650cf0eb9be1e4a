"""From a resolved scenario to one of its nodes as a process on a mesh, wherever that process runs."""

from __future__ import annotations

import contextlib
import gc
import os
import signal
from collections.abc import Collection
from pathlib import Path
from typing import Any

import zenoh

from mast_zenoh.config import loading, registry
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.control.signatures import Signatures
from mast_zenoh.errors import CredentialsError
from mast_zenoh.messages import user_types
from mast_zenoh.node import Node, Source
from mast_zenoh.runtime.lockstep.timetable import Timetable
from mast_zenoh.runtime.mesh.driver import Driver
from mast_zenoh.runtime.mesh.node import MeshNode
from mast_zenoh.runtime.mesh.session import open_client
from mast_zenoh.security import explain
from mast_zenoh.security.control_keys import ControlKeys
from mast_zenoh.security.credentials import CONTROL, Credentials
from mast_zenoh.wiring.model import Wiring

#: Niceness of a node that only listens: no frame waits for it, so it leaves the processor to the others.
LISTENER_NICENESS = 10


def build(resolved: Resolved, name: str, node: type[Node] | None = None, place: str = "scenario.json") -> Any:
    """A node of a scenario, the class being that in its file unless it is given; runs the user's modules first.

    From then on the codec knows the message types of the scenario.
    """
    user_types.use(resolved.messages)
    for file in resolved.modules:
        loading.module(Path(file))
    spec = resolved.nodes[name]
    return registry.construct(node or loading.node_class(Path(spec.file), spec.type), spec.config, f"{place}: {name}")


def join(endpoint: str, credentials: Path | Credentials | None, *, patient: bool = False) -> zenoh.Session:
    """A session on the mesh. Raises CredentialsError for unusable credentials before it connects.

    patient: see `session.open_client`
    """
    if credentials is None:
        return open_client(endpoint, patient=patient)
    if reasons := explain(credentials):
        raise CredentialsError("; ".join(reasons))
    return open_client(endpoint, _own(credentials), patient=patient)


def signatures(run: str, credentials: Path | Credentials | None) -> Signatures:
    """Signs and checks control messages with these credentials; raises CredentialsError."""
    if credentials is None:
        return Signatures(run)
    where = f"{credentials}/{CONTROL}" if isinstance(credentials, Path) else CONTROL
    return Signatures(run, ControlKeys.from_json(_own(credentials).control, where))


def _own(credentials: Path | Credentials) -> Credentials:
    return Credentials.read(credentials) if isinstance(credentials, Path) else credentials


def use_batch_scheduling() -> None:
    """Have processes that wake up preempt this one less often: in lock-step no node gains by running sooner.

    For all threads that there are, and those that they will start.
    """
    if hasattr(os, "SCHED_BATCH"):
        with contextlib.suppress(PermissionError):  # a container may forbid it; it is only faster
            for thread in os.listdir("/proc/self/task"):
                os.sched_setscheduler(int(thread), os.SCHED_BATCH, os.sched_param(0))


def host(
    resolved: Resolved,
    run: str,
    name: str,
    built: Any,
    session: zenoh.Session,
    without: Collection[str],
    signatures: Signatures,
) -> MeshNode:
    """The node on the mesh, before its life begins. From now on SIGTERM asks it to leave."""
    wiring = Wiring.from_json(resolved.wiring)
    lockstep = resolved.mode == "lockstep"
    common = (run, name, built, wiring, resolved.seed, session)
    more: dict[str, Any] = {"signatures": signatures, "period_ns": resolved.period_ns, "lockstep": lockstep}
    more |= {"without": without, "timespan": resolved.timespan}
    if isinstance(built, Source):
        roles = {other: spec.role for other, spec in resolved.nodes.items()}
        timetable = Timetable(resolved, lockstep=lockstep)
        hosted: MeshNode = Driver(*common, **more, expected=roles, rate=resolved.rate, timetable=timetable)
    else:
        hosted = MeshNode(*common, **more)
    if not lockstep:
        hosted.note_arrivals()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the launcher's to handle
    signal.signal(signal.SIGTERM, lambda *_: hosted.inbox.put(("stop", "terminated")))
    if not wiring.ports(name).outputs:
        os.nice(LISTENER_NICENESS)
    gc.freeze()  # what is there now stays: collections need not look at it again
    gc.set_threshold(50_000, 20, 20)
    return hosted
