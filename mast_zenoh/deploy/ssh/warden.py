"""The supervisor of one run on one host: a process of its own, in a session of its own; a lost connection is nothing.

    python -m mast_zenoh.deploy.ssh.warden FOLDER PATIENCE      goes to the background when it is ready

It has one folder: `control` (its socket), logs/, tmp/NODE, and what the launcher puts there. Lines of JSON, both ways:

    {"as": "launcher", "logs": {name: offset}}    once, by who stays; logs go on from these offsets
    {"id", "do": "start", name, argv, env}        {"id", "do": "signal", names, number}
    {"id", "do": "end", grace_s}                  all go on that stand still; SIGTERM, and SIGKILL after the grace
    {"id", "do": "leave", grace_s}                the same, then it removes its folder and ends
    {"id", "do": "state"}                         {"do": "alive"}

    {"warden": pid}   {"answer": id, …}   {"node": name, "start": id, "pid", "exit"}   {"log": name, "offset", "text"}

A command with an id that it knows is answered and not done again: who has lost the connection asks again. It leaves by
itself when no sign of the launcher has come for PATIENCE seconds: neither a line, nor, from a node, the launcher's
liveliness token (a node keeps $TMPDIR/mast-up while it sees it). Its own death takes the nodes with it.
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
_PIECE = 1 << 16
_MOST_WAITING = 1 << 20  # bytes for one connection; logs wait beyond that


class Connection:
    """Somebody who is attached; offsets: how much of each log has been sent, for who wants logs."""

    def __init__(self, there: socket.socket) -> None:
        self.there = there
        self.received = b""
        self.waiting = b""
        self.launcher = False
        self.offsets: dict[str, int] | None = None

    def tell(self, said: dict[str, Any]) -> None:
        """Send, now or when there is room."""
        self.waiting += json.dumps(said).encode() + b"\n"


class Warden:
    """Holds the processes of a run on this host; works in its folder."""

    def __init__(self, folder: Path, patience_s: float) -> None:
        self.folder = folder
        self.patience_s = patience_s
        self.processes = HostProcesses(folder)
        self.answers: dict[str, dict[str, Any]] = {}
        self.connections: list[Connection] = []
        self.heard = self.touched = time.monotonic()
        self.ending: list[tuple[float, str]] = []  # when who still runs is killed, and which command is then answered
        self.leaving: str | None = None
        self.told_to_leave = False
        self.selector = selectors.DefaultSelector()
        self.listener = socket.socket(socket.AF_UNIX)
        self.listener.bind(CONTROL)
        self.listener.listen()
        self.listener.setblocking(False)
        self.selector.register(self.listener, selectors.EVENT_READ)

    def serve(self) -> None:
        """Until told to leave, or without a launcher for too long; then nothing is left of the folder."""
        reader, writer = os.pipe()
        os.set_blocking(writer, False)
        signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
        self.selector.register(reader, selectors.EVENT_READ)
        signal.signal(signal.SIGCHLD, lambda *_: None)
        signal.signal(signal.SIGHUP, signal.SIG_IGN)
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, lambda *_: setattr(self, "told_to_leave", True))
        try:
            while not self._left():
                for key, _ in self.selector.select(_TICK_S):
                    if key.fileobj is self.listener:
                        self._accept()
                    elif key.fileobj == reader:
                        os.read(reader, 4096)
                    else:
                        self._read(key.data)
                self._watch_launcher()
                self._end_who_is_late()
                self._tell_news()
        finally:
            self.processes.kill()
            shutil.rmtree(self.folder, ignore_errors=True)
            with contextlib.suppress(OSError):
                self.folder.parent.rmdir()  # by whoever is the last

    # -- who is attached -----------------------------------------------------------------------------------------

    def _accept(self) -> None:
        there, _ = self.listener.accept()
        there.setblocking(False)
        connection = Connection(there)
        self.connections.append(connection)
        self.selector.register(there, selectors.EVENT_READ, connection)

    def _read(self, connection: Connection) -> None:
        try:
            received = connection.there.recv(_PIECE)
        except BlockingIOError:
            return
        except OSError:
            received = b""
        if not received:
            self._drop(connection)
            return
        *lines, connection.received = (connection.received + received).split(b"\n")
        for line in lines:
            self._heard(connection, json.loads(line))

    def _drop(self, connection: Connection) -> None:
        if connection in self.connections:
            self.connections.remove(connection)
            self.selector.unregister(connection.there)
            connection.there.close()

    def _heard(self, connection: Connection, said: dict[str, Any]) -> None:
        if "as" in said:
            for other in [each for each in self.connections if each.launcher and said["as"] == "launcher"]:
                self._drop(other)  # of a connection that is lost, which this side may learn much later
            connection.launcher = said["as"] == "launcher"
            connection.offsets = said["logs"]
            connection.tell({"warden": os.getpid()})
            for state in self.processes.states():
                connection.tell(state)
        if connection.launcher:
            self.heard = time.monotonic()
        if "id" not in said:
            return
        if said["do"] == "state":
            self._tell_logs(connection, math.inf)  # who asks for both wants the logs up to now
        if said["id"] in self.answers:
            connection.tell(self.answers[said["id"]])
        elif (answer := self._do(said)) is not None:
            self._answer(said["id"], answer)

    def _answer(self, which: str, answer: dict[str, Any]) -> None:
        self.answers[which] = {"answer": which, **answer}
        for connection in self.connections:
            connection.tell(self.answers[which])

    # -- what is done --------------------------------------------------------------------------------------------

    def _do(self, said: dict[str, Any]) -> dict[str, Any] | None:
        """What is answered; None for what takes its time."""
        if said["do"] == "start":
            return self.processes.start(said["name"], said["id"], said["argv"], said["env"])
        if said["do"] == "signal":
            self.processes.signal(said["number"], said["names"])
        elif said["do"] in ("end", "leave"):
            if said["do"] == "leave":
                self.leaving = said["id"]
            self._end(said["grace_s"], said["id"])
            return None
        return {"nodes": self.processes.states()}

    def _end(self, grace_s: float, which: str) -> None:
        self.processes.signal(signal.SIGCONT)
        self.processes.signal(signal.SIGTERM)
        self.ending.append((time.monotonic() + grace_s, which))

    def _end_who_is_late(self) -> None:
        for due, which in list(self.ending):
            if self.processes.running():
                if time.monotonic() <= due:
                    continue
                self.processes.kill()
            self.ending.remove((due, which))
            self._tell_news()  # how they have ended, and their last words, before the answer
            self._answer(which, {})

    def _watch_launcher(self) -> None:
        now = time.monotonic()
        if now - self.touched > _TOUCH_EVERY_S:
            self.touched = now
            os.utime(CONTROL)
        if self.processes.see_launcher():
            self.heard = now
        if self.leaving is None and (self.told_to_leave or now - self.heard > self.patience_s):
            self.leaving = "by itself"
            self._end(_LAST_GRACE_S, self.leaving)

    def _left(self) -> bool:
        """Whether it may go: all have ended, and who is attached has been told so, or does not listen."""
        return (
            self.leaving is not None and self.leaving in self.answers and not any(c.waiting for c in self.connections)
        )

    # -- what is told --------------------------------------------------------------------------------------------

    def _tell_news(self) -> None:
        ended = self.processes.newly_ended()
        for connection in list(self.connections):
            self._tell_logs(connection, _MOST_WAITING)
            for node in ended:
                connection.tell(node.state())
            try:
                while connection.waiting:
                    connection.waiting = connection.waiting[connection.there.send(connection.waiting) :]
            except BlockingIOError:
                pass
            except OSError:
                self._drop(connection)
        for node in ended:
            node.told = True

    def _tell_logs(self, connection: Connection, most: float) -> None:
        """What has been written since, of each in turn, as long as no more than so many bytes wait."""
        if connection.offsets is None:
            return
        more = self.processes.names()
        while more and len(connection.waiting) < most:
            more = {name for name in more if self._tell_log(connection, connection.offsets, name)}

    def _tell_log(self, connection: Connection, offsets: dict[str, int], name: str) -> bool:
        offset = offsets.get(name, 0)
        with (self.folder / "logs" / f"{name}.log").open("rb") as file:
            file.seek(offset)
            piece = file.read(_PIECE)
        if piece:
            connection.tell({"log": name, "offset": offset, "text": piece.decode("latin-1")})  # a character a byte
            offsets[name] = offset + len(piece)
        return bool(piece)


def serve(folder: Path, patience_s: float) -> None:
    """Make the folder, listen, and go on in the background."""
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
    warden.selector.close()  # of the process that has gone: its epoll is not ours
    warden.selector = selectors.DefaultSelector()
    warden.selector.register(warden.listener, selectors.EVENT_READ)
    warden.serve()


if __name__ == "__main__":
    serve(Path(sys.argv[1]), float(sys.argv[2]))
