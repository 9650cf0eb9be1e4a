"""Fixtures of the tests of the evaluation: whole runs in one process, each played once."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from played import Played, play


@pytest.fixture(scope="session", autouse=True)
def own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Scenes prepared by tests do not touch the user's cache, nor come from it."""
    folder = tmp_path_factory.mktemp("cache")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(folder))
        yield folder


@pytest.fixture(scope="session")
def once(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Played]:
    """`play`, but every run is played only once in a session."""
    runs: dict[tuple[str, ...], Played] = {}

    def get(name: str, *settings: str, **files: str) -> Played:
        key = name, *settings
        if key not in runs:
            runs[key] = play(tmp_path_factory.mktemp("run"), name, *settings, **files)
        return runs[key]

    return get
