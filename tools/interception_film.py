"""Makes the film at the top of README.md: an adversary is inserted into a running mesh, and released again.

`make pictures PICTURES=interception.gif` does that. The run takes half a minute: it is in real time, because starting a
node takes a second, which in lock-step is most of a run. So the frames in which the adversary comes and goes differ a
little from one film to the next.
"""

from __future__ import annotations

import json
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

from mast_zenoh.launch import live_interception
from mast_zenoh.mesh.session import open_client
from mast_zenoh.show.film.takes import Look
from mast_zenoh.show.film.writing import animate

WIRE, NAME = "agent/infra_2/tracks", "adversary"
#: Frames: of the run, in which insertion and release are requested, and of the film.
FRAMES, INSERT, RELEASE, FIRST, LAST = 140, 55, 105, 40, 130
#: Of frames over those of the scene: an insertion takes about a second.
RATE = 0.5
_DEADLINE_S = 120.0


class Clock:
    """Follows the frames of a run on its mesh."""

    def __init__(self, record: dict[str, Any]) -> None:
        self._frame, self._changed = -1, threading.Condition()
        self._session = open_client(record["endpoint"])
        self._subscriber = self._session.declare_subscriber(f"mast/{record['id']}/clock", self._tick)

    def _tick(self, _: object) -> None:
        with self._changed:
            self._frame += 1
            self._changed.notify_all()

    def wait(self, frame: int) -> None:
        """Wait for a number of frames; raises TimeoutError."""
        with self._changed:
            if not self._changed.wait_for(lambda: self._frame >= frame, _DEADLINE_S):
                raise TimeoutError(f"found no frame {frame} within {_DEADLINE_S:.0f} s")

    def close(self) -> None:
        """Leave the mesh."""
        self._session.close()


def record_run(folder: Path) -> None:
    """Run the baseline with an adversary that comes and goes; raises RuntimeError if the run fails."""
    options = ("--mode", "realtime", "--rate", str(RATE), "--frames", str(FRAMES), "--no-report", "--out", str(folder))
    process = subprocess.Popen((sys.executable, "-m", "mast_zenoh", "run", "baseline", *options))
    try:
        clock = Clock(_started(process, folder))
        try:
            clock.wait(INSERT)
            settings = ("attack.type=UncoordinatedAttack", "attack.start_s=0",
                        "attack.selection.type=UncoordinatedSelection", "attack.selection.n_false_positives=8",
                        "attack.selection.fraction_false_negatives=0")  # fmt: skip
            print(live_interception.intercept(folder, WIRE, "adversary.py", name=NAME, settings=settings))
            clock.wait(RELEASE)
            print(live_interception.release(folder, name=NAME))
        finally:
            clock.close()
        if process.wait(_DEADLINE_S):
            raise RuntimeError(f"the run ended with exit code {process.returncode}")
    finally:
        if process.poll() is None:
            process.terminate()
            process.wait()


def _started(process: subprocess.Popen[bytes], folder: Path) -> dict[str, Any]:
    """run.json, once it names the nodes."""
    path, pause, deadline = folder / "run.json", threading.Event(), time.monotonic() + _DEADLINE_S
    while process.poll() is None and time.monotonic() < deadline:
        record: dict[str, Any] = json.loads(path.read_text()) if path.is_file() else {}
        if record.get("nodes"):
            return record
        pause.wait(0.05)
    raise RuntimeError("the run did not start")


def make(out: Path, folder: Path) -> None:
    """Record a run in a new folder, and write a film of it to a new file."""
    record_run(folder)
    captions = (f"{FIRST}:five agents share one picture, no adversary",)
    look = Look(title="An adversary on one wire of a running mesh", size="800x760", captions=captions)
    animate(folder, out, look, start=FIRST, end=LAST)
