"""Forged messages that are malformed are refused, and use little memory."""

from __future__ import annotations

import functools
import tracemalloc

import pytest
from insider.forgeries import MALFORMED, forgeries, refused
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
