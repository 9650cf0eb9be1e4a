"""A report that cannot be written hides no failure of its run, and calls no failed run complete."""

from __future__ import annotations

import errno
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from mast_zenoh.cli import options
from mast_zenoh.errors import DiskFull, HandlerFailed


def full(*_: object, **__: object) -> None:
    raise OSError(errno.ENOSPC, "No space left on device")


def finished(folder: Path, error: Exception | None) -> Any:
    return SimpleNamespace(folder=folder, error=error)


def test_the_error_of_a_failed_run_is_raised_and_that_of_its_report_is_a_warning(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(options, "_show", full)
    with pytest.raises(HandlerFailed, match="its own"):
        options.conclude(finished(tmp_path, HandlerFailed("its own")), report=True)
    told = " ".join(capsys.readouterr().err.split())
    assert "No space left on device; the results in" in told
    assert "are those of a failed run, without a report" in told
    assert "complete" not in told


def test_a_run_that_did_not_fail_is_complete_without_its_report(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(options, "_show", full)
    with pytest.raises(DiskFull, match="are complete except for the report"):
        options.conclude(finished(tmp_path, None), report=True)
