"""`mast view RUN [OTHER]`: runs in a browser."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mast_zenoh.cli.options import out as _out


def view(
    run_folder: Annotated[Path, typer.Argument(metavar="RUN", help="The folder of a finished run.")],
    other: Annotated[Path | None, typer.Argument(metavar="OTHER", help="Another run, on the same timeline.")] = None,
    frame: Annotated[int | None, typer.Option(min=0, help="The frame to show first.")] = None,
    port: Annotated[int, typer.Option(min=0, max=65535, help="The port on this computer; 0: any free one.")] = 0,
    browser: Annotated[bool, typer.Option("--open", help="Open the page in a browser.")] = False,
    foxglove: Annotated[bool, typer.Option("--foxglove", help="Play it for Foxglove and Lichtblick instead.")] = False,
    rerun: Annotated[bool, typer.Option("--rerun", help="Serve it to the Rerun viewer instead.")] = False,
    rate: Annotated[float, typer.Option(min=0.01, max=100.0, help="--foxglove: s of the scene per s.")] = 1.0,
    loop: Annotated[bool, typer.Option("--loop", help="--foxglove: begin again at the end.")] = False,
) -> None:
    """Show a finished run in a browser, or two on one timeline, until Ctrl-C."""
    if foxglove or rerun:
        _serve_to_other_viewers(run_folder, other, port, foxglove=foxglove, rerun=rerun, rate=rate, loop=loop)
        return
    from mast_zenoh.report.playback.server import ViewerServer, viewer_page

    page = viewer_page([run_folder] if other is None else [run_folder, other], frame)
    with ViewerServer(page, port) as server:
        _out.print(f"view: {server.url}", markup=False, highlight=False)
        _out.print(f"from another computer: {server.tunnel}", markup=False, highlight=False)
        _out.print("Ctrl-C ends it.", markup=False, highlight=False)
        if browser:
            import webbrowser

            webbrowser.open(server.url)
        try:
            server.serve_forever()
        except KeyboardInterrupt:
            _out.print()


def _serve_to_other_viewers(
    run_folder: Path, other: Path | None, port: int, *, foxglove: bool, rerun: bool, rate: float, loop: bool
) -> None:
    """Serve one run to one of the other viewers."""
    from mast_zenoh.viewer.servers import finished

    def tell(line: str) -> None:
        _out.print(line, markup=False, highlight=False, soft_wrap=True)

    if foxglove and rerun:
        raise typer.BadParameter("found --foxglove and --rerun, expected one of them")
    if other is not None:
        raise typer.BadParameter("found two runs, expected one: other viewers show one run")
    if foxglove:
        finished.serve_to_foxglove(run_folder, port, rate=rate, loop=loop, tell=tell)
    else:
        finished.serve_to_rerun(run_folder, port, tell=tell)
