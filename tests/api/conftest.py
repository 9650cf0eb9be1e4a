"""Two short runs of one junction, one attacked, for tests of the Python API."""

from pathlib import Path

import pytest

import mast_zenoh as mast

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


@pytest.fixture
def failing_scenario(tmp_path: Path) -> Path:
    """A file of a scenario with a node whose handler always fails."""
    (tmp_path / "failing.py").write_text(
        "from mast_zenoh.node import Node\n\nclass Failing(Node):\n"
        "    role = 'failing'\n    inputs = dict(everything='*')\n"
        "    def on_everything(self, received, context):\n        raise KeyError('no')\n"
    )
    path = tmp_path / "bad.py"
    path.write_text(
        "from mast_zenoh.scenario import load\n\ndef scenario(n_infrastructure=1):\n"
        "    return load('baseline', ['n_infrastructure=1'])[1] | dict(nodes=dict(bad=dict(role='failing')))\n"
    )
    return path
