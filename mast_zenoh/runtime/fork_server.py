"""Forks the nodes of a run from one process that has imported what they need.

    python -P -m mast_zenoh.runtime.fork_server ROOM < SOCKET

A launcher sends a request for each node on the socket, with the descriptors of the node's standard input and log:

    {"command": words, "folder": path}   → {"pid"}, with a descriptor of the process

The node is a process of its own, in a session of its own, and named after its command. When one ends, the launcher gets
{"pid", "exit"}. The server leaves when the launcher closes the socket, or ends.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import importlib
import json
import os
import select
import signal
import socket
import sys
from pathlib import Path
from typing import Any

gc.disable()  # what is imported stays: searching it for garbage delays the start, and copies shared memory

from mast_zenoh.config import bundle, loading  # noqa: E402
from mast_zenoh.runtime.mesh.main import main  # noqa: E402

#: Most bytes of a request.
MAX_REQUEST = 1 << 16
#: What argparse, numpy.unique and zipfile import at their first call.
_LATER = "locale", "numpy.ma", "encodings.cp437"
#: An argument as long as any node's command, which is written in place of the server's.
ROOM = " " * (1 << 14)

#: Descriptors that come with a request: standard input and log.
_N_DESCRIPTORS = 2


def preload() -> None:
    """Import what nodes import, and exempt it from garbage collection, which would copy shared memory."""
    for name in _LATER:
        importlib.import_module(name)
    for name in bundle.names("nodes"):
        loading.module(bundle.ROOT / "nodes" / name)
    gc.freeze()


def serve(requests: socket.socket) -> list[str] | None:
    """Fork nodes as requested. Returns the command in each node's process; None in the server when it is to leave."""
    woken, waking = socket.socketpair()
    waking.setblocking(False)
    woken.setblocking(False)
    signal.set_wakeup_fd(waking.fileno(), warn_on_full_buffer=False)
    signal.signal(signal.SIGCHLD, lambda *_: None)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    while True:
        ready, _, _ = select.select([requests, woken], [], [])
        if woken in ready:
            woken.recv(4096)
            _tell_ended(requests)
        if requests not in ready:
            continue
        data, descriptors, _, _ = socket.recv_fds(requests, MAX_REQUEST, _N_DESCRIPTORS)
        if not data:
            return None
        request = json.loads(data)
        begun, becomes = os.pipe()
        if (pid := os.fork()) == 0:
            for end in (requests, woken, waking):
                end.close()
            os.close(begun)
            _become_node(request, descriptors)
            os.close(becomes)
            command: list[str] = request["command"]
            return command
        os.close(becomes)
        os.read(begun, 1)  # until it has become the node, or has ended
        descriptors += [begun, os.pidfd_open(pid)]
        socket.send_fds(requests, [json.dumps({"pid": pid}).encode()], descriptors[-1:])
        for descriptor in descriptors:
            os.close(descriptor)


def _tell_ended(requests: socket.socket) -> None:
    """Tell the launcher which nodes have ended."""
    while True:
        try:
            pid, status = os.waitpid(-1, os.WNOHANG)
        except ChildProcessError:
            return
        if pid == 0:
            return
        requests.send(json.dumps({"pid": pid, "exit": os.waitstatus_to_exitcode(status)}).encode())


def _become_node(request: dict[str, Any], descriptors: list[int]) -> None:
    """Give a new process what a node has that is started by its command."""
    signal.set_wakeup_fd(-1)
    for number in (signal.SIGCHLD, signal.SIGINT):
        signal.signal(number, signal.SIG_DFL)
    os.setsid()
    entrance, log = descriptors
    for descriptor, place in ((entrance, 0), (log, 1), (log, 2)):
        os.dup2(descriptor, place)
    for descriptor in descriptors:
        os.close(descriptor)
    os.chdir(request["folder"])
    _rename(request["command"])


def _rename(command: list[str]) -> None:
    """Write a command where the system reads that of this process (proc(5): /proc/pid/stat, arg_start and arg_end)."""
    fields = Path("/proc/self/stat").read_text().rpartition(")")[2].split()
    start, end = int(fields[45]), int(fields[46])
    words = b"\0".join(map(os.fsencode, command))[: end - start - 1]
    ctypes.memmove(start, words.ljust(end - start, b"\0"), end - start)


if __name__ == "__main__":
    preload()
    command = None
    with socket.socket(fileno=os.dup(0)) as to_launcher, contextlib.suppress(ConnectionError):  # the launcher has ended
        command = serve(to_launcher)
    if command is not None:
        sys.argv = command[command.index("mast_zenoh.runtime") :]
        main()
