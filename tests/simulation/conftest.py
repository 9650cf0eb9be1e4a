"""The small worlds, and their undisturbed outcomes, once for all tests."""

import pytest
from small_worlds import small_worlds

from mast_zenoh.testing.simulation import SimulatedWorld
from mast_zenoh.testing.simulation.promises import undisturbed


@pytest.fixture(scope="session")
def worlds() -> dict[str, SimulatedWorld]:
    """By name; each has been played undisturbed."""
    worlds = small_worlds()
    for world in worlds.values():
        assert undisturbed(world).ended
    return worlds
