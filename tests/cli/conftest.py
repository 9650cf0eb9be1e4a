"""The command line, run in this process."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from mast_zenoh.cli import app


@pytest.fixture
def mast(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> Callable[..., tuple[int, str, str]]:
    """Run a command in an empty folder; returns exit code, stdout and stderr."""
    monkeypatch.chdir(tmp_path)

    def run(*words: str) -> tuple[int, str, str]:
        monkeypatch.setattr("sys.argv", ["mast", *words])
        with pytest.raises(SystemExit) as raised:
            app.main()
        printed = capsys.readouterr()
        return int(raised.value.code or 0), printed.out, printed.err

    return run
