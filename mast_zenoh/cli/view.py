"""`mast view`: runs in a browser or in other viewers, running or finished, and the process that shows a running run."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mast_zenoh.cli.options import Confirmed, allowed_code, refuse, run_argument
from mast_zenoh.cli.options import out as _out
from mast_zenoh.errors import ConfigurationError, RunFolderError, UntrustedCode
from mast_zenoh.run_files import read_object, reading

if TYPE_CHECKING:
    from mast_zenoh.config.allowed_code import AllowedCode
    from mast_zenoh.launch.context import RunContext


_START_S = 60.0  # for a run to start its nodes
_END_S = 5.0  # for the viewer to end
_DYING_S = 2.0  # for a killed launcher to be gone
_LAST_LINE = "Ctrl-C ends it."
_PROTOCOLS = ("tcp", "tls", "udp", "quic", "ws")


def view(
    target: Annotated[str, run_argument("The folder of a run, finished or running; or a router, tcp/HOST:PORT.")],
    other: Annotated[Path | None, run_argument("Another finished run, on the same timeline.", "OTHER")] = None,
    frame: Annotated[int | None, typer.Option(min=0, help="The frame of a finished run to show first.")] = None,
    run: Annotated[str, typer.Option(metavar="ID", help="Which run of the router, if there are several.")] = "",
    port: Annotated[int, typer.Option(min=0, max=65535, help="The port on this computer; 0: any free one.")] = 0,
    browser: Annotated[bool, typer.Option("--open", help="Open the page in a browser.")] = False,
    foxglove: Annotated[bool, typer.Option("--foxglove", help="Play it for Foxglove and Lichtblick instead.")] = False,
    rerun: Annotated[bool, typer.Option("--rerun", help="Serve it to the Rerun viewer instead.")] = False,
    rate: Annotated[
        float, typer.Option(min=0.01, max=100.0, help="--foxglove, finished run: s of the scene per s.")
    ] = 1.0,
    loop: Annotated[bool, typer.Option("--loop", help="--foxglove, finished run: begin again at the end.")] = False,
    confirmed: Confirmed = False,
    attached: Annotated[bool, typer.Option("--attached", hidden=True)] = False,
) -> None:
    """Show a run in a browser while it is running or afterwards, or two finished runs on one timeline.

    Ctrl-C ends the viewer; it never ends the run.
    """
    folder, elsewhere = Path(target), foxglove or rerun
    refuse(foxglove and rerun, "found --foxglove and --rerun, expected one of them")
    refuse(not foxglove and (rate != 1.0 or loop), "--rate and --loop are for --foxglove")
    refuse(elsewhere and other is not None, "found two runs, expected one: other viewers show one run")
    refuse(elsewhere and (frame is not None or browser), "--frame and --open are for this testbed's own page")
    remote = _is_router(target)
    if attached:
        allowed = allowed_code(confirmed=confirmed)
        observe(target, run, port, allowed, remote=remote, browser=browser, foxglove=foxglove, rerun=rerun)
        return
    record = {} if remote else record_of(folder)
    running = remote or record.get("status") == "running"
    if other is not None:
        if remote:
            raise ConfigurationError("two runs on one timeline: expected the folders of two finished runs")
        if running or record_of(other).get("status") == "running":
            busy = folder if running else other
            raise RunFolderError(f"{busy}: the run is still in progress: expected two finished runs")
    if not remote and folder.is_dir() and not record:
        raise RunFolderError(f"{folder}: found no run.json: the run has not begun, or this is not the folder of a run")
    of_finished = frame is not None or rate != 1.0 or loop
    refuse(running and of_finished, "found a running run, expected a finished one for --frame, --rate and --loop")
    refuse(run and not remote, f"found {target}, expected a router, such as tcp/HOST:7447, for --run")
    if running:
        if not remote:
            from mast_zenoh.launch.liveness import check_from_here

            place = f"the router {record.get('endpoint')}"
            check_from_here(folder, record, allowed_code(confirmed=confirmed), place)
        chosen = {"--open": browser, "--foxglove": foxglove, "--rerun": rerun, "--trust": confirmed}
        words = [*([f"--run={run}"] if run else []), *(name for name, is_set in chosen.items() if is_set)]
        raise typer.Exit(wait(start(target, f"--port={port}", *words)))
    if elsewhere:
        _serve_to_other_viewers(folder, port, foxglove=foxglove, rate=rate, loop=loop)
    else:
        _show_finished([folder] if other is None else [folder, other], frame, port, browser)


def _is_router(target: str) -> bool:
    """Whether a target is the address of a router, and not a folder."""
    return "/" in target and target.partition("/")[0] in _PROTOCOLS and not Path(target).exists()


def _show_finished(folders: list[Path], frame: int | None, port: int, browser: bool) -> None:
    """Show one finished run, or two, in a browser until Ctrl-C."""
    from mast_zenoh.viewer.page.page import ViewerServer, viewer_page

    with reading(folders[-1]):
        page = viewer_page(folders, frame)
    with ViewerServer(page, port) as server:
        announce(server.url, browser)
        with suppress(KeyboardInterrupt):
            server.serve_forever()
    _out.print()


def _serve_to_other_viewers(folder: Path, port: int, *, foxglove: bool, rate: float, loop: bool) -> None:
    """Serve a finished run to one of the other viewers until Ctrl-C."""
    from mast_zenoh.viewer.recorded import RecordedRun
    from mast_zenoh.viewer.servers.other_viewers import serve_to_foxglove, serve_to_rerun

    with reading(folder):
        run = RecordedRun.load(folder)
    never = threading.Event()
    if foxglove:
        serve_to_foxglove(run, port, never, print_line, rate=rate, loop=loop)
    else:
        serve_to_rerun(run, port, never, print_line)


def record_of(folder: Path) -> dict[str, Any]:
    """run.json of a run as of now; {}: there is none. Raises RunFolderError for one that cannot be read."""
    from mast_zenoh.launch import liveness

    if not (folder / "run.json").exists():
        return {}
    return liveness.current_record(read_object(folder / "run.json"))


# -- in the process that starts it -------------------------------------------------------------------------------------


@contextmanager
def viewer(wanted: bool) -> Iterator[Callable[[RunContext], None]]:
    """Yield a callback that starts a viewer process for a run on a mesh, if one is wanted.

    On a terminal the context waits for Ctrl-C when the run has succeeded; the viewer ends with the context.
    """
    children: list[subprocess.Popen[bytes]] = []

    def prepare(context: RunContext) -> None:
        if not wanted:
            return
        context.viewer = True
        child = start(str(context.folder), "--trust", stdout=subprocess.PIPE)  # this process's own run
        children.append(child)
        assert child.stdout is not None
        for line in child.stdout:  # until the page can be opened, or the viewer has failed
            if line.startswith(_LAST_LINE.encode()):
                print_line("Ctrl-C ends the run, and then the viewer.")
                break
            print_line(line.decode().rstrip())

    try:
        yield prepare
        if children and children[0].poll() is None and _out.is_terminal:
            _out.print("the whole run is in the viewer now; Ctrl-C ends it", highlight=False)
            wait(children[0])
    finally:
        for child in children:
            _end(child)


def start(target: str, *options: str, stdout: int | None = None) -> subprocess.Popen[bytes]:
    """Start a viewer of a running run.

    It has a session of its own: signals of the terminal are for its parent, and its processor time is shared out apart
    from the run's. It ends when its standard input does, so also with its parent.
    """
    command = [sys.executable, "-P", "-m", "mast_zenoh", "view", target, "--attached", *options]
    return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=stdout, start_new_session=True)


def wait(child: subprocess.Popen[bytes]) -> int:
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


# -- in the process itself ---------------------------------------------------------------------------------------------


def observe(
    target: str, run: str, port: int, allowed: AllowedCode, *, remote: bool, browser: bool, foxglove: bool, rerun: bool
) -> None:
    """Show a running run until standard input ends.

    target: the folder of a run or, `remote`, a router with a run of this id, "": its only one
    allowed: which of the code that the run folder names may run
    foxglove, rerun: to these viewers instead of a browser
    """
    from mast_zenoh.runtime.mesh import hosting
    from mast_zenoh.viewer.live import observed
    from mast_zenoh.viewer.live.measurement import evaluator_class
    from mast_zenoh.viewer.live.observer import Observer
    from mast_zenoh.viewer.page import live_view
    from mast_zenoh.viewer.page.live_server import Feed, LiveServer
    from mast_zenoh.viewer.servers.other_viewers import serve_to_foxglove, serve_to_rerun

    evaluator_class()  # before the run begins
    with ExitStack() as stack:
        stop = stack.enter_context(_stopped(lambda: None if remote else _delete_keys_of_the_dead(Path(target))))
        if remote:
            observed.check_reachable(target)
            session = stack.enter_context(hosting.join(target, None, observer=True))
            running = observed.ObservedRun.of_mesh(session, target, run)
        in_browser = not (foxglove or rerun)
        if in_browser:
            title = running.resolved.name if remote else str(record_of(Path(target)).get("name") or target)
            server = stack.enter_context(LiveServer(title, Feed(), port))
            announce(server.url, browser)
        live_view.yield_processors()
        if not remote:
            running = live_view.await_start(Path(target), _START_S, stop, allowed)
            if running.refused:
                print_line(f"warning: {running.refused}")
            session = stack.enter_context(hosting.join(running.endpoint, running.credentials, observer=True))
        if in_browser:
            live_view.show(running, session, server, stop)
            return
        observer = Observer(running, session)
        stack.callback(observer.close)
        frames = replace(observer.record, frames=observer.frames(stop))
        if foxglove:
            serve_to_foxglove(frames, port, stop, print_line)
        else:
            serve_to_rerun(frames, port, stop, print_line)


def _delete_keys_of_the_dead(folder: Path) -> None:
    """Delete the viewer's credentials if the launcher, which else does so, was killed."""
    from mast_zenoh.config.allowed_code import SHIPPED
    from mast_zenoh.launch import liveness
    from mast_zenoh.launch.context import VIEWER_CREDENTIALS
    from mast_zenoh.security.credentials import VIEWER
    from mast_zenoh.security.deployment import KEYS

    try:
        liveness.check_from_here(folder, record_of(folder), SHIPPED, "a folder of keys")
    except UntrustedCode:
        return
    credentials = Path(str(record_of(folder).get(VIEWER_CREDENTIALS, "")))
    if credentials.name != VIEWER or not credentials.parent.name.startswith(KEYS):  # a file may say anything
        return
    # A process that dies closes its pipes a moment before it is gone.
    deadline = time.monotonic() + _DYING_S
    while (running := record_of(folder).get("status") == "running") and time.monotonic() < deadline:
        threading.Event().wait(0.05)
    if not running:
        shutil.rmtree(credentials, ignore_errors=True)
        with suppress(OSError):
            credentials.parent.rmdir()


@contextmanager
def _stopped(clean_up: Callable[[], None]) -> Iterator[threading.Event]:
    """An event that is set by SIGTERM and by the end of standard input, soon after which the process ends.

    clean_up: called at the end, in any case
    """
    stop = threading.Event()
    before = signal.signal(signal.SIGTERM, lambda *_: stop.set())

    def follow_input() -> None:
        # Not through sys.stdin: a thread that waits for its lock makes the interpreter crash when it exits.
        with suppress(OSError):
            while os.read(0, 4096):
                pass
        stop.set()
        threading.Event().wait(_END_S - 1.0)  # what waits for the mesh may not look at `stop`
        clean_up()
        os._exit(0)

    threading.Thread(target=follow_input, daemon=True).start()
    try:
        yield stop
    finally:
        signal.signal(signal.SIGTERM, before)
        clean_up()


def announce(url: str, browser: bool) -> None:
    """Print the address of a page on this computer, and open it if wanted."""
    from mast_zenoh.viewer.loopback import tunnel

    print_line(f"view: {url}")
    print_line(f"from another computer: {tunnel(url)}")
    print_line(_LAST_LINE)
    if browser:
        import webbrowser

        webbrowser.open(url)


def print_line(line: str) -> None:
    """Print a line at once, also into a pipe."""
    _out.print(line, markup=False, highlight=False, soft_wrap=True)
    sys.stdout.flush()
