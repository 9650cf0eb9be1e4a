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
) -> None:
    """Show a finished run in a browser, or two on one timeline, until Ctrl-C."""
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
