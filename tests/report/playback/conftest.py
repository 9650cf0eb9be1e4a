"""One attacked and defended run, shared by all tests of the moving picture."""

from __future__ import annotations

from pathlib import Path

import pytest

from mast_zenoh import scenario
from mast_zenoh.launch import run as launcher
from mast_zenoh.report.runfolder import RunFolder

FRAMES = 56


@pytest.fixture(scope="session")
def attacked_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a run with two adversaries and a command centre that judges agents."""
    folder = tmp_path_factory.mktemp("runs") / "attacked"
    path, loaded = scenario.load("defended", ["attack_start_s=2.0", "defence=SequentialConsistency"])
    resolved = scenario.resolve(path, loaded, frames=FRAMES, record=True)
    return launcher.run(resolved, folder, runtime="inproc").folder


@pytest.fixture(scope="session")
def loaded_run(attacked_run: Path) -> RunFolder:
    return RunFolder.load(attacked_run)
