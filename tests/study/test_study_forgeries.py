"""What insiders send: the same for the same seed, and refused by its decoder where it is called malformed."""

from __future__ import annotations

import functools
import tracemalloc

import pytest
from decoders import refused
from hypothesis import given, settings
from hypothesis import strategies as st

from mast_zenoh import scenario, version
from mast_zenoh.control import CONTROLS
from mast_zenoh.study.rogue.forgeries import DAMAGED, FALSE, MALFORMED, forgeries
from mast_zenoh.study.rogue.position import Position, position

every_kind = pytest.mark.parametrize("control", CONTROLS)


@functools.cache
def standing(node: str = "infra_1") -> Position:
    path, loaded = scenario.load("coordinated", ["n_infrastructure=2"])
    return position(scenario.resolve(path, loaded, frames=2, record=True), node, version.version_string())


@every_kind
@settings(max_examples=20)
@given(seed=st.integers(0, 1 << 32), node=st.sampled_from(["infra_1", "broker", "recorder", "evaluator"]))
def test_a_malformed_forgery_is_refused_with_a_message_error_and_nothing_else(
    control: str, seed: int, node: str
) -> None:
    for forgery in forgeries(control, standing(node), 6, seed):
        taken = not refused(control, node, forgery.payload)
        assert not (taken and forgery.made == MALFORMED), forgery


@every_kind
def test_two_hundred_forgeries_are_refused_or_taken_and_all_kinds_are_among_them(control: str) -> None:
    made = forgeries(control, standing(), 200)
    assert len(made) == 200
    assert {each.made for each in made} == {MALFORMED, DAMAGED, FALSE}
    assert len({each.payload for each in made}) > 20
    for each in made:
        was_refused = refused(control, "infra_1", each.payload)
        assert was_refused or each.made != MALFORMED, each.payload[:100]


@every_kind
def test_the_same_seed_gives_the_same_forgeries_and_another_seed_others(control: str) -> None:
    first, again, other = (forgeries(control, standing(), 30, seed) for seed in (1, 1, 2))
    assert first == again
    assert first != other


def test_what_is_of_ones_own_goes_to_ones_own_key_and_to_those_of_others() -> None:
    where = standing()
    for control in ("counts", "result", "fetch", "file", "failed", "leave", "drain"):
        owners = {each.own for each in forgeries(control, where, 200)}
        assert where.node in owners
        assert owners & {*where.others}
    assert {each.key for each in forgeries("stop", where, 200)} == {"stop"}
    assert not {*where.publishes, *where.hears} & {*where.foreign}


@every_kind
def test_what_unpacks_to_far_more_than_it_is_takes_no_memory(control: str) -> None:
    made = [each for each in forgeries(control, standing(), 200) if each.made == MALFORMED]
    heavy = sorted((each.payload for each in made), key=len)[-5:]
    tracemalloc.start()
    try:
        for payload in heavy:
            assert refused(control, "infra_1", payload)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 96 << 20, "of payloads of at most 8 MiB"
