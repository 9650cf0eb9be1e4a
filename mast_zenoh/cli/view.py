"""`mast view`: runs in a browser, running or finished, and the process that shows a running run."""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mast_zenoh.cli import observers
from mast_zenoh.cli.observers import LAST_LINE, print_line
from mast_zenoh.cli.options import Confirmed, allowed_code, refuse, run_argument
from mast_zenoh.cli.options import out as _out
from mast_zenoh.errors import ConfigurationError, RunFolderError

if TYPE_CHECKING:
    from mast_zenoh.config.loading import AllowedCode
    from mast_zenoh.launch.context import RunContext

#: Of a viewer that is served to no more.
_HERE = "`mast view RUN` shows a run in a browser"


def view(
    target: Annotated[str, run_argument("The folder of a run, finished or running; or a router, tcp/HOST:PORT.")],
    other: Annotated[Path | None, run_argument("Another finished run, on the same timeline.", "OTHER")] = None,
    frame: Annotated[int | None, typer.Option(min=0, help="The frame of a finished run to show first.")] = None,
    run: Annotated[str, typer.Option(metavar="ID", help="Which run of the router, if there are several.")] = "",
    port: Annotated[int, typer.Option(min=0, max=65535, help="The port on this computer; 0: any free one.")] = 0,
    browser: Annotated[bool, typer.Option("--open", help="Open the page in a browser.")] = False,
    foxglove: Annotated[bool, typer.Option("--foxglove", hidden=True)] = False,
    rerun: Annotated[bool, typer.Option("--rerun", hidden=True)] = False,
    confirmed: Confirmed = False,
    attached: Annotated[bool, typer.Option("--attached", hidden=True)] = False,
) -> None:
    """Show a run in a browser while it is running or afterwards, or two finished runs on one timeline.

    Ctrl-C ends the viewer; it never ends the run.
    """
    for option, asked, name in (("--foxglove", foxglove, "foxglove"), ("--rerun", rerun, "rrd")):
        refuse(asked, f"{option}: no such server: `mast export RUN --to {name}` writes a file; {_HERE}")
    if attached:
        observe(target, run, port, allowed_code(confirmed=confirmed), browser=browser)
        return
    shown = observers.target_of(target, run)
    folder = shown.folder
    if other is not None:
        if shown.remote:
            raise ConfigurationError("two runs on one timeline: expected the folders of two finished runs")
        if shown.running or observers.record_of(other).get("status") == "running":
            busy = folder if shown.running else other
            raise RunFolderError(f"{busy}: the run is still in progress: expected two finished runs")
    refuse(shown.running and frame is not None, "found a running run, expected a finished one for --frame")
    if shown.running:
        chosen = {"--open": browser, "--trust": confirmed}
        allowed = allowed_code(confirmed=confirmed)
        words = [*([f"--run={run}"] if run else []), *(name for name, is_set in chosen.items() if is_set)]
        raise typer.Exit(observers.observe_apart("view", shown, allowed, [f"--port={port}", *words]))
    _show_finished([folder] if other is None else [folder, other], frame, port, browser)


def _show_finished(folders: list[Path], frame: int | None, port: int, browser: bool) -> None:
    """Show one finished run, or two, in a browser until Ctrl-C."""
    from mast_zenoh.run_folder import reading
    from mast_zenoh.show.page.live_server import PageServer
    from mast_zenoh.show.page.page import policy, viewer_page

    with reading(folders[-1]):
        page = viewer_page(folders, frame)
    with PageServer(page, policy(), port) as server:
        announce(server.url, browser)
        with suppress(KeyboardInterrupt):
            server.wait()
    _out().print()


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
        # --trust: this process's own run
        child = observers.start("view", str(context.folder), "--trust", stdout=subprocess.PIPE)
        children.append(child)
        assert child.stdout is not None
        for line in child.stdout:  # until the page can be opened, or the viewer has failed
            if line.startswith(LAST_LINE.encode()):
                print_line("Ctrl-C ends the run, and then the viewer.")
                break
            print_line(line.decode().rstrip())

    try:
        yield prepare
        if children and children[0].poll() is None and _out().is_terminal:
            _out().print("the whole run is in the viewer now; Ctrl-C ends it", highlight=False)
            observers.wait(children[0])
    finally:
        for child in children:
            observers.end(child)


def observe(target: str, run: str, port: int, allowed: AllowedCode, *, browser: bool) -> None:
    """Show a running run until standard input ends.

    target: the folder of a run, or a router with a run of this id, "": its only one
    allowed: which of the code that the run folder names may run
    """
    from mast_zenoh.runs.live.priority import yield_processors
    from mast_zenoh.show.page import live_server
    from mast_zenoh.show.page.live_server import Feed, LiveServer

    servers = []
    with ExitStack() as stack:

        def open_page(title: str) -> None:
            servers.append(stack.enter_context(LiveServer(title, Feed(), port)))
            announce(servers[0].url, browser)
            yield_processors()

        running, session, stop = observers.join(stack, target, run, allowed, open_page)
        live_server.show(running, session, servers[0], stop)


def announce(url: str, browser: bool) -> None:
    """Print the address of a page on this computer, and open it if wanted."""
    from mast_zenoh.show.page.live_server import tunnel

    print_line(f"view: {url}")
    print_line(f"from another computer: {tunnel(url)}")
    print_line(LAST_LINE)
    if browser:
        import webbrowser

        webbrowser.open(url)
