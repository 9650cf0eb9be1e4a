"""Starts nodes through a fork server, which has imported what they need (`runtime.fork_server`)."""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import IO

from mast_zenoh.errors import StartError
from mast_zenoh.runtime.fork_server import MAX_REQUEST, ROOM

_END_S = 5.0  # for the server to tell an exit code, or to leave


def is_available() -> bool:
    """Whether this system can tell when a process ends that is not a child of the launcher."""
    try:
        os.close(os.pidfd_open(os.getpid()))
    except (AttributeError, OSError):  # another system, or a container that forbids it
        return False
    return True


class ForkServer:
    """A process that forks nodes; closing it leaves those that run.

    environment: of the server and of its nodes
    """

    def __init__(self, environment: dict[str, str]) -> None:
        self._socket, its = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._lock = threading.Lock()
        self._exits: dict[int, int] = {}
        with its:
            command = [sys.executable, "-P", "-m", "mast_zenoh.runtime.fork_server", ROOM]
            self._process = subprocess.Popen(
                command, stdin=its.fileno(), stdout=subprocess.DEVNULL, env=environment, start_new_session=True
            )

    def start(self, command: list[str], folder: Path, log: IO[bytes]) -> Forked:
        """Start a node; raises StartError if the server has ended."""
        theirs, ours = os.pipe()
        request = json.dumps({"command": command, "folder": str(folder)}).encode()
        with self._lock:
            try:
                socket.send_fds(self._socket, [request], [theirs, log.fileno()])
                while (node := self._receive()) is None:
                    pass
            except OSError as error:
                os.close(ours)
                raise StartError(f"the process that starts the nodes has ended: {error}") from None
            finally:
                os.close(theirs)
        return Forked(*node, os.fdopen(ours, "wb", buffering=0), self)

    def exit_of(self, pid: int) -> int | None:
        """The exit code of a node that has ended, once the server has told it; None if it does not."""
        deadline = time.monotonic() + _END_S
        with self._lock, contextlib.suppress(OSError):
            while pid not in self._exits:
                if not select.select([self._socket], [], [], max(0.0, deadline - time.monotonic()))[0]:
                    break
                self._receive()
        return self._exits.get(pid)

    def close(self) -> None:
        """End the server."""
        with self._lock:
            self._socket.close()
        try:
            self._process.wait(_END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def _receive(self) -> tuple[int, int] | None:
        """What the server tells next: (process id, descriptor) of a new node; None: an exit code, which is noted."""
        data, descriptors, _, _ = socket.recv_fds(self._socket, MAX_REQUEST, 1)
        if not data:
            raise ConnectionError("it has closed its socket")
        told: dict[str, int] = json.loads(data)
        if descriptors:
            return told["pid"], descriptors[0]
        self._exits[told["pid"]] = told["exit"]
        return None


class Forked:
    """A node's process, with what `subprocess.Popen` has of it.

    descriptor: of the process;  stdin: closed when the node is to leave
    """

    def __init__(self, pid: int, descriptor: int, stdin: IO[bytes], server: ForkServer) -> None:
        self.pid = pid
        self.stdin = stdin
        self.returncode: int | None = None
        self._server = server
        self._descriptor = descriptor

    def poll(self) -> int | None:
        """The exit code, negative for a signal; None while it runs."""
        return self._ended(0.0)

    def wait(self, timeout: float | None = None) -> int:
        """Wait for the end; returns the exit code. Raises subprocess.TimeoutExpired after `timeout` s."""
        code = self._ended(timeout)
        if code is None:
            raise subprocess.TimeoutExpired(f"process {self.pid}", timeout or 0.0)
        return code

    def send_signal(self, number: int) -> None:
        """Send a signal, unless it has ended."""
        if self.poll() is None:
            with contextlib.suppress(ProcessLookupError):
                signal.pidfd_send_signal(self._descriptor, number)

    def terminate(self) -> None:
        """Send SIGTERM."""
        self.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        """Send SIGKILL."""
        self.send_signal(signal.SIGKILL)

    def _ended(self, timeout: float | None) -> int | None:
        if self.returncode is None and select.select([self._descriptor], [], [], timeout)[0]:
            code = self._server.exit_of(self.pid)
            self.returncode = 1 if code is None else code  # the server has been killed: nobody knows
            os.close(self._descriptor)
        return self.returncode
