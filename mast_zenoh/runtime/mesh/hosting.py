"""Builds a node of a resolved scenario and hosts it as a process on a mesh."""

from __future__ import annotations

import contextlib
import gc
import os
import signal
from pathlib import Path
from typing import Any

import zenoh

from mast_zenoh.config.resolved import Resolved, build_node
from mast_zenoh.control.signatures import Signatures
from mast_zenoh.errors import CredentialsError
from mast_zenoh.messages import user_types
from mast_zenoh.node import Node
from mast_zenoh.runtime.mesh.session import open_client, open_observer
from mast_zenoh.runtime.mesh.zenoh_process import ZenohProcess
from mast_zenoh.security import explain
from mast_zenoh.security.control_keys import ControlKeys
from mast_zenoh.security.credentials import CONTROL, Credentials

#: Niceness of a node that publishes nothing: no frame waits for it, so other nodes have priority.
LISTENER_NICENESS = 10


def build(resolved: Resolved, name: str, place: str = "scenario.json", cls: type[Node] | None = None) -> Node:
    """Build a node of a scenario, after importing the user's modules; see `build_node`."""
    user_types.use(resolved.messages)
    resolved.load_modules()
    return build_node(resolved.nodes[name], name, place, cls)


def join(
    endpoint: str,
    credentials: Path | Credentials | None,
    *,
    patient: bool = False,
    zid: str | None = None,
    observer: bool = False,
) -> zenoh.Session:
    """Open a session on the mesh.

    patient, zid: see `session.open_client`;  observer: see `session.open_observer`

    Raises CredentialsError for unusable credentials before it connects.
    """
    if credentials is not None and (reasons := explain(credentials)):
        raise CredentialsError("; ".join(reasons))
    own = None if credentials is None else _own(credentials)
    return open_observer(endpoint, own) if observer else open_client(endpoint, own, patient=patient, zid=zid)


def signatures(run: str, credentials: Path | Credentials | None) -> Signatures:
    """Signatures of control messages with these credentials; raises CredentialsError."""
    return Signatures(run, None if credentials is None else control_keys(credentials))


def control_keys(credentials: Path | Credentials) -> ControlKeys:
    """The control keys in credentials; raises CredentialsError."""
    where = f"{credentials}/{CONTROL}" if isinstance(credentials, Path) else CONTROL
    return ControlKeys.from_json(_own(credentials).control, where)


def _own(credentials: Path | Credentials) -> Credentials:
    return Credentials.read(credentials) if isinstance(credentials, Path) else credentials


def use_batch_scheduling() -> None:
    """Reduce preemption by waking processes: none gains by it in lock-step.

    Affects all current threads, and threads that they start.
    """
    if hasattr(os, "SCHED_BATCH"):
        with contextlib.suppress(PermissionError):  # a container may forbid it; it is only faster
            for thread in os.listdir("/proc/self/task"):
                os.sched_setscheduler(int(thread), os.SCHED_BATCH, os.sched_param(0))


def host(
    resolved: Resolved, run: str, name: str, instance: Any, session: zenoh.Session, signatures: Signatures
) -> ZenohProcess:
    """Put a built node on the mesh, not yet running; from now on SIGTERM stops it."""
    process = ZenohProcess(run, resolved, name, instance, session, signatures)
    if resolved.mode != "lockstep":
        process.protocol.note_arrivals()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the launcher's to handle
    signal.signal(signal.SIGTERM, lambda *_: process.stop("terminated"))
    if not process.protocol.outlets:
        os.nice(LISTENER_NICENESS)
    gc.freeze()  # existing objects stay: the garbage collector need not scan them again
    gc.set_threshold(50_000, 20, 20)
    gc.enable()
    return process
