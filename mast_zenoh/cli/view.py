"""`mast view`: runs in a browser or in other viewers, running or finished."""

from __future__ import annotations

import threading
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from mast_zenoh.cli import completion, viewer_process
from mast_zenoh.cli.options import Confirmed, allowed_code
from mast_zenoh.cli.options import out as _out
from mast_zenoh.errors import ConfigurationError, RunFolderError
from mast_zenoh.run_files import reading

_PROTOCOLS = ("tcp", "tls", "udp", "quic", "ws")


@dataclass(frozen=True)
class _Options:
    """The options of `mast view` as the user gave them; their help texts describe them."""

    other: Path | None
    frame: int | None
    run: str
    port: int
    browser: bool
    foxglove: bool
    rerun: bool
    rate: float
    loop: bool
    confirmed: bool

    def check(self) -> None:
        """Raise BadParameter for options that exclude each other for every run."""
        if self.foxglove and self.rerun:
            raise typer.BadParameter("found --foxglove and --rerun, expected one of them")
        if not self.foxglove and (self.rate != 1.0 or self.loop):
            raise typer.BadParameter("--rate and --loop are for --foxglove")
        if self.foxglove or self.rerun:
            if self.other is not None:
                raise typer.BadParameter("found two runs, expected one: other viewers show one run")
            if self.frame is not None or self.browser:
                raise typer.BadParameter("--frame and --open are for this testbed's own page")


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
    confirmed: Confirmed = False,
    attached: Annotated[bool, typer.Option("--attached", hidden=True)] = False,
) -> None:
    """Show a run in a browser while it is running or afterwards, or two finished runs on one timeline.

    Ctrl-C ends the viewer; it never ends the run.
    """
    options = _Options(other, frame, run, port, browser, foxglove, rerun, rate, loop, confirmed)
    options.check()
    remote = _is_router(target)
    if attached:
        allowed = allowed_code(confirmed=confirmed)
        viewer_process.observe(
            target, run, port, allowed, remote=remote, browser=browser, foxglove=foxglove, rerun=rerun
        )
    elif remote:
        _view_router(target, options)
    elif _is_running(Path(target)):
        _view_running(Path(target), options)
    else:
        _view_finished(Path(target), options)


def _is_router(target: str) -> bool:
    """Whether a target is the address of a router, and not a folder."""
    return "/" in target and target.partition("/")[0] in _PROTOCOLS and not Path(target).exists()


def _is_running(folder: Path) -> bool:
    return viewer_process.record_of(folder).get("status") == "running"


def _view_router(router: str, options: _Options) -> None:
    """Show a running run of a router."""
    _check_for_running(options)
    if options.other is not None:
        raise ConfigurationError("two runs on one timeline: expected the folders of two finished runs")
    _observe(router, options)


def _view_running(folder: Path, options: _Options) -> None:
    """Show the running run in a folder."""
    if options.other is not None:
        raise _in_progress(folder)
    _check_for_running(options)
    _check_for_folder(folder, options)
    from mast_zenoh.launch.liveness import check_from_here

    record = viewer_process.record_of(folder)
    check_from_here(folder, record, allowed_code(confirmed=options.confirmed), f"the router {record.get('endpoint')}")
    _observe(str(folder), options)


def _view_finished(folder: Path, options: _Options) -> None:
    """Show the finished run in a folder, or two of them."""
    if folder.is_dir() and not viewer_process.record_of(folder):
        raise RunFolderError(f"{folder}: found no run.json: the run has not begun, or this is not the folder of a run")
    if options.other is not None and _is_running(options.other):
        raise _in_progress(options.other)
    _check_for_folder(folder, options)
    if options.foxglove or options.rerun:
        _serve_to_other_viewers(folder, options)
    else:
        _show_finished([folder] if options.other is None else [folder, options.other], options)


def _check_for_running(options: _Options) -> None:
    if options.frame is not None or options.rate != 1.0 or options.loop:
        raise typer.BadParameter("found a running run, expected a finished one for --frame, --rate and --loop")


def _check_for_folder(folder: Path, options: _Options) -> None:
    if options.run:
        raise typer.BadParameter(f"found {folder}, expected a router, such as tcp/HOST:7447, for --run")


def _in_progress(folder: Path) -> RunFolderError:
    return RunFolderError(f"{folder}: the run is still in progress: expected two finished runs")


def _observe(target: str, options: _Options) -> None:
    """Show a running run in a process of its own; ends the command with its exit code."""
    chosen = {
        "--open": options.browser,
        "--foxglove": options.foxglove,
        "--rerun": options.rerun,
        "--trust": options.confirmed,
    }
    words = [
        f"--port={options.port}",
        *([f"--run={options.run}"] if options.run else []),
        *(name for name, given in chosen.items() if given),
    ]
    raise typer.Exit(viewer_process.wait(viewer_process.start(target, *words)))


def _show_finished(folders: list[Path], options: _Options) -> None:
    from mast_zenoh.viewer.page.page import ViewerServer, viewer_page

    with reading(folders[-1]):
        page = viewer_page(folders, options.frame)
    with ViewerServer(page, options.port) as server:
        viewer_process.announce(server.url, options.browser)
        with suppress(KeyboardInterrupt):
            server.serve_forever()
    _out.print()


def _serve_to_other_viewers(folder: Path, options: _Options) -> None:
    """Serve a finished run to one of the other viewers until Ctrl-C."""
    from mast_zenoh.viewer.recorded import RecordedRun
    from mast_zenoh.viewer.servers.other_viewers import serve_to_foxglove, serve_to_rerun

    with reading(folder):
        run = RecordedRun.load(folder)
    never, print_line = threading.Event(), viewer_process.print_line
    if options.foxglove:
        serve_to_foxglove(run, options.port, never, print_line, rate=options.rate, loop=options.loop)
    else:
        serve_to_rerun(run, options.port, never, print_line)
