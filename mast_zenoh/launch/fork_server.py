"""Forks the nodes of a run from one process that has imported what they need.

    python -P -m mast_zenoh.launch.fork_server ROOM < SOCKET

A launcher sends a request for each node on the socket, with the descriptors of the node's standard input and log:

    {"command": words, "folder": path}   → process id

The node is a process of its own, in a session of its own, named after its command, and a child of the launcher, which
adopts orphans. The server leaves when the launcher closes the socket, or ends.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import importlib
import json
import os
import socket
import sys
from typing import Any

gc.disable()  # what is imported stays: searching it for garbage delays the start, and copies shared memory

import numpy as np  # noqa: E402

from mast_zenoh.config import bundle, loading  # noqa: E402
from mast_zenoh.launch.liveness import stat_of  # noqa: E402
from mast_zenoh.mesh.hosting import main, wake_when_orphaned  # noqa: E402

#: Most bytes of a request.
_MAX_REQUEST = 1 << 16
#: What argparse, numpy.unique and zipfile import at their first call.
_LATER = "locale", "numpy.ma", "encodings.cp437"
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
    while True:
        data, descriptors, _, _ = socket.recv_fds(requests, _MAX_REQUEST, _N_DESCRIPTORS)
        if not data:
            return None
        pid_reader, pid_writer = os.pipe()
        if (intermediate := os.fork()) == 0:  # it ends at once, so that the launcher adopts the node
            if pid := os.fork():
                os.write(pid_writer, b"%d" % pid)
                os._exit(0)
            for end in (pid_reader, pid_writer):
                os.close(end)
            requests.close()
            request = json.loads(data)
            _become_node(request, descriptors)
            command: list[str] = request["command"]
            return command
        for end in (pid_writer, *descriptors):
            os.close(end)
        os.waitpid(intermediate, 0)
        requests.send(os.read(pid_reader, 16))
        os.close(pid_reader)


def _become_node(request: dict[str, Any], descriptors: list[int]) -> None:
    """Give a new process what a node has that is started by its command."""
    np.random.seed()  # noqa: NPY002  # otherwise all nodes draw the same numbers from NumPy's global generator
    os.setsid()
    stdin, log = descriptors
    for descriptor, place in ((stdin, 0), (log, 1), (log, 2)):
        os.dup2(descriptor, place)
    for descriptor in descriptors:
        os.close(descriptor)
    os.chdir(request["folder"])
    _rename(request["command"])


def _rename(command: list[str]) -> None:
    """Write a command where the system reads that of this process (proc(5): /proc/pid/stat, arg_start and arg_end)."""
    fields = stat_of("self")
    start, end = int(fields[45]), int(fields[46])
    words = b"\0".join(map(os.fsencode, command))[: end - start - 1]
    ctypes.memmove(start, words.ljust(end - start, b"\0"), end - start)


if __name__ == "__main__":
    wake_when_orphaned()
    preload()
    command = None
    with socket.socket(fileno=os.dup(0)) as to_launcher, contextlib.suppress(ConnectionError):  # the launcher has ended
        command = serve(to_launcher)
    if command is not None:
        sys.argv = command[command.index("mast_zenoh.mesh") :]
        main()
