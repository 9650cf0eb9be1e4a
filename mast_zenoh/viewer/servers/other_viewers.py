"""Serves runs, finished or running, to Foxglove, Lichtblick and Rerun, and prints their addresses."""

from __future__ import annotations

import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from mast_zenoh.errors import ExportError
from mast_zenoh.viewer.export import not_installed
from mast_zenoh.viewer.frame import FramedRun
from mast_zenoh.viewer.loopback import tunnel
from mast_zenoh.viewer.recorded import RecordedRun
from mast_zenoh.viewer.servers.playback import Playback

#: Prints a line for the user.
PrintLine = Callable[[str], None]


def serve_to_foxglove(
    run: FramedRun, port: int, stop: threading.Event, print_line: PrintLine, *, rate: float = 1.0, loop: bool = False
) -> None:
    """Play a finished run for Foxglove and Lichtblick until Ctrl-C, or send a running one as it comes.

    port: 0 for any free one;  stop: ends the server of a running run, also after the run
    rate, loop: of a finished run, see `Playback`

    Raises ExportError if foxglove-sdk is not installed, RunFolderError if the run cannot be read, and
    ConfigurationError if the port cannot be used.
    """
    with _required("foxglove"):
        from mast_zenoh.viewer.export.foxglove import write_layout
        from mast_zenoh.viewer.servers.foxglove import FoxgloveServer

    playback = Playback(run, rate=rate, loop=loop) if isinstance(run, RecordedRun) else None
    with tempfile.TemporaryDirectory(prefix="mast-foxglove-") as folder:
        layout = Path(folder) / f"{_name(run)}.layout.json"
        write_layout(run, layout)
        server = FoxgloveServer(run, port, playback)
        try:
            print_line(f"foxglove: {server.url}")
            print_line(f"layout: {layout}")
            _print_end(server.url, run, print_line)
            server.serve()
            stop.wait()
        except KeyboardInterrupt:
            print_line("")
        finally:
            server.close()


def serve_to_rerun(run: FramedRun, port: int, stop: threading.Event, print_line: PrintLine) -> None:
    """Serve a run to the Rerun viewer, in a browser or native: a finished one until Ctrl-C, a running one as it comes.

    port: 0 for any free one;  stop: ends the server of a running run, also after the run

    Raises ExportError if rerun-sdk is not installed, RunFolderError if the run cannot be read, and ConfigurationError
    if the port cannot be used.
    """
    with _required("rerun"):
        from mast_zenoh.viewer.export import rrd
        from mast_zenoh.viewer.servers.rerun import RerunServer, RrdStream, serve_live

    viewer = _web_viewer(print_line)
    with tempfile.TemporaryDirectory(prefix="mast-rerun-") as folder:
        recording: Path | RrdStream
        if isinstance(run, RecordedRun):
            recording = Path(folder) / "run.rrd"
            rrd.write(run, recording)
        else:
            recording = RrdStream(run)
        with RerunServer(recording, viewer, port, print_line) as server:
            if viewer:
                print_line(f"view: {server.url}")
            print_line(f"native viewer: rerun {server.recording_url}")
            _print_end(server.url, run, print_line)
            try:
                if isinstance(recording, Path):
                    server.serve_forever()
                else:
                    serve_live(recording, server, stop)
            except KeyboardInterrupt:
                print_line("")


@contextmanager
def _required(extra: str) -> Iterator[None]:
    """Raise ExportError if an import in this context fails because optional packages are not installed."""
    try:
        yield
    except ModuleNotFoundError as error:
        raise not_installed(error, extra) from None


def _name(run: FramedRun) -> str:
    return run.path.resolve().name if isinstance(run, RecordedRun) else run.id


def _web_viewer(print_line: PrintLine) -> dict[str, bytes]:
    """The files of Rerun's web viewer; empty, and a line for the user, if they cannot be found."""
    from mast_zenoh.viewer.servers.rerun import web_viewer_files

    try:
        return web_viewer_files()
    except ExportError as error:
        print_line(f"no page: {error}")
        return {}


def _print_end(url: str, run: FramedRun, print_line: PrintLine) -> None:
    """Print the last lines of every server; what a finished run lacks is known when it has been read."""
    print_line(f"from another computer: {tunnel(url)}")
    for sentence in run.missing if isinstance(run, RecordedRun) else ():
        print_line(f"warning: {sentence}")
    print_line("Ctrl-C ends it.")
