"""A sound run, of which hostile folders are copies."""

from pathlib import Path

import pytest
from commands_in_process import command


@pytest.fixture(scope="session")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a short recorded run of shipped classes, with V2X messages and with trust."""
    folder = tmp_path_factory.mktemp("sound") / "run"
    sizes = ("--set", "n_infrastructure=2", "--set", "n_adversaries=1")
    maps = "keyexpr.rewrites=['on_detections.toml', 'views.toml', 'cpm.toml']"
    sizes += ("--set", maps, "--set", "command_center.pipeline.integrity={'type': 'Pasac'}")
    sizes += ("--set", "agents.*.tracks_from='agent'")
    words = ("run", "uncoordinated", "--frames", "3", "--runtime", "inproc", "--no-report", *sizes)
    assert command(*words, "--out", folder).code == 0
    return folder
