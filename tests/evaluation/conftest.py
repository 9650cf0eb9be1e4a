"""Fixtures for evaluation tests: whole runs in one process, played once."""

from collections.abc import Callable

import pytest
from played import Played, play


@pytest.fixture(scope="session")
def once(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Played]:
    """`play`, with every run played once per session."""
    runs: dict[tuple[str, ...], Played] = {}

    def get(name: str, *settings: str, **files: str) -> Played:
        key = name, *settings
        if key not in runs:
            runs[key] = play(tmp_path_factory.mktemp("run"), name, *settings, **files)
        return runs[key]

    return get
