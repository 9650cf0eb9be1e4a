"""Serves one page on a loopback port: the viewer of one finished run, or of two on one timeline."""

from __future__ import annotations

from collections.abc import Sequence
from http import HTTPStatus
from pathlib import Path

from mast_zenoh.errors import NotComparable, RunFolderError
from mast_zenoh.report.page import page_text
from mast_zenoh.report.playback.block import run_block
from mast_zenoh.report.playback.inline import policy, viewer_parts
from mast_zenoh.report.runfolder import RunFolder
from mast_zenoh.viewer.loopback import LoopbackHandler, LoopbackServer


def viewer_page(folders: Sequence[Path], frame: int | None = None) -> str:
    """The page with the runs in these folders, one or two.

    frame: to show first
    Raises RunFolderError for a folder that holds no run, or nothing to show; NotComparable for two runs without a
    common agent.
    """
    runs = [RunFolder.load(folder) for folder in folders]
    blocks = []
    for run in runs:
        try:
            block = run_block(run, frame)
        except ValueError as error:
            raise RunFolderError(f"{run.path}: cannot be shown: {error}") from None
        if block is None:
            raise RunFolderError(f"{run.path}: expected objects.parquet or scene.npz: the run has nothing to show")
        blocks.append(block)
    if len(runs) > 1:
        agents = [set(run.recording.agent_names if run.recording else run.metrics.get("agents", ())) for run in runs]
        if not agents[0] & agents[1]:
            names = " and ".join(", ".join(sorted(each)) for each in agents)
            raise NotComparable(
                f"{runs[0].path} and {runs[1].path}: found the agents {names}, expected runs with a common agent"
            )
    title = " and ".join(run.label if run.label != runs[0].label or run is runs[0] else run.path.name for run in runs)
    return page_text("viewer.html.j2", {"title": title, "headline": title, "viewer": viewer_parts(blocks)})


class ViewerServer(LoopbackServer):
    """Serves one page.

    page: as from `viewer_page`;  port: 0 for any free one
    Raises ConfigurationError if the port cannot be used.
    """

    def __init__(self, page: str, port: int = 0) -> None:
        self.content = page.encode("utf-8", "surrogateescape")
        super().__init__(port, _Handler)


class _Handler(LoopbackHandler):
    server: ViewerServer

    def answer(self, path: str) -> None:
        """Send the page; anything else is not found."""
        if path != "/":
            self.send_error(HTTPStatus.NOT_FOUND)
        else:
            self.send_content(self.server.content, "text/html; charset=utf-8", policy())
