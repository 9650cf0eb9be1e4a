"""Recorded runs, each made once."""

from collections.abc import Callable
from pathlib import Path

import pytest
from recorded_runs import record


@pytest.fixture(scope="session")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """The folder of a recorded run, by its name in `recorded_runs.RUNS`."""
    made: dict[str, Path] = {}

    def of(name: str) -> Path:
        if name not in made:
            made[name] = record(name, tmp_path_factory.mktemp("recorded") / name)
        return made[name]

    return of
