"""`mast view`: runs in a browser, running or finished."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mast_zenoh.cli.options import out as _out
from mast_zenoh.errors import ConfigurationError

if TYPE_CHECKING:
    from mast_zenoh.launch.context import RunContext

_START_S = 60.0  # for a run to start its nodes
_END_S = 5.0  # for the viewer to end
_LAST_LINE = "Ctrl-C ends it."
_PROTOCOLS = ("tcp", "tls", "udp", "quic", "ws")


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
    remote = "/" in target and target.partition("/")[0] in _PROTOCOLS and not folder.exists()
    if attached:
        _observe(target, run, port, browser, remote=remote)
    elif remote or (other is None and _record(folder).get("status") == "running"):
        if other is not None:
            raise ConfigurationError("two runs on one timeline: expected the folders of two finished runs")
        options = [f"--run={run}"] * bool(run) + [f"--port={port}"] + ["--open"] * browser
        raise typer.Exit(_wait(_start(target, *options)))
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
        child = _start(str(context.folder), stdout=subprocess.PIPE)
        children.append(child)
        assert child.stdout is not None
        for line in child.stdout:  # until the page can be opened, or the viewer has failed
            _out.print(line.decode().rstrip(), markup=False, highlight=False)
            if line.startswith(_LAST_LINE.encode()):
                break

    try:
        yield prepare
        if children and children[0].poll() is None and _out.is_terminal:
            _out.print("the whole run is in the viewer now; Ctrl-C ends it", highlight=False)
            _wait(children[0])
    finally:
        for child in children:
            _end(child)


def _start(target: str, *options: str, stdout: int | None = None) -> subprocess.Popen[bytes]:
    """Start a viewer of a running run.

    It has a session of its own: signals of the terminal are for its parent, and its processor time is shared out apart
    from the run's. It ends when its standard input does, so also with its parent.
    """
    command = [sys.executable, "-P", "-m", "mast_zenoh", "view", target, "--attached", *options]
    return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=stdout, start_new_session=True)


def _wait(child: subprocess.Popen[bytes]) -> int:
    """Wait for a viewer, or for Ctrl-C, which ends it; returns its exit code."""
    try:
        return child.wait()
    except KeyboardInterrupt:
        _end(child)
        return 0


def _end(child: subprocess.Popen[bytes]) -> None:
    assert child.stdin is not None
    with suppress(BrokenPipeError):
        child.stdin.close()
    try:
        child.wait(_END_S)
    except subprocess.TimeoutExpired:
        child.kill()
        child.wait()


def _record(folder: Path) -> dict[str, Any]:
    """run.json of a run as of now; {}: there is none."""
    from mast_zenoh.launch import folder as run_folder
    from mast_zenoh.launch import liveness

    return liveness.current_record(run_folder.json_or_empty(folder / "run.json"))


def _show_finished(folders: list[Path], frame: int | None, port: int, browser: bool) -> None:
    from mast_zenoh.report.playback.server import ViewerServer, viewer_page

    with ViewerServer(viewer_page(folders, frame), port) as server:
        _announce(server, browser)
        with suppress(KeyboardInterrupt):
            server.serve_forever()
    _out.print()


def _observe(target: str, run: str, port: int, browser: bool, *, remote: bool) -> None:
    """Show a running run until standard input ends."""
    from mast_zenoh.report.playback import live_view
    from mast_zenoh.report.playback.feed import Feed
    from mast_zenoh.report.playback.live_server import LiveServer
    from mast_zenoh.runtime.mesh import hosting
    from mast_zenoh.runtime.mesh.session import open_client
    from mast_zenoh.viewer.live import observed

    with ExitStack() as stack:
        stop = stack.enter_context(_stopped())
        if remote:
            observed.check_reachable(target)
            session = stack.enter_context(open_client(target))
            running = observed.ObservedRun.of_mesh(session, target, run)
        title = running.resolved.name if remote else str(_record(Path(target)).get("name") or target)
        server = stack.enter_context(LiveServer(title, Feed(), port))
        _announce(server, browser)
        live_view.yield_processors()
        if not remote:
            running = live_view.await_start(Path(target), _START_S, stop)
            session = stack.enter_context(hosting.join(running.endpoint, running.credentials))
        live_view.show(running, session, server, stop)


@contextmanager
def _stopped() -> Iterator[threading.Event]:
    """An event that is set by SIGTERM and by the end of standard input."""
    stop = threading.Event()
    before = signal.signal(signal.SIGTERM, lambda *_: stop.set())

    def follow_input() -> None:
        # Not through sys.stdin: a thread that waits for its lock makes the interpreter crash when it exits.
        with suppress(OSError):
            while os.read(0, 4096):
                pass
        stop.set()

    threading.Thread(target=follow_input, daemon=True).start()
    try:
        yield stop
    finally:
        signal.signal(signal.SIGTERM, before)


def _announce(server: Any, browser: bool) -> None:
    """Print where the page is. server: with `url` and `tunnel`"""
    _out.print(f"view: {server.url}", markup=False, highlight=False)
    _out.print(f"from another computer: {server.tunnel}", markup=False, highlight=False)
    _out.print(_LAST_LINE, markup=False, highlight=False)
    sys.stdout.flush()
    if browser:
        import webbrowser

        webbrowser.open(server.url)
