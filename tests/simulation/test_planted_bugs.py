"""The simulation finds each planted bug within a thousand seeds."""

from __future__ import annotations

from itertools import cycle

import pytest
from planted_bugs import PLANTS, Plant

from mast_zenoh.testing.simulation import World, find, simplest

SEEDS = 1000


@pytest.mark.parametrize("plant", PLANTS, ids=lambda plant: plant.__name__)
def test_a_planted_bug_is_found(plant: Plant, worlds: dict[str, World], monkeypatch: pytest.MonkeyPatch) -> None:
    plant(monkeypatch)
    names = cycle(PLANTS[plant])
    assert any(find(worlds[name], [seed]) for seed, name in zip(range(SEEDS), names, strict=False)), plant.__doc__


def test_a_schedule_with_which_a_promise_is_broken_is_simplified(
    worlds: dict[str, World], monkeypatch: pytest.MonkeyPatch
) -> None:
    (dead,) = (plant for plant in PLANTS if plant.__name__ == "a_dead_node_is_waited_for")
    dead(monkeypatch)
    broken = find(worlds["lockstep"], range(SEEDS))
    assert broken is not None
    simple = simplest(worlds["lockstep"], broken)
    assert [disturbance.kind for disturbance in simple.schedule.disturbances] == ["kill"]
    assert "kill" in str(simple)
    assert repr(simple.schedule) in str(simple)
