"""What strangers on an open mesh report in the name of nodes costs one message, and nothing else."""

from __future__ import annotations

from collections.abc import Iterator

import msgpack
import pytest
import zenoh
from launched import eventually

from mast_zenoh.launch.reports import Report, Reports
from mast_zenoh.launch.supervisor import Child
from mast_zenoh.resolved import NodeSpec
from mast_zenoh.runtime import results
from mast_zenoh.runtime.session import open_client, open_router

pytestmark = pytest.mark.mesh
CONTROL = "mast/x/@control"
ENTRY = {
    "handler": "on_tracks",
    "count": 1,
    "frames": 1,
    "first_frame": 3,
    "last_frame": 3,
    "exception": "KeyError: 'x'",
    "where": "/a/node.py:3",
}
OUTCOME = {"results": {"n": 1}, "failures": [], "process": "b"}


class Quiet(Child):
    """A node's process that has ended with 0."""

    exit = 0

    def where(self) -> dict:
        return {}


@pytest.fixture
def mesh() -> Iterator[tuple[dict[str, Child], Reports, zenoh.Session]]:
    """(the nodes of a run, their reports, the session of a stranger)."""
    router, endpoint = open_router()
    with router, open_client(endpoint) as stranger:
        children: dict[str, Child] = {"ego": Quiet("ego", NodeSpec("agent", "", "", {}, "continue"))}
        reports = Reports(router, CONTROL, children)
        yield children, reports, stranger
        reports.close()


def test_malformed_reports_and_those_of_nobody_are_ignored(mesh) -> None:
    children, reports, stranger = mesh
    sound = msgpack.packb(["a", ENTRY])
    for payload in (b"", b"\xc1", b"\x93", msgpack.packb(7), msgpack.packb(["a", {}]), msgpack.packb(["a", [1]])):
        stranger.put(f"{CONTROL}/failed/ego", payload)
    stranger.put(f"{CONTROL}/failed/nobody", sound)
    stranger.put(f"{CONTROL}/failed/ego", sound)
    taken: list[Report] = []
    eventually(lambda: taken.extend(reports.take()) or taken, "the sound one")
    assert taken == [Report("ego", ENTRY)]
    assert children["ego"].ended == "exit code 0, but it handed in no results"
    forged = [b"", b"\xc1", results.pack([1]), results.pack(OUTCOME | {"results": [1]}), results.pack({"results": {}})]
    for node, payload in [*(("ego", payload) for payload in forged), ("..", results.pack(OUTCOME))]:
        list(stranger.get(f"{CONTROL}/result/{node}", payload=payload, timeout=5.0))
    assert list(reports.take()) == []
    assert reports.outcomes == {}
    list(stranger.get(f"{CONTROL}/result/ego", payload=results.pack(OUTCOME), timeout=5.0))
    assert list(reports.take()) == [Report("ego")]
    assert children["ego"].ended == "ok"
    assert reports.by_node()["ego"]["failures"] == [ENTRY], "of the process before"


def test_what_a_process_hands_in_stands_for_what_it_has_reported_before(mesh) -> None:
    _, reports, stranger = mesh
    for count in (1, 2):
        stranger.put(f"{CONTROL}/failed/ego", msgpack.packb(["b", ENTRY | {"count": count}]))
    outcome = results.pack(OUTCOME | {"failures": [ENTRY | {"count": 5, "frames": 4}]})
    list(stranger.get(f"{CONTROL}/result/ego", payload=outcome, timeout=5.0))
    taken: list[Report] = []
    eventually(lambda: taken.extend(reports.take()) or len(taken) >= 2, "both")
    assert reports.by_node()["ego"]["failures"][0]["count"] == 5
