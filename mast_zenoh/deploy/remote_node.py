"""`mast-node`: a node or the router in a container or on another host.

    mast-node --name infra_1 --run ID --endpoint tcp/HOST:7447 [--credentials DIR] [--patience S] [--again]
    mast-node --router --run ID --listen tcp/0.0.0.0:7447 [--settings FILE] [--patience S]

There is no run folder here: a node fetches its files from the launcher, and sends it the files that it writes
(`mesh.file_client`). It leaves when the launcher has been away for a while (`LauncherWatch`).
"""

from __future__ import annotations

import argparse
import faulthandler
import json
import logging
import os
import signal
import sys
import tempfile
import threading
from collections.abc import Callable
from pathlib import Path

import zenoh

from mast_zenoh import version
from mast_zenoh.config.loading import OWN_RUN
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.errors import MastError, StartError
from mast_zenoh.mesh import hosting
from mast_zenoh.mesh.control.flow import LEAVE
from mast_zenoh.mesh.file_client import FileClient, HandIn, files_written_by
from mast_zenoh.mesh.hosting import LauncherWatch, end_own_strays
from mast_zenoh.mesh.security.credentials import Credentials
from mast_zenoh.mesh.session import open_router

#: Default time that a node continues without a launcher, s.
PATIENCE_S = 30.0

#: Minimum time that a node tries to reach the router, and a router waits for the launcher, s: all is still starting.
JOIN_S = 60.0

_GRACE_S = 2.0  # for a node to end without a launcher; the router leaves that much later

log = logging.getLogger("mast")


def main() -> None:
    """Console script `mast-node`; ends the process, with an error's exit code."""
    os.umask(0o077)  # files that a node writes here are for the launcher only
    faulthandler.enable()
    parser = argparse.ArgumentParser(prog="mast-node", description="A node of a run, or its router, on this host.")
    parser.add_argument("--run", required=True, help="id of the run: all keys begin with mast/RUN/")
    parser.add_argument("--name", help="which node of the scenario this is")
    parser.add_argument("--endpoint", help="of the router, e.g. tcp/router:7447")
    parser.add_argument("--credentials", type=Path, help="folder of credentials: a secure mesh")
    parser.add_argument("--router", action="store_true", help="be the router of the run")
    parser.add_argument("--listen", default="tcp/0.0.0.0:7447", help="where the router listens")
    parser.add_argument("--settings", type=Path, help="additional settings of the router: a JSON file")
    parser.add_argument("--again", action="store_true", help="be ready to start again until the launcher has gone")
    parser.add_argument("--patience", type=float, default=PATIENCE_S, help="seconds to stay without the launcher")
    arguments = parser.parse_args()
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(levelname)s %(name)s: %(message)s", stream=sys.stderr)
    if not arguments.router and not (arguments.name and arguments.endpoint):
        parser.error("a node needs --name and --endpoint")
    try:
        (_route if arguments.router else _host)(arguments)
    except MastError as error:
        log.error("%s", error)
        sys.exit(error.exit_code)
    finally:
        end_own_strays()


def _route(arguments: argparse.Namespace) -> None:
    """Run the router until SIGTERM, or until the launcher has gone."""
    security = json.loads(arguments.settings.read_text()) if arguments.settings else None
    leave = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: leave.set())
    session, endpoint = open_router(arguments.listen, security=security, links_may_be_cut=True)
    patience_s = arguments.patience + _GRACE_S
    watched = LauncherWatch(session, arguments.run, patience_s, leave.set, arrival_s=max(JOIN_S, patience_s))
    with session, watched as watch:
        log.info("mast-zenoh %s: router at %s", version.version_string(), endpoint)
        leave.wait()
        if watch.gone:
            log.warning("no launcher for %.0f s: leaving", watch.limit_s)


def _host(arguments: argparse.Namespace) -> None:
    """Fetch a node's files, host it until it is told to stop, hand in what it wrote."""
    credentials = Credentials.read(arguments.credentials) if arguments.credentials else None
    run, name = arguments.run, arguments.name
    with tempfile.TemporaryDirectory(prefix="mast-") as own, _join(arguments, credentials) as session:
        leave: list[Callable[[], None]] = [lambda: os._exit(0 if arguments.again else 3)]  # nothing to hand in yet
        arrival_s = max(JOIN_S, arguments.patience) if arguments.again else arguments.patience
        with LauncherWatch(session, run, arguments.patience, lambda: leave[0](), arrival_s=arrival_s):
            folder, client = Path(own), FileClient(session, run, name)
            client.fetch(folder, arrival_s)
            os.chdir(folder)
            resolved = Resolved.read(folder, OWN_RUN)
            if resolved.mode == "lockstep":
                hosting.use_batch_scheduling()
            instance = hosting.build(resolved, name)
            signatures = hosting.signatures(run, credentials)
            process = hosting.host(resolved, run, name, instance, session, signatures)
            process.protocol.host_facts = {"versions": version.versions(), "clock": client.clock}

            def orphaned() -> None:
                process.stop("orphaned")
                threading.Event().wait(_GRACE_S)
                end_own_strays()
                os._exit(3)

            leave[0] = orphaned
            if arguments.again:
                process.protocol.on_kill = _start_over
            try:
                with HandIn(client, folder, files_written_by(resolved, name, instance)) as written:
                    process.hand_in_files = written.finish
                    process.run()
            except Exception:
                if not arguments.again:
                    raise
                log.exception("the node has failed")
                _start_over()
            if not arguments.again:
                return
            if process.protocol.stop_reason == LEAVE:
                _start_over()
            gone = threading.Event()
            leave[0] = gone.set
            signal.signal(signal.SIGTERM, lambda *_: gone.set())
            gone.wait()


def _start_over() -> None:
    """Replace this process, at once, by a new one that asks for its files again.

    For the mesh it is as if the node had been killed. It gets its files when the scenario starts it again.
    """
    sys.stdout.flush()
    os.execv(sys.executable, sys.orig_argv)


def _join(arguments: argparse.Namespace, credentials: Credentials | None) -> zenoh.Session:
    """Open a session on the mesh; ends the process if the router stays unreachable."""
    seconds = max(JOIN_S, arguments.patience)

    def give_up() -> None:
        log.error("the router at %s cannot be reached within %.0f s: leaving", arguments.endpoint, seconds)
        os._exit(StartError.exit_code)

    deadline = threading.Timer(seconds, give_up)
    deadline.daemon = True
    deadline.start()
    try:
        return hosting.join(arguments.endpoint, credentials)
    finally:
        deadline.cancel()


if __name__ == "__main__":
    main()
