"""`mast view`: runs in a browser or in other viewers, running or finished."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Annotated

import typer

from mast_zenoh.cli import completion, viewer_process
from mast_zenoh.cli.options import out as _out
from mast_zenoh.errors import ConfigurationError, RunFolderError

_PROTOCOLS = ("tcp", "tls", "udp", "quic", "ws")


def view(
    target: Annotated[
        str,
        typer.Argument(
            metavar="RUN",
            help="The folder of a run, finished or running; or a router, tcp/HOST:PORT.",
            autocompletion=completion.run_folders,
        ),
    ],
    other: Annotated[
        Path | None,
        typer.Argument(
            metavar="OTHER",
            help="Another finished run, on the same timeline.",
            autocompletion=completion.run_folders,
        ),
    ] = None,
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
    attached: Annotated[bool, typer.Option("--attached", hidden=True)] = False,
) -> None:
    """Show a run in a browser while it is running or afterwards, or two finished runs on one timeline.

    Ctrl-C ends the viewer; it never ends the run.
    """
    if foxglove and rerun:
        raise typer.BadParameter("found --foxglove and --rerun, expected one of them")
    if not foxglove and (rate != 1.0 or loop):
        raise typer.BadParameter("--rate and --loop are for --foxglove")
    folder = Path(target)
    remote = "/" in target and target.partition("/")[0] in _PROTOCOLS and not folder.exists()
    if attached:
        viewer_process.observe(target, run, port, remote=remote, browser=browser, foxglove=foxglove, rerun=rerun)
    elif not remote and folder.is_dir() and not viewer_process.record_of(folder):
        raise RunFolderError(f"{folder}: found no run.json: the run has not begun, or this is not the folder of a run")
    elif other is not None and (busy := [str(each) for each in (folder, other) if _is_running(each)]):
        raise RunFolderError(f"{busy[0]}: the run is still in progress: expected two finished runs")
    elif remote or (other is None and _is_running(folder)):
        if frame is not None or rate != 1.0 or loop:
            raise typer.BadParameter("found a running run, expected a finished one for --frame, --rate and --loop")
        if other is not None:
            raise ConfigurationError("two runs on one timeline: expected the folders of two finished runs")
        chosen = {"--open": browser, "--foxglove": foxglove, "--rerun": rerun}
        options = [
            f"--port={port}",
            *([f"--run={run}"] if run else []),
            *(name for name, given in chosen.items() if given),
        ]
        raise typer.Exit(viewer_process.wait(viewer_process.start(target, *options)))
    elif foxglove or rerun:
        if other is not None:
            raise typer.BadParameter("found two runs, expected one: other viewers show one run")
        if frame is not None or browser:
            raise typer.BadParameter("--frame and --open are for this testbed's own page")
        _serve_to_other_viewers(folder, port, foxglove=foxglove, rate=rate, loop=loop)
    else:
        _show_finished([folder] if other is None else [folder, other], frame, port, browser)


def _is_running(folder: Path) -> bool:
    return viewer_process.record_of(folder).get("status") == "running"


def _show_finished(folders: list[Path], frame: int | None, port: int, browser: bool) -> None:
    from mast_zenoh.report.playback.server import ViewerServer, viewer_page

    with ViewerServer(viewer_page(folders, frame), port) as server:
        viewer_process.announce(server, browser)
        with suppress(KeyboardInterrupt):
            server.serve_forever()
    _out.print()


def _serve_to_other_viewers(folder: Path, port: int, *, foxglove: bool, rate: float, loop: bool) -> None:
    """Serve a finished run to one of the other viewers."""
    from mast_zenoh.viewer.servers import finished

    if foxglove:
        finished.serve_to_foxglove(folder, port, rate=rate, loop=loop, tell=viewer_process.tell)
    else:
        finished.serve_to_rerun(folder, port, tell=viewer_process.tell)
