"""Fixtures for pytest: `from mast_zenoh.testing.fixtures import play`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from mast_zenoh.api import runs
from mast_zenoh.api.runs import OpenedRun, Scenario


@pytest.fixture
def play(tmp_path: Path) -> Callable[..., OpenedRun]:
    """A function that runs a scenario in this process: `mast_zenoh.run`.

    Into a folder of the test; 20 frames by default.
    """
    done: list[OpenedRun] = []

    def played(scenario: Scenario, **options: Any) -> OpenedRun:
        usual: dict[str, Any] = {"frames": 20, "out": tmp_path / f"run_{len(done)}"}
        done.append(runs.run(scenario, **usual | options))
        return done[-1]

    return played
