"""When a node of a lock-step run reports its counts, before it waits for messages."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from mast_zenoh.runtime.lockstep.pacer import SETTLE_EVERY
from mast_zenoh.runtime.mesh.inbox import Inbox
from mast_zenoh.runtime.mesh.node import MeshNode


@pytest.mark.parametrize(
    ("outlets", "frame", "reports"),
    [({}, 3, 0), ({}, SETTLE_EVERY - 1, 1), ({"tracks": None}, 3, 1)],
    ids=["only listens", "only listens, the driver waits for it", "publishes"],
)
def test_a_node_that_only_listens_reports_while_messages_come_only_when_the_driver_waits_for_it(
    outlets: dict[str, None], frame: int, reports: int
) -> None:
    reported: list[None] = []
    node: Any = SimpleNamespace(
        lockstep=True,
        outlets=outlets,
        host=SimpleNamespace(frame=frame),
        intake=SimpleNamespace(expects_more=False),
        inbox=Inbox(),
        report=lambda: reported.append(None),
    )
    node.inbox.put(("stop", "a message that comes meanwhile"))
    assert MeshNode.wait_for_event(node) is not None
    assert len(reported) == reports
