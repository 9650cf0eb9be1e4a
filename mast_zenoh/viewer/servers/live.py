"""Serves running runs to other viewers, until they end or the user does."""

from __future__ import annotations

import tempfile
import threading
from pathlib import Path

from mast_zenoh.viewer.export import not_installed
from mast_zenoh.viewer.frame import FrameSource
from mast_zenoh.viewer.servers.finished import Tell, tell_end, web_viewer


def serve_to_foxglove(run: FrameSource, port: int, stop: threading.Event, tell: Tell) -> None:
    """Send a run to Foxglove and Lichtblick while it is running.

    port: 0 for any free one;  stop: ends the server, also after the run

    Raises ExportError if foxglove-sdk is not installed, ConfigurationError if the port cannot be used.
    """
    try:
        from mast_zenoh.viewer.export.foxglove import write_layout
        from mast_zenoh.viewer.servers.foxglove import FoxgloveServer
    except ModuleNotFoundError as error:
        raise not_installed(error, "foxglove") from None
    with tempfile.TemporaryDirectory(prefix="mast-foxglove-") as folder:
        layout = Path(folder) / f"{run.name}.layout.json"
        write_layout(run, layout)
        server = FoxgloveServer(run, port)
        try:
            tell(f"foxglove: {server.url}")
            tell(f"layout: {layout}")
            tell_end(server.tunnel, (), tell)
            server.serve()
            stop.wait()
        finally:
            server.close()


def serve_to_rerun(run: FrameSource, port: int, stop: threading.Event, tell: Tell) -> None:
    """Send a run to the Rerun viewer while it is running.

    port: 0 for any free one;  stop: ends the server, also after the run

    Raises ExportError if rerun-sdk is not installed, ConfigurationError if the port cannot be used.
    """
    try:
        from mast_zenoh.viewer.servers.rerun import RerunServer, serve_live
        from mast_zenoh.viewer.servers.rrd_stream import RrdStream
    except ModuleNotFoundError as error:
        raise not_installed(error, "rerun") from None
    viewer = web_viewer(tell)
    stream = RrdStream(run)
    with RerunServer(stream, viewer, port, tell) as server:
        if viewer:
            tell(f"view: {server.url}")
        tell(f"native viewer: rerun {server.recording_url}")
        tell_end(server.tunnel, (), tell)

        def end() -> None:
            stop.wait()
            server.shutdown()

        threading.Thread(target=end, daemon=True).start()
        serve_live(stream, server)
