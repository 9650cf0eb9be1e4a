"""Connects standard input and output to a warden's socket: `python -m … FOLDER`."""

from __future__ import annotations

import contextlib
import os
import socket
import sys
import threading
from collections.abc import Callable
from pathlib import Path

from mast_zenoh.deploy.ssh.warden import CONTROL

NOT_THERE = 7  #: exit code if no warden answers

_CHUNK_BYTES = 1 << 16


def attach(folder: Path) -> None:
    """Relay until either side ends."""
    warden = socket.socket(socket.AF_UNIX)
    try:
        os.chdir(folder)  # the path of a socket is limited in length
        warden.connect(CONTROL)
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
    attach(Path(sys.argv[1]))
