"""Importing the package changes nothing in a user's process."""

from __future__ import annotations

import subprocess
import sys

PROGRAM = """
import gc, signal, sys, threading

def state():
    collecting = gc.isenabled(), gc.get_threshold(), gc.get_freeze_count()
    return collecting, signal.getsignal(signal.SIGINT), threading.active_count()

before = state()
import mast_zenoh
mast_zenoh.run, mast_zenoh.study
import mast_zenoh.cli.app, mast_zenoh.testing.simulation
sys.exit(f"{before} became {state()}" if before != state() else 0)
"""


def test_importing_the_package_leaves_garbage_collection_signals_and_threads_as_they_are() -> None:
    process = subprocess.run([sys.executable, "-P", "-c", PROGRAM], capture_output=True, text=True, check=False)
    assert process.returncode == 0, process.stderr
