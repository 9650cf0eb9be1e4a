"""Serves finished runs to other viewers until Ctrl-C."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

from mast_zenoh.errors import ExportError
from mast_zenoh.viewer.export import not_installed
from mast_zenoh.viewer.frames import RunFrames

#: Prints a line for the user.
Tell = Callable[[str], None]


def serve_to_foxglove(path: Path, port: int, *, rate: float, loop: bool, tell: Tell) -> None:
    """Play a run for Foxglove and Lichtblick.

    path: the run's folder;  port: 0 for any free one;  rate, loop: see `Playback`

    Raises ExportError if foxglove-sdk is not installed, RunFolderError if the run cannot be read, and
    ConfigurationError if the port cannot be used.
    """
    try:
        from mast_zenoh.viewer.export.foxglove import write_layout
        from mast_zenoh.viewer.servers.foxglove import FoxgloveServer
    except ModuleNotFoundError as error:
        raise not_installed(error, "foxglove") from None
    from mast_zenoh.viewer.servers.playback import Playback

    run = RunFrames.load(path)
    playback = Playback(run, rate=rate, loop=loop)
    with tempfile.TemporaryDirectory(prefix="mast-foxglove-") as folder:
        layout = Path(folder) / f"{path.resolve().name}.layout.json"
        write_layout(run, layout)
        server = FoxgloveServer(run, port, playback)
        try:
            tell(f"foxglove: {server.url}")
            tell(f"layout: {layout}")
            tell_end(server.tunnel, run.missing, tell)
            server.serve()
        except KeyboardInterrupt:
            tell("")
        finally:
            server.close()


def serve_to_rerun(path: Path, port: int, *, tell: Tell) -> None:
    """Serve a run to the Rerun viewer, in a browser or native.

    path: the run's folder;  port: 0 for any free one

    Raises ExportError if rerun-sdk is not installed, RunFolderError if the run cannot be read, and ConfigurationError
    if the port cannot be used.
    """
    try:
        from mast_zenoh.viewer.export import rrd
        from mast_zenoh.viewer.servers.rerun import RerunServer
    except ModuleNotFoundError as error:
        raise not_installed(error, "rerun") from None

    run = RunFrames.load(path)
    viewer = web_viewer(tell)
    with tempfile.TemporaryDirectory(prefix="mast-rerun-") as folder:
        recording = Path(folder) / "run.rrd"
        rrd.write(run, recording)
        with RerunServer(recording, viewer, port, tell) as server:
            if viewer:
                tell(f"view: {server.url}")
            tell(f"native viewer: rerun {server.recording_url}")
            tell_end(server.tunnel, run.missing, tell)
            try:
                server.serve_forever()
            except KeyboardInterrupt:
                tell("")


def web_viewer(tell: Tell) -> dict[str, bytes]:
    """The files of Rerun's web viewer; empty, and a line for the user, if they cannot be found."""
    from mast_zenoh.viewer.servers.web_viewer import web_viewer_files

    try:
        return web_viewer_files()
    except ExportError as error:
        tell(f"no page: {error}")
        return {}


def tell_end(tunnel: str, missing: Sequence[str], tell: Tell) -> None:
    """The last lines that every server prints."""
    tell(f"from another computer: {tunnel}")
    for sentence in missing:
        tell(f"warning: {sentence}")
    tell("Ctrl-C ends it.")
