"""Hosts of a scenario, and the states of their links over time."""

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mast_zenoh.errors import ConfigurationError
from mast_zenoh.faults import network
from mast_zenoh.faults.network import LinkState

NODES = ("simulator", "ego", "infra_1", "infra_2", "link_infra_1", "broker")
TWO = {"west": {"nodes": ["infra_1"]}, "east": {"nodes": ["ego", "infra_2"]}}


def resolved(hosts: object = TWO, *faults: dict, mode: str = "realtime") -> dict:
    placed = [(f"s.py: faults[{index}]", fault) for index, fault in enumerate(faults)]
    return network.resolve(hosts, placed, NODES, mode=mode, place="s.py", beside={"link_infra_1": "infra_1"})


def partition(at: float, until: float | None = None, hosts: object = "*") -> dict:
    return {"type": "HostPartition", "at": at, "until": until, "hosts": hosts}


def test_a_link_runs_with_its_agent_and_unassigned_nodes_run_at_the_centre() -> None:
    assert resolved({}) == {}
    hosts = resolved()["hosts"]
    assert {name: host["nodes"] for name, host in hosts.items()} == {
        "west": ["infra_1", "link_infra_1"],
        "east": ["ego", "infra_2"],
    }


def test_a_host_may_have_a_link_without_its_agent() -> None:
    hosts = resolved({"west": {"nodes": ["infra_*"]}, "edge": {"nodes": ["link_infra_1"]}})["hosts"]
    assert hosts["west"]["nodes"] == ["infra_1", "infra_2"]
    assert hosts["edge"]["nodes"] == ["link_infra_1"]


EGO, WEST = {"nodes": ["ego"]}, {"nodes": ["infra_1"]}


@pytest.mark.parametrize(
    ("hosts", "reason"),
    [
        ([], "hosts: found"),
        ({"../x": EGO}, "letters, digits, _"),
        ({"west": ["infra_1"]}, "hosts.west: found ['infra_1']"),
        ({"west": {"delay_ms": 3}}, "hosts.west: ScenarioHost needs"),
        ({"west": {"nodes": "infra_1"}}, "hosts.west.nodes: found 'infra_1'"),
        ({"west": {"nodes": ["infra_7"]}}, "no node 'infra_7'"),
        (
            {"west": WEST | {"delay": 3}},
            "hosts.west.delay: ScenarioHost",
        ),
        ({"west": WEST | {"loss": 2}}, "hosts.west: ScenarioHost: loss"),
        ({"west": WEST | {"bits_per_s": 0}}, "hosts.west: ScenarioHost: bits_per_s"),
        ({"west": EGO | {"delay_by": "tc"}}, "'tc'; known: netem"),
        ({"a": EGO, "b": {"nodes": ["e*"]}}, "hosts.b.nodes: 'ego'"),
        ({"west": {"nodes": []}}, "hosts.west: no node"),
    ],
)
def test_an_invalid_host_is_refused_with_its_path(hosts: object, reason: str) -> None:
    with pytest.raises(ConfigurationError) as refused:
        resolved(hosts)
    assert reason in str(refused.value)
    assert str(refused.value).startswith("s.py: hosts")


@pytest.mark.parametrize(
    ("kind", "parameters", "reason"),
    [
        ("Partition", dict(at=None), "HostPartition needs at"),
        ("Loss", {}, "HostLoss needs probability"),
        ("Loss", dict(probability=1.5), "probability: found 1.5"),
        ("Partition", dict(hosts=["wset"]), "no host 'wset'"),
        ("Partition", dict(until=1), "until: found 1.0"),
        ("Partition", dict(nodes=["ego"]), "nodes: HostPartition"),
        ("Delay", dict(delay_ms="20"), "delay_ms: found '20'"),
    ],
)
def test_an_invalid_host_fault_is_refused_with_its_path(kind: str, parameters: dict, reason: str) -> None:
    fault = {"type": f"Host{kind}", "at": 1, "hosts": "*"} | parameters
    with pytest.raises(ConfigurationError) as refused:
        resolved(TWO, {key: value for key, value in fault.items() if value is not None})
    assert str(refused.value).startswith("s.py: faults[0]")
    assert reason in str(refused.value)


def test_host_faults_are_refused_in_lock_step_with_the_reason() -> None:
    with pytest.raises(ConfigurationError, match=r"faults\[0\]: HostPartition .*realtime"):
        resolved(TWO, partition(1.0), mode="lockstep")
    assert resolved(TWO, mode="lockstep")["faults"] == [], "hosts without faults are allowed"


def test_overlapping_faults_add_up_and_heal_separately() -> None:
    hosts = {"west": {"nodes": ["infra_1"], "delay_ms": 10.0, "loss": 0.5, "bits_per_s": 1e6}}
    steps = network.steps(
        resolved(
            hosts,
            {"type": "HostDelay", "at": 1, "until": 4, "hosts": ["west"], "delay_ms": 20, "jitter_ms": 2},
            {"type": "HostLoss", "at": 2, "until": 3, "hosts": "*", "probability": 0.5},
            {"type": "HostBandwidth", "at": 2, "until": 5, "hosts": "*", "bits_per_s": 1e5},
            {"type": "HostBandwidth", "at": 2, "until": 6, "hosts": "*", "bits_per_s": 1e7},
            partition(3.5, 4.5),
        )
    )
    own = LinkState(False, 0.5, 10.0, 0.0, 1e6)
    assert [(at_s, states["west"]) for at_s, states in steps] == [
        (1.0, LinkState(False, 0.5, 30.0, 2.0, 1e6)),
        (2.0, LinkState(False, 0.75, 30.0, 2.0, 1e5)),
        (3.0, LinkState(False, 0.5, 30.0, 2.0, 1e5)),
        (3.5, LinkState(True, 0.5, 30.0, 2.0, 1e5)),
        (4.0, LinkState(True, 0.5, 10.0, 0.0, 1e5)),
        (4.5, LinkState(False, 0.5, 10.0, 0.0, 1e5)),
        (5.0, own),
    ], "nothing changes at 6.0: the host's own bandwidth is narrower"


times = st.integers(0, 20).map(float)


@st.composite
def healed_faults(draw: st.DrawFn) -> dict:
    at = draw(times)
    kind = draw(st.sampled_from(sorted(network.HOST_FAULTS)))
    drawn = {
        "HostPartition": {},
        "HostLoss": {"probability": draw(st.floats(0, 1))},
        "HostDelay": {"delay_ms": draw(st.floats(0, 100)), "jitter_ms": draw(st.floats(0, 10))},
        "HostBandwidth": {"bits_per_s": draw(st.floats(8e3, 1e9))},
    }[kind]
    aimed = draw(st.sampled_from(["*", ["west"], ["east"], ["east", "west"]]))
    return {"type": kind, "at": at, "until": at + draw(st.integers(1, 5)), "hosts": aimed, **drawn}


@given(st.lists(healed_faults(), max_size=6))
def test_links_return_to_their_initial_state_after_the_last_fault(faults: list[dict]) -> None:
    resolved_scenario = resolved(TWO, *faults)
    states = network.own_states(resolved_scenario)
    for step in network.steps(resolved_scenario):
        states |= step.states
        on = [f for f in faults if f["at"] <= step.at_s < f["until"]]
        for name, state in states.items():
            cut = any(f["type"] == "HostPartition" and (f["hosts"] == "*" or name in f["hosts"]) for f in on)
            assert state.cut == cut
    assert states == network.own_states(resolved_scenario)


@given(st.lists(healed_faults(), max_size=3))
def test_a_resolved_network_is_plain_json(faults: list[dict]) -> None:
    resolved_scenario = resolved(TWO, *faults)
    assert json.loads(json.dumps(resolved_scenario)) == resolved_scenario
    assert [band["at_s"] for band in network.bands(resolved_scenario)] == [fault["at"] for fault in faults]


junk = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8) | st.sampled_from(NODES),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
    max_leaves=8,
)
spec = st.dictionaries(st.sampled_from(["nodes", "delay_ms", "loss", "bits_per_s", "delay_by", "x"]), junk, max_size=4)
fault = st.fixed_dictionaries(
    {"type": st.sampled_from(sorted(network.HOST_FAULTS))},
    optional=dict.fromkeys(["at", "until", "hosts", "probability", "delay_ms", "jitter_ms", "bits_per_s", "x"], junk),
)


@given(st.dictionaries(junk.filter(lambda k: not isinstance(k, (list, dict))), junk | spec, max_size=2) | junk, fault)
def test_any_network_description_is_accepted_or_refused(hosts: object, fault: dict) -> None:
    refusal = "s.py: none"
    try:
        network.steps(resolved(hosts, fault))
    except ConfigurationError as error:
        refusal = str(error)
    assert refusal.startswith("s.py: ")


def test_the_timeline_shows_nodes_on_hosts_hit_by_a_fault() -> None:
    (band,) = network.bands(resolved(TWO, partition(1.0, 2.0, ["west"])))
    assert band == {
        "label": "partition of west",
        "kind": "fault",
        "type": "HostPartition",
        "at_s": 1.0,
        "until_s": 2.0,
        "nodes": ["infra_1", "link_infra_1"],
        "backend": "network",
    }


def test_requirements_of_a_network_are_listed_with_their_reason() -> None:
    assert network.needs(resolved()) == {}
    hosts = {
        "west": {"nodes": ["infra_1"], "loss": 0.1, "delay_ms": 5},
        "east": {"nodes": ["ego"], "jitter_ms": 1, "delay_by": "relay"},
        "north": {"nodes": ["infra_2"]},
    }
    slow = {"type": "HostBandwidth", "at": 0, "hosts": ["north"], "bits_per_s": 1e6}
    assert network.needs(resolved(hosts, partition(1.0, 2.0, ["east"]), slow)) == {
        "loss": ["west"],
        "delay": ["west"],
        "partition": ["east"],
        "relay": ["east"],
        "bandwidth": ["north"],
    }
