"""The supervisor of a run on a host: a process that survives a lost connection.

    python -m mast_zenoh.deploy.ssh.warden FOLDER PATIENCE      goes to the background when it is ready

It has one folder: `control` (its socket), logs/, tmp/NODE, and the launcher's files. Lines of JSON, both ways:

    {"as": "launcher", "logs": {name: offset}}    once, by a client that stays; logs continue at these offsets
    {"id", "do": "start", name, argv, env}        {"id", "do": "signal", names, number}
    {"id", "do": "end", grace_s}                  resume stopped nodes; SIGTERM, and SIGKILL after the grace period
    {"id", "do": "leave", grace_s}                the same, then it removes its folder and ends
    {"id", "do": "state"}                         answer with the states of all nodes, after the logs written so far
    {"do": "alive"}                               the launcher is still there; no answer

    {"warden": pid}   {"answer": id, …}   {"node": name, "start": id, "pid", "exit"}   {"log": name, "offset", "text"}

A command with a known id is answered but not repeated: a launcher that lost the connection sends it again. The warden
exits on its own after PATIENCE seconds without a sign of the launcher: no line, and no node that sees its liveliness
token (a node keeps $TMPDIR/mast-up while it sees it). If the warden dies, its nodes die too.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import selectors
import shutil
import signal
import socket
import sys
import time
from pathlib import Path
from typing import Any

from mast_zenoh.deploy.ssh.host_processes import HostProcesses

CONTROL = "control"

_TICK_S = 0.2
_TOUCH_EVERY_S = 15.0
_LAST_GRACE_S = 3.0
_OWN_DECISION = "by itself"  # in place of the id of a leave command
_CHUNK_BYTES = 1 << 16
_MAX_QUEUED = 1 << 20  # bytes for one connection; beyond that, logs wait


class Connection:
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
        self.processes = HostProcesses(folder)
        self.answers: dict[str, dict[str, Any]] = {}
        self.connections: list[Connection] = []
        self.last_sign = self.last_touch = time.monotonic()
        self.ending: list[tuple[float, str]] = []  # (deadline, id of the command to answer)
        self.leave_command: str | None = None
        self.leave_requested = False
        self.selector = selectors.DefaultSelector()
        self.listener = socket.socket(socket.AF_UNIX)
        self.listener.bind(CONTROL)
        self.listener.listen()
        self.listener.setblocking(False)
        self.selector.register(self.listener, selectors.EVENT_READ)

    def serve(self) -> None:
        """Serve until a leave command, SIGTERM, SIGINT or the loss of the launcher.

        Then remove the folder.
        """
        reader, writer = os.pipe()
        os.set_blocking(writer, False)
        signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
        self.selector.register(reader, selectors.EVENT_READ)
        signal.signal(signal.SIGCHLD, lambda *_: None)
        signal.signal(signal.SIGHUP, signal.SIG_IGN)
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, lambda *_: setattr(self, "leave_requested", True))
        try:
            while not self._may_exit():
                for key, _ in self.selector.select(_TICK_S):
                    if key.fileobj is self.listener:
                        self._accept()
                    elif key.fileobj == reader:
                        os.read(reader, 4096)
                    else:
                        self._read(key.data)
                self._watch_launcher()
                self._kill_overdue()
                self._send_updates()
        finally:
            self.processes.kill()
            shutil.rmtree(self.folder, ignore_errors=True)
            with contextlib.suppress(OSError):
                self.folder.parent.rmdir()  # succeeds only for the last warden of the run

    # -- clients -------------------------------------------------------------------------------------------------

    def _accept(self) -> None:
        client, _ = self.listener.accept()
        client.setblocking(False)
        connection = Connection(client)
        self.connections.append(connection)
        self.selector.register(client, selectors.EVENT_READ, connection)

    def _read(self, connection: Connection) -> None:
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

    def _drop(self, connection: Connection) -> None:
        if connection in self.connections:
            self.connections.remove(connection)
            self.selector.unregister(connection.client)
            connection.client.close()

    def _handle(self, connection: Connection, message: dict[str, Any]) -> None:
        if "as" in message:
            for other in [client for client in self.connections if client.is_launcher and message["as"] == "launcher"]:
                self._drop(other)  # an old connection, whose loss this side has not noticed yet
            connection.is_launcher = message["as"] == "launcher"
            connection.offsets = message["logs"]
            connection.send({"warden": os.getpid()})
            for state in self.processes.states():
                connection.send(state)
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
            return self.processes.start(command["name"], command["id"], command["argv"], command["env"])
        if command["do"] == "signal":
            self.processes.signal(command["number"], command["names"])
        elif command["do"] in ("end", "leave"):
            if command["do"] == "leave":
                self.leave_command = command["id"]
            self._end(command["grace_s"], command["id"])
            return None
        return {"nodes": self.processes.states()}

    def _end(self, grace_s: float, command_id: str) -> None:
        self.processes.signal(signal.SIGCONT)
        self.processes.signal(signal.SIGTERM)
        self.ending.append((time.monotonic() + grace_s, command_id))

    def _kill_overdue(self) -> None:
        for due, command_id in list(self.ending):
            if self.processes.running():
                if time.monotonic() <= due:
                    continue
                self.processes.kill()
            self.ending.remove((due, command_id))
            self._send_updates()  # exit codes and last logs come before the answer
            self._answer(command_id, {})

    def _watch_launcher(self) -> None:
        now = time.monotonic()
        if now - self.last_touch > _TOUCH_EVERY_S:
            self.last_touch = now
            os.utime(CONTROL)
        if self.processes.see_launcher():
            self.last_sign = now
        if self.leave_command is None and (self.leave_requested or now - self.last_sign > self.patience_s):
            self.leave_command = _OWN_DECISION
            self._end(_LAST_GRACE_S, self.leave_command)

    def _may_exit(self) -> bool:
        """Whether it may exit: processes have ended, clients have received their messages."""
        return (
            self.leave_command is not None
            and self.leave_command in self.answers
            and not any(c.queued for c in self.connections)
        )

    # -- messages to clients -------------------------------------------------------------------------------------

    def _send_updates(self) -> None:
        ended = self.processes.newly_ended()
        for connection in list(self.connections):
            self._queue_logs(connection, _MAX_QUEUED)
            for node in ended:
                connection.send(node.state())
            try:
                while connection.queued:
                    connection.queued = connection.queued[connection.client.send(connection.queued) :]
            except BlockingIOError:
                pass
            except OSError:
                self._drop(connection)
        for node in ended:
            node.reported = True

    def _queue_logs(self, connection: Connection, max_queued: float) -> None:
        """Queue new output of all processes in turn, up to `max_queued` queued bytes."""
        if connection.offsets is None:
            return
        names = self.processes.names()
        while names and len(connection.queued) < max_queued:
            names = {name for name in names if self._queue_log(connection, connection.offsets, name)}

    def _queue_log(self, connection: Connection, offsets: dict[str, int], name: str) -> bool:
        offset = offsets.get(name, 0)
        with (self.folder / "logs" / f"{name}.log").open("rb") as file:
            file.seek(offset)
            chunk = file.read(_CHUNK_BYTES)
        if chunk:
            connection.send({"log": name, "offset": offset, "text": chunk.decode("latin-1")})  # one character per byte
            offsets[name] = offset + len(chunk)
        return bool(chunk)


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
    warden.selector.close()  # the parent's epoll descriptor cannot be reused
    warden.selector = selectors.DefaultSelector()
    warden.selector.register(warden.listener, selectors.EVENT_READ)
    warden.serve()


if __name__ == "__main__":
    serve(Path(sys.argv[1]), float(sys.argv[2]))
