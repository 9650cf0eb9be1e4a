"""Builds a node of a resolved scenario and hosts it as a process on a mesh; the `main` of that process.

The launcher starts it for the file of a node:

    python -P -m mast_zenoh.mesh nodes/agent.py --run-folder DIR --run ID --name infra_1 --endpoint TCP

The file needs no `main`. A file that ends with `main(TheNode)` can also be started directly:
`python nodes/agent.py --run-folder DIR …`.

The process ends when it is told to stop, when it gets SIGTERM, and when its standard input closes: the launcher holds
the other end, so nodes end with the launcher, however it dies. On another host, `LauncherWatch` watches its token.

Ends processes that a node's code has started, and that would outlive the node. Linux only: it reads /proc.

A node is the leader of a session. What it starts is in that session, unless it begins another one; then it is known by
the variable RUN in its environment, unless it has removed that as well.
"""

from __future__ import annotations

import argparse
import contextlib
import ctypes
import faulthandler
import gc
import logging
import os
import select
import shutil
import signal
import sys
import tempfile
import threading
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any

import zenoh

from mast_zenoh.config.loading import OWN_RUN
from mast_zenoh.config.resolved import Resolved, build_node
from mast_zenoh.errors import CredentialsError, MastError
from mast_zenoh.mesh.control import control_prefix
from mast_zenoh.mesh.control.codec import Signatures
from mast_zenoh.mesh.protocol.events import ORPHAN_GRACE_S
from mast_zenoh.mesh.protocol_log import PROTOCOL_LOGS
from mast_zenoh.mesh.security import explain
from mast_zenoh.mesh.security.control_keys import ControlKeys
from mast_zenoh.mesh.security.credentials import CONTROL, Credentials
from mast_zenoh.mesh.session import direct, open_client, open_observer
from mast_zenoh.mesh.zenoh_process import ZenohProcess
from mast_zenoh.messages import user_types
from mast_zenoh.node import Node

#: From the end of the launcher's router to that of the launcher, s.
_LAUNCHER_END_S = 0.5

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
    logs = Path(PROTOCOL_LOGS)
    write = (logs / f"{name}.msgpack").open("ab", buffering=0).write if logs.is_dir() else None
    process = ZenohProcess(run, resolved, name, instance, session, signatures, write)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the launcher's to handle
    signal.signal(signal.SIGTERM, lambda *_: process.stop("terminated"))
    if not process.protocol.outlets:
        os.nice(LISTENER_NICENESS)
    gc.freeze()  # existing objects stay: the garbage collector need not scan them again
    gc.set_threshold(50_000, 20, 20)
    gc.enable()
    return process


#: A file in the folder of temporary files that exists while the launcher does: for health checks.
UP = "mast-up"


class LauncherWatch:
    """A context that watches whether the launcher is present.

    patience_s: how long it may be absent, s; then `leave` is called, once, in a thread
    arrival_s:  how long it may take to appear at the beginning, s, if not `patience_s`
    """

    def __init__(
        self,
        session: zenoh.Session,
        run: str,
        patience_s: float,
        leave: Callable[[], None],
        *,
        arrival_s: float | None = None,
    ) -> None:
        self.limit_s = patience_s if arrival_s is None else arrival_s
        self._patience_s = patience_s
        self.gone = False
        self._leave = leave
        self._present = False
        self._changed = threading.Condition()
        self._closing = False
        key = f"{control_prefix(run)}/launcher"
        self._subscriber = session.liveliness().declare_subscriber(key, direct(self._note), history=True)
        self._watcher = threading.Thread(target=self._watch, daemon=True)

    def __enter__(self) -> LauncherWatch:
        self._watcher.start()
        return self

    def __exit__(self, *_: object) -> None:
        with self._changed:
            self._closing = True
            self._changed.notify()
        self._subscriber.undeclare()
        (Path(tempfile.gettempdir()) / UP).unlink(missing_ok=True)

    def _note(self, token: zenoh.Sample) -> None:
        with self._changed:
            self._present = token.kind == zenoh.SampleKind.PUT
            self.limit_s = self._patience_s
            self._changed.notify()

    def _watch(self) -> None:
        up = Path(tempfile.gettempdir()) / UP
        with self._changed:
            while not self._closing:
                with contextlib.suppress(OSError):
                    up.touch() if self._present else up.unlink(missing_ok=True)
                if self._present:
                    self._changed.wait()
                elif not self._changed.wait_for(lambda: self._present or self._closing, self.limit_s):
                    self.gone = True
                    break
        if self.gone:
            self._leave()


PR_SET_PDEATHSIG = 1  #: of prctl(2): the signal that a process gets when its parent dies


def main(node: type[Node] | None = None) -> None:
    """Run one node as this process; ends the process.

    node: its class; None: the class that the scenario names, in the file given as the first argument
    """
    faulthandler.enable()
    wake_when_orphaned()
    parser = argparse.ArgumentParser(description=(node.__doc__ or "").strip() if node else "A node of a run.")
    if node is None:
        parser.add_argument("file", type=Path, help="file of the node; files next to it can be imported by name")
    parser.add_argument("--run-folder", type=Path, required=True, help="holds scenario.json, wiring.json, scene.npz")
    parser.add_argument("--name", required=True, help="which node of the scenario this is")
    parser.add_argument("--endpoint", required=True, help="of the router, e.g. tcp/127.0.0.1:7447")
    parser.add_argument("--run", required=True, help="id of the run: all keys begin with mast/RUN/")
    parser.add_argument("--zid", help="Zenoh id of this process")
    parser.add_argument("--credentials", type=Path, help="folder of credentials: a secure mesh")
    parser.add_argument("--stay", action="store_true", help="do not leave when standard input closes")
    arguments = parser.parse_args()
    if node is None:
        sys.path.insert(0, str(arguments.file.parent))  # as if Python had been started with the file
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(levelname)s %(name)s: %(message)s", stream=sys.stderr)
    try:
        run(node, arguments)
    except MastError as error:
        logging.getLogger("mast").error("%s", error)
        sys.exit(error.exit_code)
    finally:
        end_own_strays()


def run(node: type[Node] | None, arguments: argparse.Namespace) -> None:
    """Build the node from its run folder and host it until it is told to stop."""
    processes: list[ZenohProcess] = []
    watcher = threading.Thread(target=_leave_with_launcher, args=(processes, arguments.credentials), daemon=True)
    if not arguments.stay:
        watcher.start()  # first of all: the launcher may be killed while this process is starting
    try:
        _host(node, arguments, processes)
    except Exception:  # perhaps because the launcher has ended: then the watcher must get to delete the credentials
        if not arguments.stay and arguments.credentials and select.select([0], [], [], _LAUNCHER_END_S)[0]:
            watcher.join()
        raise


def _host(node: type[Node] | None, arguments: argparse.Namespace, processes: list[ZenohProcess]) -> None:
    """Build and host the node; its process is appended as soon as it exists."""
    os.chdir(arguments.run_folder)
    resolved = Resolved.read(Path(), OWN_RUN, arguments.name)
    instance = build(resolved, arguments.name, f"{arguments.run_folder}/scenario.json", node)
    if resolved.mode == "lockstep":
        use_batch_scheduling()  # before there is a session, so that Zenoh's threads do so too
    where = arguments.endpoint, arguments.credentials
    with join(*where, patient=resolved.patient, zid=arguments.zid) as session:
        own = signatures(arguments.run, arguments.credentials)
        processes.append(host(resolved, arguments.run, arguments.name, instance, session, own))
        processes[0].run()


def wake_when_orphaned() -> None:
    """Have the kernel resume this process if its launcher dies while it is suspended."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, int(signal.SIGCONT), 0, 0, 0)


def _leave_with_launcher(processes: list[ZenohProcess], credentials: Path | None) -> None:
    """Wait for the end of standard input, then delete the credentials and leave."""
    while os.read(0, 4096):
        pass
    if credentials is not None:
        shutil.rmtree(credentials, ignore_errors=True)
        with contextlib.suppress(OSError):
            credentials.parent.rmdir()  # succeeds in the last process
    for process in processes:
        process.stop("orphaned")
        threading.Event().wait(ORPHAN_GRACE_S)
    end_own_strays()
    os._exit(3)


RUN = "MAST_RUN"  #: of the environment of all nodes of a run: its id

_ROUNDS, _ROUND_S = 100, 0.02  # a killed process may have started another one meanwhile


def end_own_strays() -> None:
    """End what this process has started, if a launcher has started it in a session of its own."""
    if sys.platform == "linux" and RUN in os.environ and os.getsid(0) == os.getpid():
        _end(lambda place: _session(place) == os.getpid())


def end_strays(run: str, groups: Collection[int]) -> None:
    """End all processes that have a run in their environment. To be called when its nodes have ended.

    groups: process groups of its nodes; what is left of them has been killed
    """
    mark = f"{RUN}={run}".encode()
    if sys.platform == "linux":
        _end(lambda place: mark in (place / "environ").read_bytes().split(b"\0"), groups)


def _end(is_stray: Callable[[Path], bool], groups: Collection[int] = ()) -> None:
    """Kill all processes of which this is true, given their folder in /proc; not this one."""
    ending = {-group for group in groups}
    for _ in range(_ROUNDS):
        strays = _strays(is_stray)
        for pid in strays:
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.kill(pid, signal.SIGKILL)
        ending = {pid for pid in ending.union(strays) if _has_children(pid)}
        if not (strays or ending):
            return
        threading.Event().wait(_ROUND_S)


def _has_children(pid: int) -> bool:
    """Whether this process has a child with this id (or in a group, if negative) that runs; takes notice of others."""
    try:
        while os.waitpid(pid, os.WNOHANG)[0]:
            pass
    except ChildProcessError:
        return False
    return True


def _session(place: Path) -> int:
    """The session of a process; 0 if it has ended, and its parent has not taken notice."""
    fields = (place / "stat").read_text().rpartition(")")[2].split()
    return 0 if fields[0] in "ZX" else int(fields[3])


def _strays(is_stray: Callable[[Path], bool]) -> list[int]:
    pids = []
    for place in Path("/proc").iterdir():
        with contextlib.suppress(OSError):  # it has ended, or is another user's
            if place.name.isdigit() and int(place.name) != os.getpid() and is_stray(place):
                pids.append(int(place.name))
    return pids
