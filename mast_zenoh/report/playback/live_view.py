"""Shows a running run in browsers until it has ended, then all of it."""

from __future__ import annotations

import os
import threading
import time
from contextlib import suppress
from pathlib import Path

import zenoh

from mast_zenoh.config.allowed_code import SHIPPED, AllowedCode
from mast_zenoh.errors import ConfigurationError, MastError
from mast_zenoh.report.playback.feed import Feed
from mast_zenoh.report.playback.inline import policy
from mast_zenoh.report.playback.live_block import LiveBlocks
from mast_zenoh.report.playback.live_server import LiveServer
from mast_zenoh.report.playback.server import viewer_page
from mast_zenoh.viewer.live.observed import ObservedRun, is_starting
from mast_zenoh.viewer.live.observer import POLL_S, Observer

#: Niceness of the viewer, the greatest: no frame waits for it. An environment variable changes it.
_NICENESS, NICENESS = 19, "MAST_VIEWER_NICENESS"
#: s in which a finished run must have its results.
_RESULTS_S = 60.0
#: s after which a page that does not read is taken as stopped.
_PATIENCE_S = 2.0


def yield_processors() -> None:
    """Let every other process go first. Only for a process with a session of its own.

    Linux shares processors between sessions before it looks at the niceness of processes, so the session's own
    niceness counts.
    """
    value = os.environ.get(NICENESS, str(_NICENESS))
    if not value.isdigit() or int(value) > _NICENESS:
        raise ConfigurationError(f"{NICENESS}: found {value!r}, expected a number from 0 to {_NICENESS}")
    niceness = int(value)
    os.nice(niceness)
    if niceness == _NICENESS and hasattr(os, "SCHED_IDLE"):  # any node that wakes up takes the processor at once
        with suppress(PermissionError):  # a container may forbid it
            for thread in os.listdir("/proc/self/task"):
                os.sched_setscheduler(int(thread), os.SCHED_IDLE, os.sched_param(0))
    with suppress(OSError):  # not on every system
        Path("/proc/self/autogroup").write_text(str(niceness))


def show(run: ObservedRun, session: zenoh.Session, server: LiveServer, stop: threading.Event) -> None:
    """Show a running run on a server until `stop` is set, also after its end.

    session: a client of the run's router
    """
    observer = Observer(run, session)
    try:
        _follow(observer, server.feed, stop)
    finally:
        observer.close()
    if stop.is_set():
        return
    if run.folder is None or (page := _finished_page(run.folder, stop)) is None:
        server.feed.close(reload=False)
    else:
        server.show_finished(page, policy())
    stop.wait()


def _follow(observer: Observer, feed: Feed, stop: threading.Event) -> None:
    """Publish frames until the run is over; receives nothing but the clock while no page reads them."""
    blocks = LiveBlocks.of(observer)
    wanted = time.monotonic()
    while not stop.is_set():
        if feed.is_wanted:
            wanted = time.monotonic()
        observer.listen(everything=time.monotonic() - wanted < _PATIENCE_S)
        if not feed.is_wanted:
            observer.keep_up()
        elif (frame := observer.advance()) is not None:
            try:
                feed.publish(*blocks.header_and_block(frame))
            except Exception as error:  # such as numbers that no page can draw: one frame is lost, and the page says so
                observer.note(f"frame {frame.number} cannot be shown: {error!r:.200}")
        feed.note(observer.meter.notes)
        if observer.is_over():
            return
        stop.wait(POLL_S)


def _finished_page(folder: Path, stop: threading.Event) -> str | None:
    """The page of the finished run; None: its results do not arrive."""
    deadline = time.monotonic() + _RESULTS_S
    while time.monotonic() < deadline and not stop.is_set():
        with suppress(MastError):
            return viewer_page([folder])
        stop.wait(1.0)
    return None


def await_start(folder: Path, timeout_s: float, stop: threading.Event, allowed: AllowedCode = SHIPPED) -> ObservedRun:
    """The run of a folder, once it has started its nodes; raises NotRunning if it does not, or cannot be viewed.

    allowed: which of the code that it names may run
    """
    deadline = time.monotonic() + timeout_s
    while is_starting(folder) and time.monotonic() < deadline and not stop.is_set():
        stop.wait(0.1)
    return ObservedRun.of_folder(folder, allowed)
