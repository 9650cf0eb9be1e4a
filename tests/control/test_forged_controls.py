"""Forged messages are reproducible by seed, and refused if malformed."""

from __future__ import annotations

import functools
import tracemalloc

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from insider.forgeries import DAMAGED, FALSE, MALFORMED, forgeries, refused
from insider.position import Position, position

from mast_zenoh import scenario, version
from mast_zenoh.control import CONTROLS

pytestmark = pytest.mark.heavy

every_kind = pytest.mark.parametrize("control", CONTROLS)


@functools.cache
def standing(node: str = "infra_1") -> Position:
    path, loaded = scenario.load("coordinated", ["n_infrastructure=2"])
    return position(scenario.resolve(path, loaded, frames=2, record=True), node, version.version_string())


@every_kind
@settings(max_examples=20)
@given(seed=st.integers(0, 1 << 32), node=st.sampled_from(["infra_1", "broker", "recorder", "evaluator"]))
def test_malformed_forgery_raises_only_message_error(control: str, seed: int, node: str) -> None:
    for forgery in forgeries(control, standing(node), 6, seed):
        taken = not refused(control, node, forgery.payload)
        assert not (taken and forgery.defect == MALFORMED), forgery


@every_kind
def test_two_hundred_forgeries_cover_all_defects(control: str) -> None:
    messages = forgeries(control, standing(), 200)
    assert len(messages) == 200
    assert {each.defect for each in messages} == {MALFORMED, DAMAGED, FALSE}
    assert len({each.payload for each in messages}) > 20
    for each in messages:
        was_refused = refused(control, "infra_1", each.payload)
        assert was_refused or each.defect != MALFORMED, each.payload[:100]


@every_kind
def test_forgeries_depend_only_on_the_seed(control: str) -> None:
    first, again, other = (forgeries(control, standing(), 30, seed) for seed in (1, 1, 2))
    assert first == again
    assert first != other


def test_kinds_with_a_key_per_node_use_own_and_other_keys() -> None:
    where = standing()
    for control in ("counts", "result", "fetch", "file", "failed", "leave", "drain"):
        owners = {each.sender for each in forgeries(control, where, 200)}
        assert where.node in owners
        assert owners & {*where.others}
    assert {each.key for each in forgeries("stop", where, 200)} == {"stop"}
    assert not {*where.publishes, *where.subscribes} & {*where.foreign}


@every_kind
def test_payloads_that_unpack_to_far_more_use_little_memory(control: str) -> None:
    messages = [each for each in forgeries(control, standing(), 200) if each.defect == MALFORMED]
    heavy = sorted((each.payload for each in messages), key=len)[-5:]
    tracemalloc.start()
    try:
        for payload in heavy:
            assert refused(control, "infra_1", payload)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 96 << 20, "from payloads of at most 8 MiB"
