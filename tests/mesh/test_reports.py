"""Forged reports on an open mesh cost one message and have no effect."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import msgpack
import pytest
import zenoh
from insider.position import FAILURE
from launched import eventually
from sound_controls import DRIVEN, OUTCOME

from mast_zenoh.config.resolved import NodeSpec
from mast_zenoh.control import results
from mast_zenoh.control.codec import InvalidMessages
from mast_zenoh.control.failures import MAX_HANDLERS
from mast_zenoh.control.files import decode_refusal
from mast_zenoh.control.results import MAX_RESULT
from mast_zenoh.launch.launcher_protocol import Report
from mast_zenoh.launch.reports import Reports
from mast_zenoh.launch.supervisor import Child
from mast_zenoh.runtime.mesh.session import open_client, open_router

pytestmark = pytest.mark.mesh
CONTROL = "mast/x/@control"


class Quiet(Child):
    """A node's process that has exited with 0."""

    exit = 0

    def where(self) -> dict:
        return {}


class Mesh(NamedTuple):
    """A launcher that collects reports, and a client that forges them."""

    children: dict[str, Child]
    invalid: InvalidMessages
    reports: Reports
    stranger: zenoh.Session

    def ask(self, node: str, payload: bytes) -> list[bool]:
        """Whether each answer is an acceptance."""
        replies = self.stranger.get(f"{CONTROL}/result/{node}", payload=payload, timeout=5.0)
        return [reply.ok is not None for reply in replies]


@pytest.fixture
def mesh() -> Iterator[Mesh]:
    router, endpoint = open_router()
    with router, open_client(endpoint) as stranger:
        roles = {"ego": "agent", "sim": "simulator"}
        specs = {name: NodeSpec(role, "", "", {}, "continue") for name, role in roles.items()}
        children: dict[str, Child] = {name: Quiet(name, spec) for name, spec in specs.items()}
        invalid = InvalidMessages(lambda line: None)
        reports = Reports(router, CONTROL, children, invalid)
        yield Mesh(children, invalid, reports, stranger)
        reports.close()


def test_malformed_reports_and_those_of_unknown_nodes_are_counted_and_ignored(mesh: Mesh) -> None:
    sound = msgpack.packb(["a", FAILURE])
    for payload in (b"", b"\xc1", b"\x93", msgpack.packb(7), msgpack.packb(["a", {}]), msgpack.packb(["a", [1]])):
        mesh.stranger.put(f"{CONTROL}/failed/ego", payload)
    mesh.stranger.put(f"{CONTROL}/failed/nobody", sound)
    mesh.stranger.put(f"{CONTROL}/failed/ego", sound)
    taken: list[Report] = []
    eventually(lambda: taken.extend(mesh.reports.take()) or taken, "the valid report arrives")
    assert taken == [Report("ego", FAILURE)]
    assert mesh.children["ego"].ended == "exit code 0, but it handed in no results"
    forged = [
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
    for payload in forged:
        mesh.ask("ego", payload)
        assert list(mesh.reports.take()) == []
    assert mesh.ask("..", results.pack(OUTCOME)) == [False]
    assert mesh.reports.outcomes == {}
    assert mesh.invalid.counts == {"failed/ego": 6, "failed/*": 1, "result/ego": len(forged), "result/*": 1}
    assert mesh.ask("ego", results.pack(OUTCOME | {"failures": []})) == [True]
    assert list(mesh.reports.take()) == [Report("ego")]
    assert mesh.children["ego"].ended == "ok"
    assert mesh.reports.by_node()["ego"]["failures"] == [FAILURE], "of the previous process"


def test_malformed_reports_leave_room_for_valid_ones(mesh: Mesh) -> None:
    """Before the launcher's loop handles any of them."""
    assert [mesh.ask("ego", b"\xc1") for _ in range(5)] == [[False]] * 5
    for _ in range(1500):
        mesh.stranger.put(f"{CONTROL}/failed/ego", b"\xc1", congestion_control=zenoh.CongestionControl.BLOCK)
    mesh.stranger.put(f"{CONTROL}/failed/ego", msgpack.packb(["a", FAILURE]))
    assert mesh.ask("ego", results.pack(OUTCOME)) == [True]
    assert list(mesh.reports.take()) == [Report("ego", FAILURE), Report("ego")]
    assert mesh.invalid.counts == {"failed/ego": 1500, "result/ego": 5}


def test_results_of_a_process_replace_its_earlier_reports(mesh: Mesh) -> None:
    for count in (1, 2):
        mesh.stranger.put(f"{CONTROL}/failed/ego", msgpack.packb([OUTCOME["process"], FAILURE | {"count": count}]))
    mesh.ask("ego", results.pack(OUTCOME | {"failures": [FAILURE | {"count": 5, "frames": 4}]}))
    taken: list[Report] = []
    eventually(lambda: taken.extend(mesh.reports.take()) or len(taken) >= 2, "both reports arrive")
    assert mesh.reports.by_node()["ego"]["failures"][0]["count"] == 5


def test_a_node_can_send_results_only_once(mesh: Mesh) -> None:
    first, second = (results.pack(OUTCOME | {"results": {"n": n}}) for n in (1, 2))
    for payload in (first, first, second):
        mesh.ask("ego", payload)
        list(mesh.reports.take())
    assert mesh.reports.outcomes["ego"]["results"] == {"n": 1}
    assert mesh.invalid.counts == {"result/ego": 1}, "a repeated query means that its answer was lost"
    mesh.children["ego"].handed_in = False  # like the supervisor when it restarts the node
    mesh.ask("ego", second)
    list(mesh.reports.take())
    assert mesh.reports.outcomes["ego"]["results"] == {"n": 2}


def test_oversized_results_are_refused_with_the_reason(mesh: Mesh) -> None:
    payload = bytes(MAX_RESULT + 1)
    (reply,) = mesh.stranger.get(f"{CONTROL}/result/ego", payload=payload, timeout=20.0)
    assert reply.err is not None
    refusal = decode_refusal(reply.err.payload.to_bytes())
    assert "expected at most" in str(refusal)
    assert list(mesh.reports.take()) == []


def test_only_the_driver_can_report_why_the_run_stops(mesh: Mesh) -> None:
    mesh.ask("sim", results.pack(DRIVEN))
    assert list(mesh.reports.take()) == [Report("sim", stop_reason="end")]
    assert mesh.reports.outcomes["sim"]["stop_reason"] == "end"


def test_failure_counts_of_a_node_are_limited(mesh: Mesh) -> None:
    for i in range(300):
        mesh.stranger.put(f"{CONTROL}/failed/ego", msgpack.packb(["b", FAILURE | {"handler": f"on_{i}"}]))
    taken: list[Report] = []
    refused = 300 - MAX_HANDLERS
    eventually(
        lambda: taken.extend(mesh.reports.take()) or mesh.invalid.counts["failed/ego"] == refused,
        "all reports have arrived",
    )
    assert len(taken) == MAX_HANDLERS
