"""Frames/s of a run without the bridge to ROS 2, with it, and with one that sends every frame; its memory.

As in live_view.py: bridges come and go within one run in lock-step at full speed. Each window with a bridge is compared
with the windows without one just before and after it. The peer subscribes to what RViz shows at first, or to all
topics; it is a Zenoh session that decodes nothing, as if RViz were on another computer.

    python benchmarks/ros2.py [--runs 3] [--seconds 8] [--all]
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import psutil
import zenoh
from live_view import compare

from mast_zenoh.mesh.session import open_client, open_router

_MAST = (sys.executable, "-m", "mast_zenoh")
_SHOWN = ("tf", "tf_static", "clock", "scene/truth/markers", "cc/picture/markers")


@contextmanager
def bridge(kind: str, out: Path, router: str, peer: zenoh.Session) -> Iterator[list[psutil.Process]]:
    """A bridge for a run from its first frame on. kind: paced, every or none"""
    if kind == "none":
        yield []
        return
    words = ["--every-frame"] if kind == "every" else []
    command = [*_MAST, "ros2", str(out), f"--router={router}", *words]
    ring: Any = zenoh.handlers.RingChannel(1)
    clocks = peer.declare_subscriber("0/clock/**", ring)
    with subprocess.Popen(command, stdout=subprocess.PIPE) as process:
        try:
            clocks.handler.recv()
            own = psutil.Process(process.pid)
            yield [own, *own.children(recursive=True)]
        finally:
            process.send_signal(2)
            process.communicate()
            clocks.undeclare()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=8.0, help="length of a window")
    parser.add_argument("--all", action="store_true", help="a peer that subscribes to all topics")
    arguments = parser.parse_args()
    session, endpoint = open_router()
    with session, open_client(endpoint) as rviz:
        keys = ["0/**"] if arguments.all else [f"0/{topic}/*/*" for topic in _SHOWN]
        newest: list[Any] = [rviz.declare_subscriber(key, zenoh.handlers.RingChannel(1)) for key in keys]
        compare(
            arguments.runs,
            arguments.seconds,
            ["paced", "every"],
            lambda kind, out: bridge(kind, out, endpoint, rviz),
            "bridge",
        )
