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
import time
from pathlib import Path
from typing import Any

CONTROL = "control"


_UP = "mast-up"  # as mast_zenoh.runtime.elsewhere touches it; that module is not imported: this process stays small
_TICK_S = 0.2
_TOUCH_EVERY_S = 15.0
_LAST_GRACE_S = 3.0
_PIECE = 1 << 16
_DRAIN_S = 5.0  # for who is attached to hear the last of it
_MOST_WAITING = 1 << 20  # bytes for one connection; logs wait beyond that
_PR_SET_PDEATHSIG = 1


class Node:
    """A process; start: id of the command that has started it."""

    def __init__(self, name: str, start: str, process: subprocess.Popen[bytes]) -> None:
        self.name = name
        self.start = start
        self.process = process
        self.told = False

    def state(self) -> dict[str, Any]:
        """As it is told."""
        return {"node": self.name, "start": self.start, "pid": self.process.pid, "exit": self.process.poll()}


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
        self.nodes: dict[str, Node] = {}
        self.answers: dict[str, dict[str, Any]] = {}
        self.connections: list[Connection] = []
        self.heard = self.touched = time.monotonic()
        self.ending: list[tuple[float, str]] = []  # when who still runs is killed, and which command is then answered
        self.leaving: str | None = None
        self.left_at = 0.0
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
            self._signal(self.nodes.values(), signal.SIGKILL)
            for node in self.nodes.values():
                node.process.wait()
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
            for node in self.nodes.values():
                connection.tell(node.state())
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
            return self._start(said)
        if said["do"] == "signal":
            self._signal([self.nodes[name] for name in said["names"] if name in self.nodes], said["number"])
        elif said["do"] in ("end", "leave"):
            if said["do"] == "leave":
                self.leaving = said["id"]
            self._end(said["grace_s"], said["id"])
            return None
        return {"nodes": [node.state() for node in self.nodes.values()]}

    def _start(self, said: dict[str, Any]) -> dict[str, Any]:
        name = said["name"]
        before = self.nodes.get(name)
        if before is not None and before.process.poll() is None:
            return {"error": f"{name} runs already"}
        own = self.folder / "tmp" / name
        shutil.rmtree(own, ignore_errors=True)  # of one that was killed
        own.mkdir(parents=True)
        with (self.folder / "logs" / f"{name}.log").open("ab") as log:
            try:
                process = subprocess.Popen(
                    said["argv"],
                    stdin=subprocess.DEVNULL,
                    stdout=log,
                    stderr=log,
                    cwd=self.folder,
                    env={**os.environ, **said["env"], "TMPDIR": str(own)},
                    start_new_session=True,
                    preexec_fn=_die_with_parent,  # this process has one thread
                )
            except OSError as error:
                return {"error": f"{name}: {error}"}
        self.nodes[name] = Node(name, said["id"], process)
        return {"pid": process.pid}

    def _signal(self, nodes: Any, number: int) -> None:
        for node in nodes:
            if node.process.poll() is None:
                node.process.send_signal(number)

    def _end(self, grace_s: float, which: str) -> None:
        self._signal(self.nodes.values(), signal.SIGCONT)
        self._signal(self.nodes.values(), signal.SIGTERM)
        self.ending.append((time.monotonic() + grace_s, which))

    def _end_who_is_late(self) -> None:
        for due, which in list(self.ending):
            running = [node for node in self.nodes.values() if node.process.poll() is None]
            if running and time.monotonic() > due:
                self._signal(running, signal.SIGKILL)
                for node in running:
                    node.process.wait()
            if not running or time.monotonic() > due:
                self.ending.remove((due, which))
                self._tell_news()  # how they have ended, and their last words, before the answer
                self._answer(which, {})

    def _watch_launcher(self) -> None:
        now = time.monotonic()
        if now - self.touched > _TOUCH_EVERY_S:
            self.touched = now
            os.utime(CONTROL)
        for node in self.nodes.values():
            if (self.folder / "tmp" / node.name / _UP).exists() and _moves(node.process):
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
        ended = [node for node in self.nodes.values() if not node.told and node.process.poll() is not None]
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
        more = set(self.nodes)
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


def _moves(process: subprocess.Popen[bytes]) -> bool:
    """Whether a process runs and does not stand still: who does sees nothing (proc(5), field 3 of stat)."""
    if process.poll() is not None:
        return False
    try:
        return Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()[0] != "T"
    except OSError:
        return True


def _die_with_parent() -> None:
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, int(signal.SIGKILL), 0, 0, 0)


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
