"""The `main` of every node's file: `python nodes/agent.py --run-folder DIR --run ID --name infra_1 --endpoint TCP`.

The process leaves when it is told to stop, when it gets SIGTERM, and when its standard input closes: the launcher
holds the other end, so that a launcher that dies, however it dies, takes its nodes with it.
"""

from __future__ import annotations

import argparse
import faulthandler
import gc
import logging
import os
import signal
import sys
import threading
from pathlib import Path

from mast_zenoh import loading, registry
from mast_zenoh.errors import MastError
from mast_zenoh.node import Node, Source
from mast_zenoh.runtime.driver import Driver
from mast_zenoh.runtime.mesh import MeshNode
from mast_zenoh.runtime.session import open_client
from mast_zenoh.scenario import Resolved
from mast_zenoh.wiring import Wiring

ORPHAN_GRACE_S = 2.0

#: Nobody waits for a node that only listens, so it leaves the processor to those who are waited for.
YIELD = 10


def main(node: type[Node]) -> None:
    """Run one node of this class as this process; ends the process."""
    faulthandler.enable()
    parser = argparse.ArgumentParser(description=(node.__doc__ or "").strip())
    parser.add_argument("--run-folder", type=Path, required=True, help="holds scenario.json, wiring.json, scene.npz")
    parser.add_argument("--name", required=True, help="which node of the scenario this is")
    parser.add_argument("--endpoint", required=True, help="of the router, e.g. tcp/127.0.0.1:7447")
    parser.add_argument("--run", required=True, help="id of the run: all keys begin with mast/RUN/")
    parser.add_argument("--stay", action="store_true", help="do not leave when standard input closes")
    arguments = parser.parse_args()
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(levelname)s %(name)s: %(message)s", stream=sys.stderr)
    try:
        run(node, arguments)
    except MastError as error:
        logging.getLogger("mast").error("%s", error)
        sys.exit(error.exit_code)


def run(node: type[Node], arguments: argparse.Namespace) -> None:
    """Build the node from its run folder and host it until it is told to stop."""
    os.chdir(arguments.run_folder)
    resolved = Resolved.read(Path())
    for file in resolved.modules:
        loading.module(Path(file))
    spec = resolved.nodes[arguments.name]
    built = registry.construct(node, spec.config, f"{arguments.run_folder}/scenario.json: {arguments.name}")
    wiring = Wiring.from_json(resolved.wiring)
    if resolved.mode == "lockstep" and hasattr(os, "SCHED_BATCH"):
        # Whoever computes goes on until it is done: in lock-step nobody gains by being let in sooner. Set before the
        # session is opened, so that Zenoh's threads have it too.
        os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
    with open_client(arguments.endpoint) as session:
        common = (arguments.run, arguments.name, built, wiring, resolved.seed, session)
        if isinstance(built, Source):
            roles = {name: node_spec.role for name, node_spec in resolved.nodes.items()}
            hosted: MeshNode = Driver(*common, expected=roles, mode=resolved.mode, rate=resolved.rate)
        else:
            hosted = MeshNode(*common)
        if resolved.mode == "realtime":
            hosted.note_arrivals()
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the launcher's to handle
        signal.signal(signal.SIGTERM, lambda *_: hosted.inbox.put(("stop", "terminated")))
        if not wiring.ports(arguments.name).outputs:
            os.nice(YIELD)
        gc.freeze()  # what is there now stays: collections need not look at it again
        gc.set_threshold(50_000, 20, 20)
        if not arguments.stay:
            threading.Thread(target=_leave_with_launcher, args=(hosted,), daemon=True).start()
        hosted.run_until_stopped()


def _leave_with_launcher(hosted: MeshNode) -> None:
    """Wait for the end of standard input; then leave, at the latest after a grace."""
    while os.read(0, 4096):
        pass
    hosted.inbox.put(("stop", "orphaned"))
    threading.Event().wait(ORPHAN_GRACE_S)
    os._exit(3)
