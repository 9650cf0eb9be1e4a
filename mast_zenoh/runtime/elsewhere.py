"""`mast-node`: a node, or the router, that lives where the run folder is not: in a container, on another host.

    mast-node --name infra_1 --run ID --endpoint tcp/HOST:7447 [--credentials DIR] [--patience S]
    mast-node --router --run ID --listen tcp/0.0.0.0:7447 [--settings FILE] [--patience S]

A node asks the launcher for what it needs, under @control/fetch/{node}, and gives it what it has written, under
@control/file/{node}; both are queries of MessagePack maps:

    fetch  {do: "join", version, versions}   → {files: {path: bytes}, without: [nodes], written: [paths]}, or refused
    fetch  {do: "clock"}                     → {now_ns}
    fetch  {do: "piece", path, offset}       → {piece: bytes}
    file   {path, offset, piece}             → {}

Nobody holds its standard input: it leaves by itself when the launcher's liveliness token has been gone for a while.
"""

from __future__ import annotations

import argparse
import contextlib
import faulthandler
import json
import logging
import os
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import zenoh

from mast_zenoh import release
from mast_zenoh.control import files
from mast_zenoh.control.files import PIECE_BYTES
from mast_zenoh.errors import MastError, MessageError, RunError, StartError
from mast_zenoh.messagelog.writer import MessageLog
from mast_zenoh.resolved import Resolved
from mast_zenoh.runtime import hosting
from mast_zenoh.runtime.mesh import prefix
from mast_zenoh.runtime.session import open_router
from mast_zenoh.security.credentials import Credentials

#: Seconds for which a node goes on without a launcher, unless told otherwise.
PATIENCE_S = 30.0

#: There while a node is on the mesh of its launcher: for health checks.
UP = "mast-up"

#: Seconds within which a node must find the router, at least: everything is only just coming up.
JOIN_S = 60.0

_GRACE_S = 2.0  # for a node that leaves without a launcher; the router goes that much later
_HAND_IN_EVERY_S = 1.0
_HAND_IN_TIMEOUT_S = 20.0
_PROBES = 5

log = logging.getLogger("mast")


def main() -> None:
    """The console script; ends the process, with the exit code of what went wrong."""
    os.umask(0o077)  # nobody but the launcher gets what a node writes here
    faulthandler.enable()
    parser = argparse.ArgumentParser(prog="mast-node", description="A node of a run, or its router, on this host.")
    parser.add_argument("--run", required=True, help="id of the run: all keys begin with mast/RUN/")
    parser.add_argument("--name", help="which node of the scenario this is")
    parser.add_argument("--endpoint", help="of the router, e.g. tcp/router:7447")
    parser.add_argument("--credentials", type=Path, help="folder of credentials: a secure mesh")
    parser.add_argument("--router", action="store_true", help="be the router of the run")
    parser.add_argument("--listen", default="tcp/0.0.0.0:7447", help="where the router listens")
    parser.add_argument("--settings", type=Path, help="the router's further settings: a JSON file")
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


def _route(arguments: argparse.Namespace) -> None:
    """Be the router until SIGTERM, or until there is no launcher."""
    security = json.loads(arguments.settings.read_text()) if arguments.settings else None
    leave = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: leave.set())
    session, endpoint = open_router(arguments.listen, security=security, links_may_be_cut=True)
    with session, Launcher(session, arguments.run, arguments.patience + _GRACE_S, leave.set) as launcher:
        log.info("mast-zenoh %s: router at %s", release.named(), endpoint)
        leave.wait()
        if launcher.gone:
            log.warning("no launcher for %.0f s: leaving", launcher.patience_s)


def _host(arguments: argparse.Namespace) -> None:
    """Fetch what the node needs, host it until it is told to stop, hand in what it has written."""
    credentials = Credentials.read(arguments.credentials) if arguments.credentials else None
    run, name = arguments.run, arguments.name
    with tempfile.TemporaryDirectory(prefix="mast-") as own, _join(arguments, credentials) as session:
        leave: list[Callable[[], None]] = [lambda: os._exit(3)]  # nothing to hand in yet
        with Launcher(session, run, arguments.patience, lambda: leave[0]()):
            folder, depot = Path(own), Depot(session, run, name)
            without = depot.fetch(folder, arguments.patience)
            os.chdir(folder)
            resolved = Resolved.read(folder)
            if resolved.mode == "lockstep":
                hosting.compute_in_peace()
            built = hosting.build(resolved, name)
            signatures = hosting.signatures(run, credentials)
            hosted = hosting.host(resolved, run, name, built, session, without, signatures)
            hosted.of_host = {"versions": release.versions(), "clock": depot.clock}

            def orphaned() -> None:
                hosted.inbox.put(("stop", "orphaned"))
                threading.Event().wait(_GRACE_S)
                os._exit(3)

            leave[0] = orphaned
            with HandIn(depot, folder, written_by(resolved, name, built)):
                hosted.run_until_stopped()


def _join(arguments: argparse.Namespace, credentials: Credentials | None) -> zenoh.Session:
    """A session on the mesh; ends the process when there is no router for too long."""
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


def written_by(resolved: Resolved, name: str, built: Any = None) -> tuple[str, ...]:
    """The files that a node writes: the logs among its parameters, as values or as its attributes."""
    values = [*resolved.nodes[name].config.values(), *(vars(built).values() if built is not None else ())]
    return tuple(dict.fromkeys(str(value.path) for value in values if isinstance(value, MessageLog)))


A = TypeVar("A")


class Launcher:
    """Watches whether the launcher is there: a context.

    patience_s: for so long it may be away, at the beginning too; then `leave` is called, once, in a thread
    """

    def __init__(self, session: zenoh.Session, run: str, patience_s: float, leave: Callable[[], None]) -> None:
        self.patience_s = patience_s
        self.gone = False
        self._leave = leave
        self._there = False
        self._changed = threading.Condition()
        self._over = False
        handler: Any = zenoh.handlers.Callback(self._note, indirect=False)
        key = f"{prefix(run)}/@control/launcher"
        self._subscriber = session.liveliness().declare_subscriber(key, handler, history=True)
        self._watcher = threading.Thread(target=self._watch, daemon=True)

    def __enter__(self) -> Launcher:
        self._watcher.start()
        return self

    def __exit__(self, *_: object) -> None:
        with self._changed:
            self._over = True
            self._changed.notify()
        self._subscriber.undeclare()
        (Path(tempfile.gettempdir()) / UP).unlink(missing_ok=True)

    def _note(self, token: zenoh.Sample) -> None:
        with self._changed:
            self._there = token.kind == zenoh.SampleKind.PUT
            self._changed.notify()

    def _watch(self) -> None:
        up = Path(tempfile.gettempdir()) / UP
        with self._changed:
            while not self._over:
                with contextlib.suppress(OSError):
                    up.touch() if self._there else up.unlink(missing_ok=True)
                if self._there:
                    self._changed.wait()
                elif not self._changed.wait_for(lambda: self._there or self._over, self.patience_s):
                    self.gone = True
                    break
        if self.gone:
            self._leave()


class Depot:
    """What the launcher keeps for one node, and takes from it.

    clock: offset_ms, this host's clock minus the launcher's, and round_trip_ms, within which it was measured
    """

    def __init__(self, session: zenoh.Session, run: str, name: str) -> None:
        self._session = session
        self._base = f"{prefix(run)}/@control"
        self._name = name
        self.clock: dict[str, float] = {}

    def fetch(self, folder: Path, patience_s: float) -> list[str]:
        """All files of this node into a folder; returns who is not up now. Raises what the launcher refuses it for."""
        asked = {"do": "join", "version": release.named(), "versions": release.versions()}
        told = self.ask("fetch", asked, patience_s, files.decode_belongings)
        for path, size in told.files.items():
            target = _below(folder, path)
            target.parent.mkdir(parents=True, exist_ok=True)
            with target.open("wb") as file:
                while file.tell() < size:
                    wanted = {"do": "piece", "path": path, "offset": file.tell()}
                    piece = self.ask("fetch", wanted, patience_s, files.decode_piece)
                    if not piece:
                        raise RunError(f"{path}: the launcher has {file.tell()} bytes of it, expected {size}")
                    file.write(piece)
        for path in told.written:
            _below(folder, path).touch()  # who is started again must not begin anew what it has written before
        self._compare_clocks(patience_s)
        return told.without

    def hand_in(self, path: str, offset: int, piece: bytes, seconds: float) -> None:
        """Append to a file of the run folder."""
        self.ask("file", {"path": path, "offset": offset, "piece": piece}, seconds, files.decode_nothing)

    def ask(self, what: str, request: dict[str, Any], seconds: float, decode: Callable[[bytes], A]) -> A:
        """The launcher's answer; asks again while nobody answers. Raises what it refuses it with, RunError for time.

        decode: of the answer; one that it raises MessageError for is none
        """
        deadline = time.monotonic() + seconds
        payload = files.encode(request)
        while True:
            for reply in self._session.get(f"{self._base}/{what}/{self._name}", payload=payload, timeout=5.0):
                if reply.ok is not None:
                    try:
                        return decode(reply.ok.payload.to_bytes())
                    except MessageError as error:
                        log.warning("no answer of the launcher (%s): %s", what, error)
                if reply.err is not None and (refusal := files.decode_refusal(reply.err.payload.to_bytes())):
                    raise refusal
            if time.monotonic() > deadline:
                raise RunError(f"{self._name}: the launcher has not answered ({what}) within {seconds:.0f} s")
            threading.Event().wait(0.1)

    def _compare_clocks(self, seconds: float) -> None:
        """As NTP does; of several the quickest answer counts."""
        measured = []
        for _ in range(_PROBES):
            sent = time.time_ns()
            theirs = self.ask("fetch", {"do": "clock"}, seconds, files.decode_clock)
            came = time.time_ns()
            measured.append((came - sent, (sent + came) // 2 - theirs))
        round_trip, offset = min(measured)
        self.clock = {"offset_ms": round(offset * 1e-6, 3), "round_trip_ms": round(round_trip * 1e-6, 3)}


class HandIn:
    """Gives files to the launcher while they grow, and what is left when the node has ended: a context."""

    def __init__(self, depot: Depot, folder: Path, paths: tuple[str, ...]) -> None:
        self._depot = depot
        self._folder = folder
        self._offsets = dict.fromkeys(paths, 0)
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._follow, daemon=True)

    def __enter__(self) -> HandIn:
        if self._offsets:
            self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self._over.set()
        if self._offsets:
            self._thread.join()
            if kind is None:
                self._send()

    def _follow(self) -> None:
        while not self._over.wait(_HAND_IN_EVERY_S):
            try:
                self._send()
            except Exception as error:  # the end tries again, and says so
                log.warning("what is written could not be handed in yet: %s", error)

    def _send(self) -> None:
        for path in self._offsets:
            with contextlib.suppress(FileNotFoundError), (self._folder / path).open("rb") as file:
                file.seek(self._offsets[path])
                while piece := file.read(PIECE_BYTES):
                    self._depot.hand_in(path, self._offsets[path], piece, _HAND_IN_TIMEOUT_S)
                    self._offsets[path] += len(piece)


def _below(folder: Path, path: str) -> Path:
    """A path in a folder; raises RunError for one that leads out of it."""
    target = (folder / path).resolve()
    if not target.is_relative_to(folder.resolve()):
        raise RunError(f"{path}: leads out of the folder of the run")
    return target


if __name__ == "__main__":
    main()
