"""`mast view`: runs in a browser, running or finished."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mast_zenoh.cli.options import out as _out
from mast_zenoh.errors import ConfigurationError

if TYPE_CHECKING:
    from mast_zenoh.launch.context import RunContext

_START_S = 60.0  # for a run to start its nodes
_END_S = 5.0  # for the viewer to end


def view(
    target: Annotated[
        str, typer.Argument(metavar="RUN", help="The folder of a run, finished or running; or a router, tcp/HOST:PORT.")
    ],
    other: Annotated[
        Path | None, typer.Argument(metavar="OTHER", help="Another finished run, on the same timeline.")
    ] = None,
    frame: Annotated[int | None, typer.Option(min=0, help="The frame of a finished run to show first.")] = None,
    run: Annotated[str, typer.Option(metavar="ID", help="Which run of the router, if there are several.")] = "",
    port: Annotated[int, typer.Option(min=0, max=65535, help="The port on this computer; 0: any free one.")] = 0,
    browser: Annotated[bool, typer.Option("--open", help="Open the page in a browser.")] = False,
    attached: Annotated[bool, typer.Option("--attached", hidden=True)] = False,
) -> None:
    """Show a run in a browser while it is running or afterwards, or two finished runs on one timeline.

    Ctrl-C ends the viewer; it never ends the run.
    """
    folder = Path(target)
    if "/" in target and target.partition("/")[0] in ("tcp", "tls", "udp", "quic", "ws") and not folder.exists():
        if other is not None:
            raise ConfigurationError("mast view: two runs on one timeline: expected the folders of two finished runs")
        _show_router(target, run, port, browser)
    elif other is None and (attached or _is_running(folder)):
        _show_running(folder, port, browser, attached=attached)
    else:
        _show_finished([folder] if other is None else [folder, other], frame, port, browser)


@contextmanager
def viewer(wanted: bool) -> Iterator[Callable[[RunContext], None]]:
    """What prepares a run on a mesh: if wanted, a viewer in a process of its own.

    On a terminal the context waits for Ctrl-C when the run has succeeded; the viewer ends with the context.
    """
    children: list[subprocess.Popen[bytes]] = []

    def prepare(context: RunContext) -> None:
        if not wanted:
            return
        context.viewer = True
        command = [sys.executable, "-P", "-m", "mast_zenoh", "view", str(context.folder), "--attached"]
        # Its own session: Ctrl-C is the run's. Its input ends with this process, and so does the viewer.
        children.append(subprocess.Popen(command, stdin=subprocess.PIPE, start_new_session=True))

    try:
        yield prepare
        if children and children[0].poll() is None and _out.is_terminal:
            _out.print("the whole run is in the viewer now; Ctrl-C ends it", highlight=False)
            with suppress(KeyboardInterrupt):
                children[0].wait()
    finally:
        for child in children:
            _end(child)


def _end(child: subprocess.Popen[bytes]) -> None:
    assert child.stdin is not None
    with suppress(BrokenPipeError):
        child.stdin.close()
    try:
        child.wait(_END_S)
    except subprocess.TimeoutExpired:
        child.kill()
        child.wait()


def _is_running(folder: Path) -> bool:
    """Whether the run in a folder is in progress."""
    from mast_zenoh.launch import folder as run_folder
    from mast_zenoh.launch import liveness
    from mast_zenoh.launch.ending import RUNNING

    return liveness.current_record(run_folder.json_or_empty(folder / "run.json")).get("status") == RUNNING


def _show_finished(folders: list[Path], frame: int | None, port: int, browser: bool) -> None:
    from mast_zenoh.report.playback.server import ViewerServer, viewer_page

    with ViewerServer(viewer_page(folders, frame), port) as server:
        _announce(server, browser)
        with suppress(KeyboardInterrupt):
            server.serve_forever()
    _out.print()


def _show_running(folder: Path, port: int, browser: bool, *, attached: bool) -> None:
    from mast_zenoh.report.playback import live_view
    from mast_zenoh.runtime.mesh import hosting

    live_view.yield_processors()
    with _stopped(attached) as stop:
        run = live_view.await_start(folder, _START_S if attached else 0.0, stop)
        with hosting.join(run.endpoint, run.credentials) as session:
            live_view.show(run, session, port, _announcer(browser), stop)


def _show_router(endpoint: str, run: str, port: int, browser: bool) -> None:
    from mast_zenoh.report.playback import live_view
    from mast_zenoh.runtime.mesh.session import open_client
    from mast_zenoh.viewer.live import observed

    observed.check_reachable(endpoint)
    live_view.yield_processors()
    with _stopped(False) as stop, open_client(endpoint) as session:
        running = observed.ObservedRun.of_mesh(session, endpoint, run)
        live_view.show(running, session, port, _announcer(browser), stop)


@contextmanager
def _stopped(attached: bool) -> Iterator[threading.Event]:
    """An event that is set by Ctrl-C and SIGTERM, and if attached by the end of standard input."""
    stop = threading.Event()
    before = {number: signal.signal(number, lambda *_: stop.set()) for number in (signal.SIGINT, signal.SIGTERM)}

    def follow_input() -> None:
        with suppress(OSError, ValueError):
            sys.stdin.buffer.read()
        stop.set()

    if attached:
        threading.Thread(target=follow_input, daemon=True).start()
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _announcer(browser: bool) -> Callable[[Any], None]:
    return lambda server: _announce(server, browser)


def _announce(server: Any, browser: bool) -> None:
    """Print where the page is. server: with `url` and `tunnel`"""
    _out.print(f"view: {server.url}", markup=False, highlight=False)
    _out.print(f"from another computer: {server.tunnel}", markup=False, highlight=False)
    _out.print("Ctrl-C ends it.", markup=False, highlight=False)
    if browser:
        import webbrowser

        webbrowser.open(server.url)
