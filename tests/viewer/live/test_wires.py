"""Lag and loss of wires are those of the messages that arrive, also if they are received only now and then."""

from __future__ import annotations

from typing import Any

import pytest

from mast_zenoh import scenario
from mast_zenoh.viewer.live.reception import LegState, WireMeter
from mast_zenoh.wiring.model import Wiring


class Kept:
    """The steps of the kept messages of each key."""

    def __init__(self) -> None:
        self.by_key: dict[str, list[int]] = {}

    def steps(self, key: str) -> list[int]:
        return self.by_key.get(key, [])

    def newest_step(self, key: str) -> int:
        return max(self.steps(key), default=-1)


@pytest.fixture(scope="module")
def wiring() -> Wiring:
    path, loaded = scenario.load("uncoordinated", ("n_infrastructure=1", "n_adversaries=1"))
    return Wiring.from_json(scenario.resolve(path, loaded, frames=2).wiring)


def test_loss_and_lag_are_of_the_steps_that_both_legs_can_have(wiring: Wiring) -> None:
    wire = next(each for each in wiring.wires if each.interposers)
    before, after = (leg.key for leg in wire.every_leg)
    kept: Any = Kept()
    meter = WireMeter(kept)

    def second_leg(step: int, entering: list[int], leaving: list[int]) -> LegState:
        kept.by_key = {before: entering, after: leaving}
        (state,) = (each for each in meter.states(wiring, {before: "", after: ""}, {}, step) if each.key == wire.key)
        assert state.legs[0].lost == 0.0
        return state.legs[1]

    assert (second_leg(0, [], []).lost, second_leg(0, [], []).lag) == (None, None), "nothing is known yet"
    first = second_leg(9, [4, 5, 6, 7, 8, 9], [6, 7, 8])
    assert (first.lost, first.lag) == (0.0, 1), "6 and 7 arrived; 4 and 5 were before, 8 and 9 may be under way"
    assert second_leg(109, [104, 105, 106, 107], [104, 106, 107]).lost == pytest.approx(1 / 6), "of 6, 7, 104 to 107"
    for _ in range(5):
        blocked = second_leg(209, [204, 205, 206, 207], [])
    assert (blocked.lost, blocked.lag) == (1.0, None), "a wire that is blocked"
