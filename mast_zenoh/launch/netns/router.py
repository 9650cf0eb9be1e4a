"""The router of a run with hosts, as a process at the centre.

    python -m mast_zenoh.launch.netns.router ENDPOINT...

A session's threads stay in the network namespace in which it was opened. So the launcher, which is outside, connects
through a socket file. Prints "ready" when the router listens; ends when standard input closes.
"""

from __future__ import annotations

import os
import signal
import sys

from mast_zenoh.mesh.session import open_router

if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    session, _ = open_router(*sys.argv[1:], links_may_be_cut=True)
    with session:
        print("ready", flush=True)
        while os.read(sys.stdin.fileno(), 4096):
            pass
