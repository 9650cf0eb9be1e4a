"""The files of Rerun's web viewer come out of the program of the installed rerun-sdk."""

from __future__ import annotations

from pathlib import Path

import pytest

from mast_zenoh.errors import ExportError
from mast_zenoh.viewer.servers.rerun import web_viewer_files


def test_a_web_viewer_that_fails_at_once_is_reported_with_its_last_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "rerun_cli.py").write_text("import sys\nsys.exit('error: no web viewer in this build')\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    with pytest.raises(ExportError, match="the program ended: error: no web viewer in this build: use the native"):
        web_viewer_files()
