"""The `main` of a node's process, started by the launcher for the file of a node:

    python -P -m mast_zenoh.runtime nodes/agent.py --run-folder DIR --run ID --name infra_1 --endpoint TCP

The file needs no `main`. A file that ends with `main(TheNode)` can also be started directly:
`python nodes/agent.py --run-folder DIR …`.

The process ends when it is told to stop, when it gets SIGTERM, and when its standard input closes. The launcher holds
the other end, so nodes end with the launcher, however it dies.
"""

from __future__ import annotations

import argparse
import contextlib
import ctypes
import faulthandler
import logging
import os
import shutil
import signal
import sys
import threading
from pathlib import Path

from mast_zenoh.config.allowed_code import OWN_RUN
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.errors import MastError
from mast_zenoh.node import Node
from mast_zenoh.runtime.mesh import hosting
from mast_zenoh.runtime.mesh.zenoh_process import ZenohProcess
from mast_zenoh.runtime.protocol.actions import ORPHAN_GRACE_S

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


def run(node: type[Node] | None, arguments: argparse.Namespace) -> None:
    """Build the node from its run folder and host it until it is told to stop."""
    processes: list[ZenohProcess] = []
    if not arguments.stay:  # first of all: the launcher may be killed while this process is starting
        threading.Thread(target=_leave_with_launcher, args=(processes, arguments.credentials), daemon=True).start()
    os.chdir(arguments.run_folder)
    resolved = Resolved.read(Path(), OWN_RUN, arguments.name)
    instance = hosting.build(resolved, arguments.name, f"{arguments.run_folder}/scenario.json", node)
    if resolved.mode == "lockstep":
        hosting.use_batch_scheduling()  # before there is a session, so that Zenoh's threads do so too
    where = arguments.endpoint, arguments.credentials
    with hosting.join(*where, patient=resolved.patient, zid=arguments.zid) as session:
        signatures = hosting.signatures(arguments.run, arguments.credentials)
        processes.append(hosting.host(resolved, arguments.run, arguments.name, instance, session, signatures))
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
    os._exit(3)
