"""One attacked run of five agents, read message by message with nothing but mcap and msgpack."""

from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest
from plain_record import PlainRecord

import mast_zenoh as mast
from mast_zenoh.show.export import export

FRAMES = 30  # more than a chunk of the recording


@pytest.fixture(scope="session")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> mast.Run:
    """A run whose adversaries insert tracks on the wires of two agents."""
    out = tmp_path_factory.mktemp("exported") / "run"
    return mast.run("coordinated", frames=FRAMES, seed=3, attack_start_s=0.5, out=out)


@pytest.fixture(scope="session")
def record(recorded: mast.Run) -> PlainRecord:
    """What the recording of that run holds."""
    return PlainRecord(recorded.path)


@pytest.fixture(scope="session")
def exported_to(recorded: mast.Run, tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Exports that run to a format, once; returns the path."""

    @cache
    def written(name: str) -> Path:
        out = tmp_path_factory.mktemp(name) / {"foxglove": "run.mcap", "rrd": "run.rrd"}.get(name, name)
        files = (out.with_name("run.layout.json"), out) if name == "foxglove" else (out,)
        assert export(recorded.path, name, out).paths == files
        return out

    return written


@pytest.fixture
def out(tmp_path: Path) -> Path:
    """A path for an export."""
    return tmp_path / "exported"


@pytest.fixture(scope="session")
def broadcast(tmp_path_factory: pytest.TempPathFactory) -> mast.Run:
    """A run whose peers broadcast CPMs, one of them through an adversary."""
    attack = dict(n_adversaries=1, attack_start_s=0.3, awareness=True)
    out = tmp_path_factory.mktemp("broadcast") / "run"
    return mast.run("congested", frames=12, seed=3, n_infrastructure=3, n_mobile=1, **attack, out=out)
