"""Forged reports on an open mesh cost one message and have no effect."""

from typing import Any
from unittest.mock import MagicMock

import msgpack
import pytest
from insider.position import FAILURE
from sound_controls import DRIVEN, OUTCOME

from mast_zenoh.config.resolved import NodeSpec
from mast_zenoh.launch.launcher_protocol import Report
from mast_zenoh.launch.reports import MAX_WAITING, Reports
from mast_zenoh.launch.supervisor import Child
from mast_zenoh.mesh.control import results
from mast_zenoh.mesh.control.codec import InvalidMessages
from mast_zenoh.mesh.control.failures import MAX_HANDLERS
from mast_zenoh.mesh.control.files import decode_refusal
from mast_zenoh.mesh.control.results import MAX_RESULT

VALID = msgpack.packb(["a", FAILURE])


class Quiet(Child):
    """A node's process that has exited with 0."""

    exit = 0

    def where(self) -> dict[str, Any]:
        return {}


class Mesh:
    """A launcher that collects reports, and a client that forges them."""

    def __init__(self) -> None:
        roles = {"ego": "agent", "sim": "simulator"}
        specs = {name: NodeSpec(role, "", "", {}, "continue") for name, role in roles.items()}
        self.children: dict[str, Child] = {name: Quiet(name, spec) for name, spec in specs.items()}
        self.invalid = InvalidMessages(lambda line: None)
        self.reports = Reports(MagicMock(), "mast/x/@control", self.children, self.invalid, MagicMock())

    def ask(self, node: str, payload: bytes) -> str:
        """Why results are refused; empty: they are accepted."""
        query = MagicMock(key_expr=f"mast/x/@control/result/{node}", payload=MagicMock(to_bytes=lambda: payload))
        self.reports._on_result(query)
        assert query.reply.call_count + query.reply_err.call_count == 1
        return str(decode_refusal(query.reply_err.call_args[0][0])) if query.reply_err.called else ""

    def fail(self, node: str, payload: bytes) -> None:
        """Report a failure."""
        payloads = MagicMock(to_bytes=lambda: payload)
        self.reports._on_failed(MagicMock(key_expr=f"mast/x/@control/failed/{node}", payload=payloads))

    def take(self) -> list[Report]:
        return list(self.reports.take())


@pytest.fixture
def mesh() -> Mesh:
    return Mesh()


FORGED = [
    b"",
    b"\xc1",
    results.pack([1]),
    results.pack(OUTCOME | {"results": [1]}),
    results.pack({"results": {}}),
    results.pack({"sent_ns": {}}),
    results.pack(OUTCOME | {"stop_reason": "end"}),
    results.pack(OUTCOME | {"stop_reason": 7}),
    results.pack(DRIVEN | {"stop_reason": "stall"}),
]


def test_malformed_reports_and_those_of_unknown_nodes_are_counted_and_ignored(mesh: Mesh) -> None:
    for payload in (b"", b"\xc1", b"\x93", msgpack.packb(7), msgpack.packb(["a", {}]), msgpack.packb(["a", [1]])):
        mesh.fail("ego", payload)
    mesh.fail("nobody", VALID)
    mesh.fail("ego", VALID)
    assert mesh.take() == [Report("ego", FAILURE)]
    assert "handed in no" in mesh.children["ego"].ended
    for payload in FORGED:
        assert mesh.ask("ego", payload)
    assert mesh.ask("..", results.pack(OUTCOME))
    assert mesh.take() == []
    assert mesh.reports.outcomes == {}
    assert mesh.invalid.counts == {"failed/ego": 6, "failed/*": 1, "result/ego": len(FORGED), "result/*": 1}
    assert mesh.ask("ego", results.pack(OUTCOME | {"failures": []})) == ""
    assert mesh.take() == [Report("ego")]
    assert mesh.children["ego"].ended == "ok"
    assert mesh.reports.by_node()["ego"]["failures"] == [FAILURE], "of the previous process"


def test_malformed_reports_leave_room_for_valid_ones_and_no_more_than_the_limit_wait(
    mesh: Mesh, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Before the launcher's loop handles any of them."""
    assert MAX_WAITING["failed"] == 1000
    monkeypatch.setitem(MAX_WAITING, "failed", 50)
    for _ in range(51):
        mesh.ask("ego", b"\xc1")
        mesh.fail("ego", b"\xc1")
    for _ in range(52):
        mesh.fail("ego", VALID)
    assert [bool(mesh.ask("ego", results.pack(OUTCOME))) for _ in range(3)] == [False, False, True]
    assert mesh.invalid.counts == {"failed/ego": 53, "result/ego": 52}
    assert mesh.take() == [Report("ego", FAILURE), Report("ego")]
    assert mesh.ask("ego", results.pack(OUTCOME)) == "", "there is room again"


def test_results_of_a_process_replace_its_earlier_reports(mesh: Mesh) -> None:
    for count in (1, 2):
        mesh.fail("ego", msgpack.packb([OUTCOME["process"], FAILURE | {"count": count}]))
    mesh.ask("ego", results.pack(OUTCOME | {"failures": [FAILURE | {"count": 5, "frames": 4}]}))
    assert len(mesh.take()) == 2
    assert mesh.reports.by_node()["ego"]["failures"][0]["count"] == 5


def test_a_process_can_send_results_only_once_and_only_while_it_is_its_nodes(mesh: Mesh) -> None:
    first, second = (results.pack(OUTCOME | {"results": {"n": n}}) for n in (1, 2))
    for payload in (first, first, second):
        mesh.ask("ego", payload)
        mesh.take()
    assert mesh.reports.outcomes["ego"]["results"] == {"n": 1}
    assert mesh.invalid.counts == {"result/ego": 1}, "a repeated query means that its answer was lost"
    mesh.ask("ego", first)
    child = mesh.children["ego"]
    child.handed_in, child.restarts = False, 1  # like the supervisor when it restarts the node
    assert mesh.take() == []
    assert not child.handed_in, "these results were of the process before"
    mesh.ask("ego", second)
    mesh.take()
    assert mesh.reports.outcomes["ego"]["results"] == {"n": 2}


def test_oversized_results_are_refused_with_the_reason(mesh: Mesh) -> None:
    assert "expected at most" in mesh.ask("ego", bytes(MAX_RESULT + 1))
    assert mesh.take() == []


def test_only_the_driver_can_report_why_the_run_stops(mesh: Mesh) -> None:
    mesh.ask("sim", results.pack(DRIVEN))
    assert mesh.take() == [Report("sim", stop_reason="end")]
    assert mesh.reports.outcomes["sim"]["stop_reason"] == "end"


def test_failure_counts_of_a_node_are_limited(mesh: Mesh) -> None:
    for i in range(300):
        mesh.fail("ego", msgpack.packb(["b", FAILURE | {"handler": f"on_{i}"}]))
    assert len(mesh.take()) == MAX_HANDLERS
    assert mesh.invalid.counts["failed/ego"] == 300 - MAX_HANDLERS
