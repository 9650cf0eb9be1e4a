"""Latency of a real-time run, by wire."""

import pytest

from mast_zenoh.config.resolved import NodeSpec
from mast_zenoh.control.results import collations, late
from mast_zenoh.launch import conclusion
from mast_zenoh.wiring.model import Branch, Endpoint, Leg, Wire, Wiring

MS = 1_000_000
SENT = {0: 0, 1: 100 * MS, 2: 200 * MS}


def wire(key: str, publisher: str, *subscribers: str) -> Wire:
    return Wire(key, "", "status", (Leg(key, Endpoint(publisher, "out"), ends(*subscribers)),))


def ends(*nodes: str) -> tuple[Endpoint, ...]:
    return tuple(Endpoint(node, "in") for node in nodes)


def came(key: str, *ms: float) -> dict[str, dict[int, int]]:
    """Arrival of each frame's message, ms after the frame was sent."""
    return {key: {frame: SENT[frame] + round(after * MS) for frame, after in enumerate(ms)}}


def test_percentiles_cover_frames_that_were_sent_and_received() -> None:
    percentiles = conclusion.percentiles(SENT, {0: 5 * MS, 2: 207 * MS, 9: 1})
    assert percentiles == {"p50": 6.0, "p95": pytest.approx(6.9), "p99": pytest.approx(6.98), "n": 2}
    assert conclusion.percentiles(SENT, {}) == {}


def test_latency_is_measured_at_the_first_subscriber_with_arrivals() -> None:
    wiring = Wiring((wire("a/tracks", "a", "evaluator", "broker", "cc"), wire("b", "broker"), wire("c", "cc")))
    arrived = {"evaluator": came("a/tracks", 90.0), "broker": came("a/tracks", 3.0), "cc": came("a/tracks", 40.0)}
    assert conclusion.by_wire(wiring, SENT, arrived)["a/tracks"] == {"p50": 3.0, "p95": 3.0, "p99": 3.0, "n": 1}
    del arrived["broker"]
    assert conclusion.by_wire(wiring, SENT, arrived)["a/tracks"]["p50"] == 40.0, "it was killed and returned nothing"


def test_a_wire_with_only_listeners_is_measured_at_the_first_and_one_without_arrivals_is_omitted() -> None:
    wiring = Wiring((wire("truth", "simulator", "evaluator", "watcher"), wire("dead", "x", "evaluator")))
    arrived = {"evaluator": came("truth", 7.0), "watcher": came("truth", 1.0), "recorder": came("dead", 1.0)}
    assert {key: by_frame["p50"] for key, by_frame in conclusion.by_wire(wiring, SENT, arrived).items()} == {
        "truth": 7.0
    }


def test_latency_is_measured_after_interposers_on_trunk_and_branch() -> None:
    trunk = (
        Leg("a/tracks/@tap/0", Endpoint("a", "out"), ends("adversary")),
        Leg("a/tracks", Endpoint("adversary", "out"), ends("link", "evaluator")),
    )
    leg = Leg("a/tracks/@tap/broker", Endpoint("link", "out"), ends("broker"))
    branch = Branch(Endpoint("link", "in"), Endpoint("broker", "in"), (leg,))
    wiring = Wiring((Wire("a/tracks", "a", "tracks", trunk, (branch,)), wire("cc", "broker", "evaluator")))
    arrived = {
        "adversary": came("a/tracks/@tap/0", 1.0),
        "link": came("a/tracks", 2.0),
        "broker": came("a/tracks/@tap/broker", 30.0),
        "evaluator": came("a/tracks", 2.0),
    }
    assert conclusion.by_wire(wiring, SENT, arrived)["a/tracks"]["p50"] == 30.0


def test_late_messages_are_counted_by_agent() -> None:
    assert late([{"late": {"infra_2": 3, "ego": 1}}, {"late": {"ego": 2}}]) == {"ego": 3, "infra_2": 3}
    assert late([]) == {}


def test_only_counts_of_brokers_are_collations() -> None:
    nodes = {name: NodeSpec(role, "", "", {}, "fail") for name, role in (("broker", "broker"), ("spy", "visualizer"))}
    counted = {"late": {"ego": 1}}
    handed_in = {"broker": {"collation": counted}, "spy": {"collation": 7}, "gone": {"collation": counted}}
    assert collations(handed_in, nodes) == [counted]
    assert collations({"broker": {"collation": "nonsense"}}, nodes) == []
    odd = {"late": [1], "overdue": "many", "complete": 3}
    assert collations({"broker": {"collation": odd}}, nodes) == [{"complete": 3, "late": {}}]
