"""The nodes of a run as processes of this machine, forked from a process that has imported what they need."""

from __future__ import annotations

import contextlib
import ctypes
import json
import os
import secrets
import select
import signal
import socket
import subprocess
import sys
import threading
import time
import weakref
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import IO, Any

from mast_zenoh.config.resolved import NodeSpec
from mast_zenoh.errors import ConfigurationError, StartError, VersionMismatch
from mast_zenoh.launch.liveness import processor_time_s
from mast_zenoh.launch.supervisor import Child, Supervisor
from mast_zenoh.mesh.hosting import RUN, end_strays
from mast_zenoh.version import version_string

#: s, for the server to import everything and to answer, and for it to leave.
_START_S, _END_S = 30.0, 5.0
#: An argument of the server, as long as any node's command, which a node writes in its place.
_ROOM = " " * (1 << 14)
_PR_SET_CHILD_SUBREAPER = 36  # of prctl(2): orphans among the descendants of this process become its children


def can_fork_nodes() -> bool:
    """Whether this process can adopt others, and wait for them with a time limit."""
    try:
        os.close(os.pidfd_open(os.getpid()))
    except (AttributeError, OSError):  # another system, or a container that forbids it
        return False
    return signal.getsignal(signal.SIGCHLD) != signal.SIG_IGN  # which would lose their exit codes


def end_process(process: subprocess.Popen[bytes], seconds: float) -> None:
    """Wait for the end of a process; kill it after some seconds, or at Ctrl-C."""
    try:
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(seconds)
    finally:
        if process.poll() is None:
            process.kill()
            process.wait()


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
        end_process(self._process, _END_S)


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
                    with contextlib.suppress(OSError):  # its group has no other processes: it is their session's leader
                        os.killpg(self.pid, signal.SIGKILL)
                    self.returncode = os.waitstatus_to_exitcode(os.waitpid(self.pid, 0)[1])
        return self.returncode


#: One thread per node: many small arrays gain nothing from more, and the nodes share the machine.
ENVIRONMENT = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")

_NODE = [sys.executable, "-P", "-m", "mast_zenoh.mesh"]  # -P: nothing from the working directory


#: s, in which an interpreter tells which mast-zenoh it has.
_TELL_S = 60.0


def check_interpreters(nodes: Mapping[str, NodeSpec]) -> None:
    """Ask the interpreters that nodes have of their own which mast-zenoh they import.

    Raises ConfigurationError for one without it, VersionMismatch for one with another.
    """
    for python, name in {spec.python: name for name, spec in nodes.items() if spec.python}.items():
        tell = "from mast_zenoh.mesh import hosting; from mast_zenoh import version; print(version.version_string())"
        try:
            answer = subprocess.run(
                [python, "-P", "-c", tell], stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=_TELL_S
            )
        except (OSError, subprocess.TimeoutExpired) as error:
            raise ConfigurationError(f"{name}.python: {python} cannot be used: {error}") from None
        if answer.returncode:
            reason = (answer.stderr.strip().splitlines() or [f"exit code {answer.returncode}"])[-1]
            raise ConfigurationError(
                f"{name}.python: {python} cannot import mast-zenoh: {reason}: expected an environment in which "
                f"mast-zenoh {version_string()} is installed"
            )
        if (found := answer.stdout.strip()) != version_string():
            raise VersionMismatch(
                f"{name}.python: {python} has mast-zenoh {found}, expected {version_string()}: install the same one"
            )


class Process(Child):
    """A node as a process of this machine."""

    def __init__(self, name: str, spec: NodeSpec, log: IO[bytes], process: subprocess.Popen[bytes] | Forked) -> None:
        super().__init__(name, spec)
        self.log = log
        self.process = process

    @property
    def cpu_s(self) -> float | None:
        return processor_time_s(self.process.pid)

    @property
    def exit(self) -> int | None:
        return self.process.poll()

    def where(self) -> dict[str, Any]:
        return {"pid": self.process.pid}


class Processes(Supervisor[Process]):
    """Starts each node as a process in its own session, which Ctrl-C does not reach.

    The launcher holds a pipe to each node's standard input: it closes when the launcher ends, and the node leaves.

    inside: what to put before the command of a node; it must become that command, in the same process
    extra_arguments: additional arguments of a node's command
    zids: of all processes so far, so that nobody else counts as a node, whatever name it claims
    """

    def __init__(
        self,
        folder: Path,
        run: str,
        endpoint: str,
        inside: Callable[[str], list[str]] = lambda name: [],
        extra_arguments: Callable[[str], list[str]] = lambda name: [],
    ) -> None:
        super().__init__()
        self.folder = folder
        self.run = run
        self.endpoint = endpoint
        self.inside = inside
        self.extra_arguments = extra_arguments
        self._server: ForkServer | None = None
        self._groups: set[int] = set()  # of all processes so far; each leads one
        self.zids: set[str] = set()

    def start(self, name: str, spec: NodeSpec) -> None:
        log = (self.folder / "logs" / f"{name}.log").open("ab", buffering=0)
        self.children[name] = Process(name, spec, log, self._spawn(name, spec, log))

    def command(self, name: str, spec: NodeSpec) -> list[str]:
        """The command that starts a node."""
        node = [spec.python, *_NODE[1:]] if spec.python else _NODE
        command = [*self.inside(name), *node, spec.file, "--run-folder", str(self.folder), "--name", name]
        zid = "1" + secrets.token_hex(15)
        self.zids.add(zid)
        return [*command, "--endpoint", self.endpoint, "--run", self.run, "--zid", zid, *self.extra_arguments(name)]

    def _restart(self, child: Process) -> None:
        _close(child.process)
        child.process = self._spawn(child.name, child.spec, child.log)

    def end_now(self, child: Process) -> None:
        child.process.kill()
        child.process.wait()

    def _suspend(self, child: Process) -> None:
        child.process.send_signal(signal.SIGSTOP)

    def _resume(self, children: Iterable[Process]) -> None:
        for child in children:
            child.process.send_signal(signal.SIGCONT)

    def dispose(self, child: Process) -> None:
        _close(child.process)
        child.log.close()

    def end(self, grace_s: float) -> None:
        """End all nodes: resume them, close their inputs, wait, SIGTERM, SIGKILL."""
        self.resume(self.running())
        for child in self.running():
            _close(child.process)
        for action in ("wait", "terminate", "kill"):
            if action != "wait":
                for child in self.running():
                    child.notes.append(f"told to leave by {action}")
                    getattr(child.process, action)()
            deadline = time.monotonic() + grace_s
            for child in self.running():
                with contextlib.suppress(subprocess.TimeoutExpired):
                    child.process.wait(max(0.0, deadline - time.monotonic()))
        for child in self.children.values():
            self.dispose(child)
        if self._server is not None:
            self._server.close()
        end_strays(self.run, self._groups)

    def _spawn(self, name: str, spec: NodeSpec, log: IO[bytes]) -> subprocess.Popen[bytes] | Forked:
        command, environment = self.command(name, spec), {**os.environ, **ENVIRONMENT, RUN: self.run}
        process: subprocess.Popen[bytes] | Forked
        if command[: len(_NODE)] == _NODE and can_fork_nodes():
            self._server = self._server or ForkServer(environment)
            process = self._server.start(command, self.folder, log)
        else:
            process = subprocess.Popen(
                command,
                stdin=subprocess.PIPE,
                stdout=log,
                stderr=subprocess.STDOUT,
                cwd=self.folder,
                env=environment,
                start_new_session=True,
            )
        self._groups.add(process.pid)
        return process


def _close(process: subprocess.Popen[bytes] | Forked) -> None:
    if process.stdin is not None and not process.stdin.closed:
        process.stdin.close()
