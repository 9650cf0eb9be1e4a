"""The supervisor of a run on a host: a process that survives a lost connection.

    python -m mast_zenoh.deploy.ssh.warden FOLDER PATIENCE      goes to the background when it is ready
    python -m mast_zenoh.deploy.ssh.warden FOLDER               connects standard input and output with its socket

It has one folder: `control` (its socket), logs/, tmp/NODE, and the launcher's files. Lines of JSON, both ways:

    {"as": "launcher", "logs": {name: offset}}    once, by a client that stays; logs continue at these offsets
    {"id", "do": "start", name, argv, env}        {"id", "do": "signal", names, number}
    {"id", "do": "leave", grace_s}                resume stopped nodes; SIGTERM, and SIGKILL after the grace period;
                                                  then it removes its folder and ends
    {"id", "do": "state"}                         answer with the states of all nodes, after the logs written so far
    {"do": "alive"}                               the launcher is still there; no answer

    {"warden": pid}   {"answer": id, …}   {"node": name, "start": id, "pid", "exit", "cpu_s"}
    {"log": name, "offset", "text"}

A command with a known id is answered but not repeated: a launcher that lost the connection sends it again. The warden
exits on its own after PATIENCE seconds without a sign of the launcher: no line, and no node that sees its liveliness
token (a node keeps $TMPDIR/mast-up while it sees it). If the warden dies, its nodes die too. It imports nothing slow or
large.
"""

from __future__ import annotations

import contextlib
import ctypes
import json
import math
import os
import selectors
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from mast_zenoh.launch.liveness import processor_time_s, stat_of

NOT_THERE = 7  #: exit code of a client if no warden answers

_CONTROL = "control"
_UP = "mast-up"  # mast_zenoh.mesh.hosting.UP; that module is not imported: the warden stays small
_TICK_S = 0.2
_TOUCH_EVERY_S = 15.0
_STATES_EVERY_S = 2.0
_LAST_GRACE_S = 3.0
_OWN_DECISION = "by itself"  # in place of the id of a leave command
_CHUNK_BYTES = 1 << 16
_MAX_QUEUED = 1 << 20  # bytes for one connection; beyond that, logs wait
_PR_SET_PDEATHSIG = 1


class NodeProcess:
    """The process of a node.

    start: id of the command that started it;  reported: whether its end has been reported to the launcher
    """

    def __init__(self, name: str, start: str, process: subprocess.Popen[bytes]) -> None:
        self.name = name
        self.start = start
        self.process = process
        self.reported = False

    @property
    def runs(self) -> bool:
        """Whether it is running."""
        return self.process.poll() is None

    @property
    def is_stopped(self) -> bool:
        """Whether a signal has stopped it."""
        return stat_of(self.process.pid)[:1] == ["T"]

    def state(self) -> dict[str, Any]:
        """Its state, in the form for the launcher."""
        pid = self.process.pid
        cpu_s = processor_time_s(pid)
        return {"node": self.name, "start": self.start, "pid": pid, "exit": self.process.poll(), "cpu_s": cpu_s}


class ConnectedClient:
    """A connected client; offsets: how much of each log was sent; None if it reads no logs."""

    def __init__(self, client: socket.socket) -> None:
        self.client = client
        self.received = b""
        self.queued = b""
        self.is_launcher = False
        self.offsets: dict[str, int] | None = None

    def send(self, message: dict[str, Any]) -> None:
        """Queue a message."""
        self.queued += json.dumps(message).encode() + b"\n"


class Warden:
    """Supervises the processes of a run on this host; works in its folder."""

    def __init__(self, folder: Path, patience_s: float) -> None:
        self.folder = folder
        self.patience_s = patience_s
        self.nodes: dict[str, NodeProcess] = {}
        self.answers: dict[str, dict[str, Any]] = {}
        self.connections: list[ConnectedClient] = []
        self.last_sign = self.last_touch = self.last_states = time.monotonic()
        self.leaves: dict[str, float] = {}  # by id of a leave command, when its nodes are killed
        self.has_left = False
        self.leave_requested = False
        self.listener = socket.socket(socket.AF_UNIX)
        self.listener.bind(_CONTROL)
        self.listener.listen()
        self.listener.setblocking(False)

    def serve(self) -> None:
        """Serve until a leave command, SIGTERM, SIGINT or the loss of the launcher.

        Then remove the folder.
        """
        reader, writer = os.pipe()
        os.set_blocking(writer, False)
        signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
        self.selector = selectors.DefaultSelector()  # of this process: a parent's descriptor cannot be used
        self.selector.register(self.listener, selectors.EVENT_READ)
        self.selector.register(reader, selectors.EVENT_READ)
        signal.signal(signal.SIGCHLD, lambda *_: None)
        signal.signal(signal.SIGHUP, signal.SIG_IGN)
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, lambda *_: setattr(self, "leave_requested", True))
        try:
            while not self.has_left or any(connection.queued for connection in self.connections):
                for key, _ in self.selector.select(_TICK_S):
                    if key.fileobj is self.listener:
                        self._accept()
                    elif key.fileobj == reader:
                        os.read(reader, 4096)
                    else:
                        self._read(key.data)
                self._watch_launcher()
                self._finish_leaving()
                self._send_updates()
        finally:
            self._kill()
            shutil.rmtree(self.folder, ignore_errors=True)
            with contextlib.suppress(OSError):
                self.folder.parent.rmdir()  # succeeds only for the last warden of the run

    # -- clients -------------------------------------------------------------------------------------------------

    def _accept(self) -> None:
        client, _ = self.listener.accept()
        client.setblocking(False)
        connection = ConnectedClient(client)
        self.connections.append(connection)
        self.selector.register(client, selectors.EVENT_READ, connection)

    def _read(self, connection: ConnectedClient) -> None:
        try:
            received = connection.client.recv(_CHUNK_BYTES)
        except BlockingIOError:
            return
        except OSError:
            received = b""
        if not received:
            self._drop(connection)
            return
        *lines, connection.received = (connection.received + received).split(b"\n")
        for line in lines:
            self._handle(connection, json.loads(line))

    def _drop(self, connection: ConnectedClient) -> None:
        if connection in self.connections:
            self.connections.remove(connection)
            self.selector.unregister(connection.client)
            connection.client.close()

    def _handle(self, connection: ConnectedClient, message: dict[str, Any]) -> None:
        if "as" in message:
            for other in [client for client in self.connections if client.is_launcher and message["as"] == "launcher"]:
                self._drop(other)  # an old connection, whose loss this side has not noticed yet
            connection.is_launcher = message["as"] == "launcher"
            connection.offsets = message["logs"]
            connection.send({"warden": os.getpid()})
            for node in self.nodes.values():
                connection.send(node.state())
        if connection.is_launcher:
            self.last_sign = time.monotonic()
        if "id" not in message:
            return
        if message["do"] == "state":
            self._queue_logs(connection, math.inf)  # this client first gets all logs written so far
        if message["id"] in self.answers:
            connection.send(self.answers[message["id"]])
        elif (answer := self._do(message)) is not None:
            self._answer(message["id"], answer)

    def _answer(self, command_id: str, answer: dict[str, Any]) -> None:
        self.answers[command_id] = {"answer": command_id, **answer}
        for connection in self.connections:
            connection.send(self.answers[command_id])

    # -- commands ------------------------------------------------------------------------------------------------

    def _do(self, command: dict[str, Any]) -> dict[str, Any] | None:
        """Carry out a command; returns the answer, None if it comes later."""
        if command["do"] == "start":
            return self._start(command["name"], command["id"], command["argv"], command["env"])
        if command["do"] == "signal":
            self._signal(command["number"], command["names"])
        elif command["do"] == "leave":
            self._leave(command["id"], command["grace_s"])
            return None
        return {"nodes": [node.state() for node in self.nodes.values()]}

    def _start(self, name: str, command: str, argv: list[str], env: dict[str, str]) -> dict[str, Any]:
        """Start a node's process on the launcher's command; returns its pid or an error."""
        if name in self.nodes and self.nodes[name].runs:
            return {"error": f"{name} is already running"}
        temporary_folder = self.folder / "tmp" / name
        shutil.rmtree(temporary_folder, ignore_errors=True)  # left by a killed process
        temporary_folder.mkdir(parents=True)
        with (self.folder / "logs" / f"{name}.log").open("ab") as log:
            try:
                process = subprocess.Popen(
                    argv,
                    stdin=subprocess.DEVNULL,
                    stdout=log,
                    stderr=log,
                    cwd=self.folder,
                    env={**os.environ, **env, "TMPDIR": str(temporary_folder)},
                    start_new_session=True,
                    preexec_fn=_die_with_parent,  # this process has one thread
                )
            except OSError as error:
                return {"error": f"{name}: {error}"}
        self.nodes[name] = NodeProcess(name, command, process)
        return {"pid": process.pid}

    def _signal(self, number: int, names: Iterable[str] | None = None) -> None:
        """Send a signal to the running ones of these nodes; None: to all running nodes."""
        for name in self.nodes if names is None else names:
            if name in self.nodes and self.nodes[name].runs:
                self.nodes[name].process.send_signal(number)

    def _kill(self) -> None:
        self._signal(signal.SIGKILL)
        for node in self.nodes.values():
            node.process.wait()

    def _leave(self, command_id: str, grace_s: float) -> None:
        self._signal(signal.SIGCONT)
        self._signal(signal.SIGTERM)
        self.leaves[command_id] = time.monotonic() + grace_s

    def _finish_leaving(self) -> None:
        runs = any(node.runs for node in self.nodes.values())
        if not self.leaves or (runs and time.monotonic() <= min(self.leaves.values())):
            return
        self._kill()
        self._send_updates()  # exit codes and last logs come before the answer
        for command_id in self.leaves:
            self._answer(command_id, {})
        self.leaves.clear()
        self.has_left = True

    def _watch_launcher(self) -> None:
        now = time.monotonic()
        if now - self.last_touch > _TOUCH_EVERY_S:
            self.last_touch = now
            os.utime(_CONTROL)
        if any(
            (self.folder / "tmp" / node.name / _UP).exists() and node.runs and not node.is_stopped
            for node in self.nodes.values()
        ):
            self.last_sign = now
        if not self.leaves and (self.leave_requested or now - self.last_sign > self.patience_s):
            self._leave(_OWN_DECISION, _LAST_GRACE_S)

    # -- messages to clients -------------------------------------------------------------------------------------

    def _send_updates(self) -> None:
        ended = [node for node in self.nodes.values() if not node.reported and not node.runs]
        states = [node.state() for node in ended]
        if time.monotonic() - self.last_states >= _STATES_EVERY_S:  # with what each has computed since
            self.last_states = time.monotonic()
            states += [node.state() for node in self.nodes.values() if node.runs]
        for connection in list(self.connections):
            self._queue_logs(connection, _MAX_QUEUED)
            for state in states if len(connection.queued) < _MAX_QUEUED else ():
                connection.send(state)
            try:
                while connection.queued:
                    connection.queued = connection.queued[connection.client.send(connection.queued) :]
            except BlockingIOError:
                pass
            except OSError:
                self._drop(connection)
        for node in ended:
            node.reported = True

    def _queue_logs(self, connection: ConnectedClient, max_queued: float) -> None:
        """Queue new output of all processes in turn, up to `max_queued` queued bytes."""
        if connection.offsets is None:
            return
        names = set(self.nodes)
        while names and len(connection.queued) < max_queued:
            names = {name for name in names if self._queue_log(connection, connection.offsets, name)}

    def _queue_log(self, connection: ConnectedClient, offsets: dict[str, int], name: str) -> bool:
        offset = offsets.get(name, 0)
        with (self.folder / "logs" / f"{name}.log").open("rb") as file:
            file.seek(offset)
            chunk = file.read(_CHUNK_BYTES)
        if chunk:
            connection.send({"log": name, "offset": offset, "text": chunk.decode("latin-1")})  # one character per byte
            offsets[name] = offset + len(chunk)
        return bool(chunk)


def _die_with_parent() -> None:
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, int(signal.SIGKILL), 0, 0, 0)


def serve(folder: Path, patience_s: float) -> None:
    """Make the folder, listen, and continue in the background."""
    os.umask(0o077)  # its nodes inherit it
    folder.parent.mkdir(mode=0o700, exist_ok=True)
    folder.mkdir(mode=0o700)
    (folder / "logs").mkdir()
    os.chdir(folder)
    warden = Warden(folder, patience_s)
    if os.fork():
        os._exit(0)
    os.setsid()
    if os.fork():
        os._exit(0)
    with (folder / "logs" / "@warden.log").open("ab") as log:
        null = os.open(os.devnull, os.O_RDWR)
        for handle, target in ((0, null), (1, log.fileno()), (2, log.fileno())):
            os.dup2(target, handle)
        os.close(null)
    warden.serve()


def attach(folder: Path) -> None:
    """Relay between standard input and output and a warden's socket, until either side ends."""
    warden = socket.socket(socket.AF_UNIX)
    try:
        os.chdir(folder)  # the path of a socket is limited in length
        warden.connect(_CONTROL)
    except OSError:
        sys.stderr.write(f"no supervisor of this run at {folder}\n")
        sys.exit(NOT_THERE)

    def relay(read: Callable[[int], bytes], write: Callable[[bytes], None]) -> None:
        with contextlib.suppress(OSError):
            while piece := read(_CHUNK_BYTES):
                write(piece)
        os._exit(0)

    def to_output(piece: bytes) -> None:
        sys.stdout.buffer.write(piece)
        sys.stdout.buffer.flush()

    threading.Thread(target=relay, args=(lambda size: os.read(0, size), warden.sendall)).start()
    relay(warden.recv, to_output)


if __name__ == "__main__":
    place, *patience = sys.argv[1:]
    if patience:
        serve(Path(place), float(patience[0]))
    else:
        attach(Path(place))
