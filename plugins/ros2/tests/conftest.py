"""A recorded run, with the fixtures that the tests of the viewer have; and a router of ROS 2."""

from collections.abc import Iterator

import pytest

import mast_zenoh as mast
from mast_zenoh.mesh.session import open_router
from tests.viewer.conftest import exported_to, out, record

__all__ = ["exported_to", "out", "record"]


@pytest.fixture(scope="session")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> mast.Run:
    """A run whose adversaries insert tracks on the wires of two agents."""
    out = tmp_path_factory.mktemp("exported") / "run"
    return mast.run("coordinated", frames=10, seed=3, attack_start_s=0.5, out=out)


@pytest.fixture(scope="module")
def router() -> Iterator[str]:
    """The endpoint of a router."""
    session, endpoint = open_router()
    with session:
        yield endpoint
