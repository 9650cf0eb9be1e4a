"""Starts nodes through a fork server, which has imported what they need (`launch.fork_server`)."""

from __future__ import annotations

import contextlib
import ctypes
import json
import os
import select
import signal
import socket
import subprocess
import sys
import threading
import weakref
from pathlib import Path
from typing import IO

from mast_zenoh.errors import StartError

#: s, for the server to import everything and to answer, and for it to leave.
_START_S, _END_S = 30.0, 5.0
#: An argument of the server, as long as any node's command, which a node writes in its place.
_ROOM = " " * (1 << 14)
_PR_SET_CHILD_SUBREAPER = 36  # of prctl(2): orphans among the descendants of this process become its children


def is_available() -> bool:
    """Whether this process can adopt others, and wait for them with a time limit."""
    try:
        os.close(os.pidfd_open(os.getpid()))
    except (AttributeError, OSError):  # another system, or a container that forbids it
        return False
    return signal.getsignal(signal.SIGCHLD) != signal.SIG_IGN  # which would lose their exit codes


class ForkServer:
    """A process that forks nodes; closing it leaves those that run.

    environment: of the server and of its nodes
    """

    def __init__(self, environment: dict[str, str]) -> None:
        self._socket, server_end = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._lock = threading.Lock()
        self._socket.settimeout(_START_S)
        ctypes.CDLL(None).prctl(_PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
        with server_end:
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", "mast_zenoh.launch.fork_server", _ROOM],
                stdin=server_end.fileno(),
                stdout=subprocess.DEVNULL,
                stderr=None if sys.__stderr__ else subprocess.DEVNULL,  # nodes need one, even if this process has none
                env=environment,
                start_new_session=True,
            )

    def start(self, command: list[str], folder: Path, log: IO[bytes]) -> Forked:
        """Start a node; raises StartError if the server has ended, or does not answer."""
        node_stdin, stdin = os.pipe()
        request = json.dumps({"command": command, "folder": str(folder)}).encode()
        with self._lock:
            try:
                socket.send_fds(self._socket, [request], [node_stdin, log.fileno()])
                answer = self._socket.recv(16)
            except OSError as error:
                self._socket.close()  # a late answer would be taken for that of the next request
                os.close(stdin)
                raise StartError(f"the process that starts the nodes has ended, or does not answer: {error}") from None
            finally:
                os.close(node_stdin)
        if not answer:
            os.close(stdin)
            raise StartError("the process that starts the nodes has ended")
        return Forked(int(answer), os.fdopen(stdin, "wb", buffering=0))

    def close(self) -> None:
        """End the server."""
        with self._lock:
            self._socket.close()
        try:
            self._process.wait(_END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


class Forked:
    """A forked node, with the part of the interface of `subprocess.Popen` that supervisors use.

    pid: of a child of this process;  stdin: closed when the node is to leave
    """

    def __init__(self, pid: int, stdin: IO[bytes]) -> None:
        self.pid = pid
        self.stdin = stdin
        self.returncode: int | None = None
        self._lock = threading.Lock()
        self._descriptor = os.pidfd_open(pid)
        weakref.finalize(self, os.close, self._descriptor)

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
            with self._lock:
                if self.returncode is None:
                    self.returncode = os.waitstatus_to_exitcode(os.waitpid(self.pid, 0)[1])
        return self.returncode
