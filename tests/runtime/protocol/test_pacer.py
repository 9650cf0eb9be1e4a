"""The next frame begins exactly when no message is in transit."""

import itertools

from mast_zenoh.runtime.protocol.pacer import Pacer
from mast_zenoh.wiring.model import Endpoint, Leg, Wire, Wiring


def wire(key: str, publisher: str, *subscribers: str) -> Wire:
    leg = Leg(key, Endpoint(publisher, "out"), tuple(Endpoint(name, "in") for name in subscribers))
    return Wire(key, "", "clock", (leg,))


WIRING = Wiring(
    (
        wire("clock", "simulator", "agent", "broker", "evaluator"),
        wire("tracks", "agent", "broker"),
        wire("collated", "broker", "evaluator"),
    )
)
MEMBERS = {name: name for name in ("simulator", "agent", "broker")}


def new_pacer() -> Pacer:
    pacer = Pacer(WIRING)
    pacer.begin_epoch(MEMBERS)
    return pacer


def test_the_mesh_is_not_quiet_until_all_nodes_have_reported() -> None:
    pacer = new_pacer()
    pacer.report("simulator", 1, {}, {})
    pacer.report("agent", 1, {}, {})
    assert not pacer.quiet()
    assert pacer.silent == {"broker"}
    pacer.report("broker", 1, {}, {})
    assert pacer.quiet()


def test_with_a_message_in_transit_the_mesh_is_not_quiet_in_any_order_of_reports() -> None:
    pacer = new_pacer()
    pacer.report("simulator", 1, {"clock": 1}, {})
    pacer.report("broker", 1, {}, {"clock": 1})
    pacer.report("agent", 1, {"tracks": 1}, {"clock": 1})
    assert not pacer.quiet()
    assert list(pacer.unsettled()) == ["broker has handled 0 of 1 messages of agent on tracks"]
    pacer.report("broker", 1, {}, {"clock": 1, "tracks": 1})
    assert pacer.quiet()


def test_reports_of_another_epoch_or_of_non_members_are_ignored() -> None:
    pacer = new_pacer()
    pacer.begin_epoch(MEMBERS)
    for name in MEMBERS:
        pacer.report(name, 1, {}, {})
    pacer.report("stranger", 2, {"clock": 5}, {})
    assert pacer.silent == set(MEMBERS)


def test_dead_nodes_are_not_waited_for() -> None:
    pacer = new_pacer()
    pacer.report("simulator", 1, {"clock": 1}, {})
    pacer.report("broker", 1, {}, {"clock": 1})
    pacer.drop(["agent"])
    assert pacer.quiet()


def test_listeners_are_waited_for_only_on_request() -> None:
    pacer = Pacer(WIRING)
    pacer.begin_epoch({**MEMBERS, "evaluator": "evaluator"})
    pacer.report("simulator", 1, {"clock": 1}, {})
    pacer.report("agent", 1, {}, {"clock": 1})
    pacer.report("broker", 1, {"collated": 1}, {"clock": 1})
    assert pacer.quiet()
    assert not pacer.quiet(include_listeners=True)
    pacer.report("evaluator", 1, {}, {"clock": 1, "collated": 1})
    assert pacer.quiet(include_listeners=True)


def test_a_key_that_a_node_neither_publishes_nor_receives_is_refused_and_named() -> None:
    pacer = new_pacer()
    assert pacer.report("agent", 1, {"tracks": 1}, {"clock": 1}) == ""
    reason = pacer.report("agent", 1, {"collated": 1}, {})
    assert reason == "agent reports messages sent on 'collated', which it does not publish on"
    reason = pacer.report("agent", 1, {}, {"tracks": 1})
    assert reason == "agent reports messages handled on 'tracks', which it does not receive"
    assert pacer.report("stranger", 1, {"tracks": 1}, {}) == "", "reports of non-members are ignored"
    pacer.report("simulator", 1, {"clock": 1}, {})
    pacer.report("broker", 1, {}, {"clock": 1, "tracks": 1})
    assert pacer.quiet(), "refused reports change nothing"


def test_messages_of_the_previous_wiring_may_still_be_reported() -> None:
    pacer = new_pacer()
    pacer.rewire(Wiring(WIRING.wires[:1]))
    pacer.begin_epoch(MEMBERS)
    assert pacer.report("agent", 2, {"tracks": 1}, {}) == ""
    assert pacer.report("broker", 2, {}, {"tracks": 1}) == ""


def test_a_node_that_has_handled_more_than_was_sent_is_named() -> None:
    pacer = new_pacer()
    pacer.report("simulator", 1, {"clock": 3}, {})
    pacer.report("agent", 1, {"tracks": 3}, {"clock": 3})
    pacer.report("broker", 1, {"collated": 3}, {"clock": 3, "tracks": 10**9})
    assert not pacer.quiet()
    assert pacer.implausible() == (
        "agent reports 3 messages sent on tracks, broker 1000000000 handled: one of the two reports is false"
    )


def test_a_node_that_has_handled_more_than_the_driver_sent_is_the_one_that_is_named() -> None:
    pacer = Pacer(Wiring((*WIRING.wires[1:], wire("clock", "simulator", "agent"))))
    pacer.begin_epoch(MEMBERS)
    pacer.report("simulator", 1, {"clock": 3}, {})
    pacer.report("agent", 1, {}, {"clock": 4})
    pacer.report("broker", 1, {}, {})
    assert pacer.implausible() == "agent reports 4 messages of simulator handled on clock, of which 3 were sent"


def test_the_count_of_a_busy_publisher_is_not_final_and_no_node_is_accused() -> None:
    pacer = new_pacer()
    pacer.report("simulator", 1, {"clock": 1}, {})
    pacer.report("agent", 1, {}, {})
    pacer.report("broker", 1, {}, {"clock": 1, "tracks": 1})
    assert not pacer.quiet()
    assert pacer.implausible() == ""


def test_a_publisher_that_reports_too_few_messages_is_named() -> None:
    pacer = Pacer(WIRING)
    pacer.begin_epoch({**MEMBERS, "evaluator": "evaluator"})
    pacer.report("simulator", 1, {"clock": 0}, {})
    for name in ("agent", "broker", "evaluator"):
        pacer.report(name, 1, {}, {"clock": 2})
    assert pacer.implausible().startswith("simulator reports 0 messages sent on clock, of which more have been handled")
    pacer.report("evaluator", 1, {}, {"clock": 0})
    assert pacer.implausible().startswith(
        "agent reports 2 messages of simulator handled on clock, of which 0 were sent"
    )


def test_missing_reports_of_a_correct_mesh_accuse_no_node() -> None:
    """Each node's last report may be of any of three frames; the driver's is new."""
    pacer = new_pacer()
    pacer.report("simulator", 1, {"clock": 3}, {})
    for of_agent, of_broker in itertools.product(range(4), repeat=2):
        pacer.report("agent", 1, {"tracks": of_agent}, {"clock": of_agent})
        pacer.report("broker", 1, {}, {"clock": of_broker, "tracks": of_broker})
        assert pacer.implausible() == ""
        assert pacer.quiet() == ((of_agent, of_broker) == (3, 3))


def test_no_node_is_blamed_while_an_upstream_node_is_busy() -> None:
    """Agent and broker are still working; the broker's report may be outdated."""
    pacer = new_pacer()
    pacer.report("simulator", 1, {"clock": 2}, {})
    pacer.report("agent", 1, {"tracks": 1}, {"clock": 1})
    pacer.report("broker", 1, {"collated": 1}, {"clock": 2, "tracks": 1})
    pacer.members["evaluator"] = "evaluator"
    pacer.report("evaluator", 1, {}, {"clock": 2, "collated": 2})
    assert pacer.implausible() == "", "the broker may have handled later messages of the agent"
    pacer.report("agent", 1, {"tracks": 1}, {"clock": 2})
    assert pacer.implausible() != "", "no node is busy, so one of the two reports is false"


def test_a_node_that_reports_more_than_all_others_have_handled_is_named_first() -> None:
    pacer = new_pacer()
    pacer.report("simulator", 1, {"clock": 2}, {})
    pacer.report("agent", 1, {}, {"clock": 1})
    pacer.report("broker", 1, {}, {"clock": 1})
    message = "simulator reports 2 messages sent on clock, of which all its subscribers have handled 1 (agent, broker)"
    assert list(pacer.unsettled()) == [message]
