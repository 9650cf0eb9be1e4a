"""The next frame begins exactly when no message is in transit; the driver notes nodes that go and return."""

import itertools
import re
from typing import Any

import pytest

from mast_zenoh.mesh.protocol.pacer import Membership, Pacer, TokenPresence
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
LISTENED = MEMBERS | {"evaluator": "evaluator"}
Counts = dict[str, Any]  # by node: what it has sent and handled, by key


def pacer_after(counts: Counts, members: dict[str, str] = MEMBERS, wiring: Wiring = WIRING) -> Pacer:
    pacer = Pacer(wiring)
    pacer.begin_epoch(members)
    for node, (sent, handled) in counts.items():
        assert pacer.report(node, 1, sent, handled) == ""
    return pacer


def counts(simulator: Any, agent: Any, broker: Any, **more: Any) -> Counts:
    return {"simulator": ({"clock": simulator}, {}), "agent": agent, "broker": broker, **more}


DONE = counts(1, ({"tracks": 1}, {"clock": 1}), ({"collated": 1}, {"clock": 1, "tracks": 1}))


@pytest.mark.parametrize(
    ("reports", "quiet", "unsettled"),
    [
        (DONE, True, []),
        ({name: DONE[name] for name in ("simulator", "agent")}, False, ["broker has not reported"]),
        (DONE | {"broker": ({}, {"clock": 1})}, False, ["broker has handled 0 of 1 messages of agent on tracks"]),
        (
            counts(2, ({}, {"clock": 1}), ({}, {"clock": 1})),
            False,
            ["simulator reports 2 messages sent on clock, of which all its subscribers have handled 1 (agent, broker)"],
        ),
    ],
    ids=["all is handled", "no report of a node", "one message in transit", "all subscribers are behind"],
)
def test_the_mesh_is_quiet_when_all_have_handled_what_was_sent_to_them(reports, quiet, unsettled) -> None:
    for order in itertools.permutations(reports):
        pacer = pacer_after({node: reports[node] for node in order})
        assert pacer.quiet() == quiet
        assert list(pacer.unsettled()) == unsettled
        assert pacer.silent == MEMBERS.keys() - reports.keys()


def test_reports_of_another_epoch_or_of_non_members_are_ignored() -> None:
    pacer = pacer_after({})
    pacer.begin_epoch(MEMBERS)
    for name in MEMBERS:
        pacer.report(name, 1, {}, {})
    assert pacer.report("stranger", 2, {"clock": 5}, {}) == ""
    assert pacer.silent == set(MEMBERS)


def test_dead_nodes_are_not_waited_for() -> None:
    pacer = pacer_after({"simulator": ({"clock": 1}, {}), "broker": ({}, {"clock": 1})})
    assert not pacer.quiet()
    pacer.report("agent", 1, {}, {})
    assert "agent has handled" in "".join(pacer.unsettled())
    pacer.drop(["agent"])
    assert pacer.quiet()
    assert "agent" not in "".join(pacer.unsettled())


def test_listeners_are_waited_for_only_on_request() -> None:
    pacer = pacer_after(DONE, LISTENED)
    assert pacer.quiet()
    assert not pacer.quiet(include_listeners=True)
    pacer.report("evaluator", 1, {}, {"clock": 1, "collated": 1})
    assert pacer.quiet(include_listeners=True)


@pytest.mark.parametrize(
    ("sent", "handled", "reason"),
    [
        ({"collated": 1}, {}, "agent .* sent on 'collated'"),
        ({}, {"tracks": 1}, "agent .* handled on 'tracks'"),
    ],
)
def test_a_key_that_a_node_neither_publishes_nor_receives_is_refused_and_named(sent, handled, reason) -> None:
    pacer = pacer_after(DONE)
    assert re.match(reason, pacer.report("agent", 1, sent, handled))
    assert pacer.quiet(), "refused reports change nothing"


def test_messages_of_the_previous_wiring_may_still_be_reported() -> None:
    pacer = pacer_after({})
    pacer.rewire(Wiring(WIRING.wires[:1]))
    pacer.begin_epoch(MEMBERS)
    assert pacer.report("agent", 2, {"tracks": 1}, {}) == ""
    assert pacer.report("broker", 2, {}, {"tracks": 1}) == ""


HEARD = ({}, {"clock": 2})
UPSTREAM_DONE = counts(
    2,
    ({"tracks": 1}, {"clock": 2}),
    ({"collated": 1}, {"clock": 2, "tracks": 1}),
    evaluator=({}, {"clock": 2, "collated": 2}),
)


@pytest.mark.parametrize(
    ("reports", "reason"),
    [
        (
            counts(3, ({"tracks": 3}, {"clock": 3}), ({"collated": 3}, {"clock": 3, "tracks": 10**9})),
            "agent reports 3 .* tracks, broker 1000000000 ",
        ),
        (
            counts(0, HEARD, HEARD, evaluator=HEARD),
            r"simulator reports 0 .* clock, .*\(agent 2, broker 2, evaluator 2\)$",
        ),
        (
            counts(0, HEARD, HEARD, evaluator=({}, {"clock": 0})),
            "agent reports 2 .* simulator .* clock, of which 0 ",
        ),
        (
            UPSTREAM_DONE,
            "broker reports 1 .* collated, evaluator 2 ",
        ),
        # the agent may have sent more since its report; the broker may have handled that
        (counts(1, ({}, {}), ({}, {"clock": 1, "tracks": 1})), ""),
        (UPSTREAM_DONE | {"agent": ({"tracks": 1}, {"clock": 1})}, ""),
    ],
)
def test_an_impossible_report_is_named_once_no_node_upstream_is_busy(reports: Counts, reason: str) -> None:
    members = {name: LISTENED[name] for name in reports}
    assert re.fullmatch(f"{reason}.*" if reason else "", pacer_after(reports, members).implausible())


def test_the_drivers_report_counts_as_true() -> None:
    wiring = Wiring((*WIRING.wires[1:], wire("clock", "simulator", "agent")))
    pacer = pacer_after(counts(3, ({}, {"clock": 4}), ({}, {})), wiring=wiring)
    assert "reports 4 messages" in pacer.implausible()


def test_missing_reports_of_a_correct_mesh_accuse_no_node() -> None:
    """Each node's last report may be of any of three frames; the driver's is new."""
    for of_agent, of_broker in itertools.product(range(4), repeat=2):
        agent, broker = ({"tracks": of_agent}, {"clock": of_agent}), ({}, {"clock": of_broker, "tracks": of_broker})
        pacer = pacer_after(counts(3, agent, broker))
        assert pacer.implausible() == ""
        assert pacer.quiet() == ((of_agent, of_broker) == (3, 3))


NODES = {"driver": "simulator", "a": "agent"}
GONE, THERE, REPLACED = TokenPresence(True, False), TokenPresence(False, True), TokenPresence(True, True)


@pytest.fixture
def membership() -> Membership:
    membership = Membership("driver", dict(NODES))
    membership.alive.add("a")
    return membership


def note(membership: Membership, *changes: TokenPresence) -> str:
    return [membership.note("a", change, 3, NODES) for change in changes][-1]


def test_changes_that_nobody_has_taken_combine_to_whether_it_went_and_whether_it_is_there() -> None:
    assert THERE.followed_by(GONE) == GONE
    assert GONE.followed_by(THERE) == REPLACED
    assert REPLACED.followed_by(GONE).followed_by(THERE) == REPLACED


@pytest.mark.parametrize(
    ("changes", "leaving", "events"),
    [
        ((REPLACED,), set(), ["lost", "back"]),
        ((GONE, REPLACED, GONE), set(), ["lost", "back", "lost", "back", "lost"]),
        ((GONE,), {"a"}, []),  # the scenario ends it
    ],
)
def test_losses_and_returns_are_noted_in_pairs(membership, changes, leaving, events) -> None:
    membership.leaving |= leaving
    assert note(membership, *changes) == ""
    assert [event["what"] for event in membership.churn] == events
    assert ("a" in membership.alive) == changes[-1].present


def test_a_new_process_of_a_node_joins_in_an_epoch_after_one_without_it(membership: Membership) -> None:
    note(membership, REPLACED)
    assert membership.differs(NODES)
    first = membership.begin_epoch()
    assert first.keys() == {"driver"}
    assert membership.differs(first)
    second = membership.begin_epoch()
    assert second == NODES
    assert not membership.differs(second)
