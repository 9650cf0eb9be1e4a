"""Fixtures for evaluation tests: whole runs in one process, played once."""

from collections.abc import Callable

import pytest
from observed_run import ObservedRun
from played import FRAMES, Played, play, play_observed
from shipped import every, label

from mast_zenoh import scenario


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


@pytest.fixture(scope="session")
def shipped(tmp_path_factory: pytest.TempPathFactory) -> Callable[[tuple[str, ...]], tuple[Played, ObservedRun]]:
    """Play each shipped scenario as an `ObservedRun`, once per session."""
    runs: dict[tuple[str, ...], tuple[Played, ObservedRun]] = {}

    def get(variant: tuple[str, ...]) -> tuple[Played, ObservedRun]:
        if variant not in runs:
            path, content = scenario.load(variant[0], list(variant[1:]))
            resolved = scenario.resolve(path, content, frames=FRAMES, seed=0, record=True)
            runs[variant] = play_observed(tmp_path_factory.mktemp("run"), resolved)
        return runs[variant]

    return get


@pytest.fixture(params=every(), ids=label)
def variant(request: pytest.FixtureRequest) -> tuple[str, ...]:
    """One of the shipped scenarios, with its settings."""
    return request.param
