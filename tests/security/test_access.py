"""The router's rules give every node exactly the rights of its wiring."""

import itertools
import json
from functools import cache
from typing import Any

import pytest
import zenoh
from hypothesis import given
from hypothesis import strategies as st

from mast_zenoh import scenario
from mast_zenoh.mesh.security.access import access_control
from mast_zenoh.mesh.security.credentials import LAUNCHER
from mast_zenoh.wiring.model import Endpoint, Leg, Listener, Wire, Wiring

includes = cache(lambda allowed, key: zenoh.KeyExpr(allowed).includes(zenoh.KeyExpr(key)))


def allows(access: dict[str, Any], common_name: str, flow: str, message: str, key: str) -> bool:
    """Whether a key expression is permitted: one rule must include all of it."""
    assert access["enabled"]
    assert access["default_permission"] == "deny"
    subjects = {s["id"] for s in access["subjects"] if common_name in s["cert_common_names"]}
    ids = {rule for policy in access["policies"] if subjects & set(policy["subjects"]) for rule in policy["rules"]}
    return any(
        includes(allowed, key)
        for rule in access["rules"]
        if rule["id"] in ids and rule["permission"] == "allow" and flow in rule["flows"] and message in rule["messages"]
        for allowed in rule["key_exprs"]
    )


PREFIX = "mast/r"
NODES = ("n0", "n1", "n2", "n3", "n4")
DRIVER = "n0"
NAMES = {name: f"{name}.r" for name in (*NODES, LAUNCHER)}
MESSAGES = (
    *("put", "delete", "declare_subscriber", "query", "reply", "declare_queryable"),
    *("liveliness_token", "liveliness_query", "declare_liveliness_subscriber"),
)


@st.composite
def wirings(draw: st.DrawFn) -> Wiring:
    """Wires with chains and listeners, and sometimes a node that hears all keys."""
    wires = []
    for number in range(draw(st.integers(0, 5))):
        chain = draw(st.permutations(NODES[:4]))
        length, key = draw(st.integers(1, 3)), f"w/{number}"
        ends = [Endpoint(node, "port") for node in chain]
        keys = [*(f"{key}/@tap/{hop}" for hop in range(length - 1)), key]
        heard = draw(st.integers(length, 4))  # from here on listeners
        hearers = [*((end,) for end in ends[1:length]), tuple(ends[length:heard])]
        legs = tuple(map(Leg, keys, ends[:length], hearers))
        listeners = tuple(Listener(end, draw(st.booleans())) for end in ends[heard:])
        wires.append(Wire(key, "", "clock", legs, listeners=listeners))
    return Wiring(tuple(wires), (Endpoint("n4", "everything"),) if draw(st.booleans()) else ())


def rules(wiring: Wiring) -> dict:
    return access_control(wiring, NAMES, prefix=PREFIX, driver=DRIVER)


WORDS = [
    *("mast", "r", "other", "w", "0", "1", "2", "*", "**", "@tap"),
    *("@control", "counts", "result", "epoch", "stop", "alive"),
]
CHUNKS = st.sampled_from([*WORDS, *NODES])
EXPRESSIONS = st.one_of(
    st.lists(CHUNKS, min_size=1, max_size=6).map("/".join),
    st.lists(CHUNKS, min_size=1, max_size=4).map(lambda chunks: "/".join([PREFIX, *chunks])),
    st.lists(CHUNKS, min_size=1, max_size=3).map(lambda chunks: "/".join([PREFIX, "w", *chunks])),
)


@given(wirings())
def test_only_the_ends_of_a_leg_have_rights_on_its_key(wiring: Wiring) -> None:
    access = rules(wiring)
    says = {(leg.key, leg.publisher.node) for _, leg in wiring.legs()}
    hears = {(key, subscriber) for key, _, subscriber in wiring.flows()}
    expected = {
        ("ingress", "put"): says,
        ("egress", "declare_subscriber"): says,  # otherwise a publisher never sees its subscribers and stays silent
        ("ingress", "declare_subscriber"): hears,
        ("egress", "put"): hears,
    }
    for key, node in itertools.product(wiring.keys(), NODES):
        for flow, message in itertools.product(("ingress", "egress"), MESSAGES):
            allowed = allows(access, NAMES[node], flow, message, f"{PREFIX}/{key}")
            assert allowed == ((key, node) in expected.get((flow, message), ())), (node, flow, message, key)


@given(wirings(), EXPRESSIONS, st.sampled_from(MESSAGES), st.sampled_from(["ingress", "egress"]))
def test_rights_outside_the_wiring_are_denied(wiring: Wiring, expression: str, message: str, flow: str) -> None:
    try:
        zenoh.KeyExpr(expression)
    except zenoh.ZError:
        return
    access = rules(wiring)
    says = {(leg.publisher.node, f"{PREFIX}/{leg.key}") for _, leg in wiring.legs()}
    hears = {(subscriber, f"{PREFIX}/{key}") for key, _, subscriber in wiring.flows()}
    expected = says if (flow, message) in (("ingress", "put"), ("egress", "declare_subscriber")) else hears
    data = message in ("put", "declare_subscriber")
    for node in NODES:
        if "@control" not in expression and not expression.startswith(f"{PREFIX}/alive"):
            given_ = data and (node, expression) in expected
            assert allows(access, NAMES[node], flow, message, expression) == given_, node


#: Below @control, what concerns other nodes, by the message that would reach or imitate it.
FORBIDDEN = {
    "put": ("counts", "failed"),
    "query": ("result", "fetch", "file"),
    "declare_queryable": ("fetch", "result"),
    "declare_subscriber": ("leave", "counts", "failed"),
}


@given(wirings(), st.sampled_from(NODES[1:]), st.sampled_from(MESSAGES), EXPRESSIONS)
def test_a_node_that_does_not_drive_cannot_control_others(wiring, node, message, expression) -> None:
    """Everything that it may send below @control or alive/ is about itself."""
    access = rules(wiring)
    controls = ("epoch", "stop", "act", "counts/*", "result/*", "leave/*", *(f"leave/{other}" for other in NODES))
    for key in controls:
        assert not allows(access, NAMES[node], "ingress", "put", f"{PREFIX}/@control/{key}")
    assert not allows(access, NAMES[node], "ingress", "liveliness_token", f"{PREFIX}/@control/launcher")
    for other in set(NODES) - {node}:
        assert not allows(access, NAMES[node], "ingress", "liveliness_token", f"{PREFIX}/alive/{other}")
        for message_, controls in FORBIDDEN.items():
            for control in controls:
                assert not allows(access, NAMES[node], "ingress", message_, f"{PREFIX}/@control/{control}/{other}")
    for wild in ("**", "@control/**", "@control/*", "*/**", "alive/*", "alive/**"):
        assert not allows(access, NAMES[node], "ingress", message, f"{PREFIX}/{wild}")


def test_the_driver_and_the_launcher_have_the_rights_to_control_a_run_and_no_others() -> None:
    access = rules(Wiring(()))

    def may(node: str, message: str, key: str) -> bool:
        return allows(access, NAMES[node], "ingress", message, f"{PREFIX}/{key}")

    assert all(may(DRIVER, "put", f"@control/{key}") for key in ("epoch", "stop", "act", f"counts/{DRIVER}"))
    assert may(DRIVER, "declare_subscriber", "@control/counts/*")
    assert may(DRIVER, "declare_liveliness_subscriber", "alive/*")
    assert may(DRIVER, "query", f"@control/result/{DRIVER}")
    assert not may(DRIVER, "put", "@control/leave/n1")
    assert all(may(LAUNCHER, "put", f"@control/{key}") for key in ("stop", "leave/n1", "leave/n4"))
    assert may(LAUNCHER, "declare_queryable", "@control/result/*")
    assert may(LAUNCHER, "declare_subscriber", "clock")
    assert may(LAUNCHER, "declare_subscriber", "@control/failed/*")
    assert may(LAUNCHER, "declare_liveliness_subscriber", "alive/*")
    for node in NAMES:
        for message in ("query", "declare_queryable"):
            for control in ("rewire", "intercept", f"drain/{node}"):
                assert not may(node, message, f"@control/{control}"), "static rules cannot follow a changed wiring"
    assert not may(LAUNCHER, "put", "@control/epoch")
    assert not may(LAUNCHER, "declare_subscriber", "**")


def test_no_process_has_rights_outside_the_run() -> None:
    access = rules(Wiring((Wire("w/0", "", "clock", (Leg("w/0", Endpoint("n0", "a"), (Endpoint("n1", "b"),)),)),)))
    processes = (*NAMES.values(), "n0.other", "n0", "", "@authority.r")
    keys = ("mast/other/w/0", "@/*/router/**", "**", "w/0")
    for asked in itertools.product(processes, ("ingress", "egress"), MESSAGES, keys):
        assert not allows(access, *asked), asked


@pytest.mark.parametrize(("source", "key"), [(False, "w/0"), (True, "w/0/@tap/0")])
def test_a_listener_may_subscribe_only_to_the_key_of_its_leg(source: bool, key: str) -> None:
    ends = [Endpoint(name, "port") for name in ("n0", "n1", "n2")]
    legs = (Leg("w/0/@tap/0", ends[0], (ends[1],)), Leg("w/0", ends[1], (ends[2],)))
    access = rules(Wiring((Wire("w/0", "", "clock", legs, listeners=(Listener(Endpoint("n3", "port"), source),)),)))

    def may(flow: str, message: str, asked: str) -> bool:
        return allows(access, NAMES["n3"], flow, message, f"{PREFIX}/{asked}")

    for asked in ("w/0", "w/0/@tap/0"):
        assert may("ingress", "declare_subscriber", asked) == may("egress", "put", asked) == (asked == key)
        assert not may("ingress", "put", asked)
        assert not may("egress", "declare_subscriber", asked)
    assert not may("ingress", "declare_subscriber", "w/**")


def test_the_rules_of_a_shipped_scenario_have_wildcards_only_below_control() -> None:
    path, loaded = scenario.load("coordinated", ["n_infrastructure=3", "n_adversaries=2"])
    resolved = scenario.resolve(path, loaded, frames=2, record=True)
    names = {name: f"{name}.r" for name in (*resolved.nodes, LAUNCHER)}
    access = access_control(Wiring.from_json(resolved.wiring), names, prefix=PREFIX, driver="simulator")
    wild = {key for rule in access["rules"] for key in rule["key_exprs"] if "*" in key}
    controls = (f"@control/{what}/*" for what in ("counts", "failed", "result", "fetch", "file", "leave"))
    assert wild == {f"{PREFIX}/{key}" for key in (*controls, "alive/*")}
    assert len({rule["id"] for rule in access["rules"]}) == len(access["rules"])
    config = zenoh.Config()
    config.insert_json5("access_control", json.dumps(access))  # Zenoh accepts every key
