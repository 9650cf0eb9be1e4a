"""Two short runs of one junction, one attacked, for tests of the Python API."""

from __future__ import annotations

from pathlib import Path

import pytest
from judged import FAULTS

import mast_zenoh as mast
from mast_zenoh.scenario.reading import load

FRAMES, SEED = 60, 3


@pytest.fixture(scope="session")
def baseline(tmp_path_factory: pytest.TempPathFactory) -> mast.Run:
    """A run without adversaries."""
    out: Path = tmp_path_factory.mktemp("baseline") / "run"
    return mast.run("baseline", n_infrastructure=2, frames=FRAMES, seed=SEED, out=out)


@pytest.fixture(scope="session")
def attacked(tmp_path_factory: pytest.TempPathFactory) -> mast.Run:
    """The same scenario with one adversary, which starts after two seconds."""
    out: Path = tmp_path_factory.mktemp("attacked") / "run"
    parameters = dict(n_infrastructure=2, n_adversaries=1, attack_start_s=2.0)
    return mast.run("uncoordinated", frames=FRAMES, seed=SEED, out=out, **parameters)


@pytest.fixture(scope="session")
def judged(tmp_path_factory: pytest.TempPathFactory) -> mast.Run:
    """A run with one adversary and two faults, whose command centre judges agents."""
    out: Path = tmp_path_factory.mktemp("judged") / "run"
    _, scenario = load("defended", ["n_adversaries=1", "defence=SequentialConsistency"])
    return mast.run(scenario | dict(faults=FAULTS), frames=90, seed=11, out=out)
