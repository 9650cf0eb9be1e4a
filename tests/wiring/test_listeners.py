"""Rewrites can add listeners and select one agent's wire."""

from fnmatch import fnmatch
from itertools import product
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from ports import node

from mast_zenoh.errors import WiringError
from mast_zenoh.wiring import maps
from mast_zenoh.wiring.endpoints import NodeOptions
from mast_zenoh.wiring.insertion import InsertionPoint, insert, parties, remove
from mast_zenoh.wiring.model import Wiring, to_mermaid, to_text

AGENTS = ("ego", "infra_1", "infra_2")


def wire(key: str, message: str, publisher: str, *subscribers: str) -> dict[str, Any]:
    return {"key": key, "message": message, "from": publisher, "to": list(subscribers)}


MAP = {
    "wire": [
        wire("agent/{agent}/pose", "pose", "simulator.pose", "agent.pose", "adversary.pose"),
        wire("agent/{agent}/tracks", "tracks", "agent.tracks", "broker.tracks"),
        wire("cc/picture", "picture", "broker.picture", "agent.picture"),
    ]
}
ON_TRACKS = {"wire": "agent/{agent}/tracks", "role": "adversary", "input": "tracks", "output": "tracks_out"}
PORTS = "pose:pose poses:pose tracks:tracks", "tracks_out:tracks"


def adversary(agent: str) -> NodeOptions:
    return node("adversary", *PORTS, agent=agent)


def world(**more: NodeOptions) -> dict[str, NodeOptions]:
    return {
        "simulator": node("simulator", outputs="pose:pose"),
        **{name: node("agent", "pose:pose picture:picture", "tracks:tracks") for name in AGENTS},
        "broker": node("broker", "tracks:tracks", "picture:picture"),
        **more,
    }


def listen(wire: str, input: str, role: Any = "adversary", **more: Any) -> dict[str, Any]:
    return {"wire": wire, "role": role, "input": input, **more}


def resolve(nodes: dict[str, NodeOptions], *rewrites: dict[str, Any]) -> Wiring:
    return maps.resolve([("map.toml", MAP), *((f"rewrite_{i}.toml", r) for i, r in enumerate(rewrites))], nodes)


def heard(wiring: Wiring, name: str, port: str) -> dict[str, str]:
    """Subject by key of the messages that a node hears on one port."""
    return {key: hears.subject for key, hears in wiring.ports(name).inputs.items() if hears.port == port}


DEFENCE = node("defence", "tracks:tracks poses:pose")


# -- selection of wires and nodes --------------------------------------------------------------------------------------


def test_an_adversary_receives_every_agents_pose_with_its_subject() -> None:
    wiring = resolve(world(adversary_1=adversary("infra_1")), {"listen": [listen("agent/*/pose", "poses")]})
    assert heard(wiring, "adversary_1", "poses") == {"agent/ego/pose": "ego", "agent/infra_2/pose": "infra_2"}
    assert heard(wiring, "adversary_1", "pose") == {"agent/infra_1/pose": "infra_1"}, "a node receives a wire only once"
    one_port = resolve(world(adversary_1=adversary("infra_1")), {"listen": [listen("agent/*/pose", "pose")]})
    assert sorted(heard(one_port, "adversary_1", "pose").values()) == sorted(AGENTS)


def test_a_port_that_a_role_may_lack_is_on_the_wire_of_the_nodes_that_have_it() -> None:
    nodes = world(adversary_1=adversary("infra_1"), adversary_2=node("adversary", "tracks:tracks", agent="infra_1"))
    with pytest.raises(WiringError, match=r"adversary_2.*input.*'pose'"):
        maps.resolve([("map.toml", MAP)], nodes)
    wiring = maps.resolve([("map.toml", MAP)], nodes, {("adversary", "input"): ("pose",)})
    assert [set(wiring.ports(f"adversary_{i}").inputs) for i in (1, 2)] == [{"agent/infra_1/pose"}, set()]


def test_a_placeholder_stands_for_the_agent_of_the_listener() -> None:
    nodes = world(adversary_1=adversary("infra_1"), adversary_2=adversary("infra_2"))
    wiring = resolve(nodes, {"listen": [listen("agent/{agent}/tracks", "tracks")]})
    assert heard(wiring, "adversary_1", "tracks") == {"agent/infra_1/tracks": "infra_1"}
    assert heard(wiring, "adversary_2", "tracks") == {"agent/infra_2/tracks": "infra_2"}


@pytest.mark.parametrize("every", ["agent/*/tracks", "agent/{agent}/tracks"])
def test_a_node_that_is_bound_to_no_agent_receives_all_tracks(every: str) -> None:
    wiring = resolve(world(guard=DEFENCE), {"listen": [listen(every, "tracks", "defence")]})
    assert heard(wiring, "guard", "tracks") == {f"agent/{name}/tracks": name for name in AGENTS}


def test_one_node_of_a_role_can_be_named() -> None:
    nodes = world(guard_1=DEFENCE, guard_2=DEFENCE)
    wiring = resolve(nodes, {"listen": [listen("agent/*/tracks", "tracks", "defence", node="guard_2")]})
    assert not wiring.ports("guard_1").inputs
    assert len(wiring.ports("guard_2").inputs) == 3


def test_all_nodes_of_the_role_receive_a_wire_without_a_placeholder() -> None:
    nodes = world(guard=node("defence", "seen:picture"))
    wiring = resolve(nodes, {"listen": [listen("cc/picture", "seen", "defence")]})
    assert heard(wiring, "guard", "seen") == {"cc/picture": ""}


# -- selection of the leg ----------------------------------------------------------------------------------------------


def test_a_listener_receives_what_the_subscribers_receive_unless_it_requests_the_source() -> None:
    nodes = world(adversary_1=adversary("infra_1"), guard=DEFENCE, source_guard=DEFENCE)
    entries = [
        listen("agent/infra_1/tracks", "tracks", "defence", node="guard"),
        listen("agent/infra_1/tracks", "tracks", "defence", node="source_guard", leg="source"),
    ]
    # Listeners come after all inserts, in any order of files and entries.
    for rewrites in ([{"listen": entries}, {"insert": [ON_TRACKS]}], [{"listen": entries, "insert": [ON_TRACKS]}]):
        wiring = resolve(nodes, *rewrites)
        assert list(heard(wiring, "guard", "tracks")) == ["agent/infra_1/tracks"]
        assert list(heard(wiring, "source_guard", "tracks")) == ["agent/infra_1/tracks/@tap/0"]
        assert list(heard(wiring, "adversary_1", "tracks")) == ["agent/infra_1/tracks/@tap/0"]
    plain = resolve(nodes, {"listen": entries})
    assert list(heard(plain, "source_guard", "tracks")) == ["agent/infra_1/tracks"], "no interposer is on the wire"


def test_a_listener_is_placed_before_the_branches() -> None:
    link = node("link", "tracks:tracks", "tracks_out:tracks", agent="ego")
    before_broker = {**ON_TRACKS, "role": "link", "to": "broker"}
    nodes = world(link_ego=link, guard=DEFENCE)
    wiring = resolve(nodes, {"insert": [before_broker], "listen": [listen("agent/*/tracks", "tracks", "defence")]})
    assert heard(wiring, "guard", "tracks") == {f"agent/{name}/tracks": name for name in AGENTS}
    assert "agent/ego/tracks/@tap/broker/0" in heard(wiring, "broker", "tracks")


# -- refusals ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("entry", "reason"),
    [
        (listen("agent/*/pse", "poses"), "no wire 'agent/\\*/pse'"),
        (listen("agent/infra_3/pose", "poses"), r"wire 'agent/infra_3/pose'.*'agent/infra_[12]/pose'"),
        (listen("agent/*/pose", "poes"), r"adversary_1.*'poes'.*'poses'"),
        (listen("agent/*/tracks", "poses"), r"adversary_1.poses.*'pose'.*'tracks'"),
        (listen("agent/*/pose", "poses", "adversry"), r"role 'adversry'.*'adversary'"),
        (listen("agent/*/pose", "poses", node="adversary_2"), r"node.*adversary.*'adversary_2'"),
        (listen("agent/*/pose", "poses", node="ego"), r"node.*'ego'.*adversary_1"),
        (listen("agent/*/pose", "poses", leg="tap"), r"leg.*'tap'.*'source'"),
        (
            listen("agent/*/pose", "poses", every="yes"),
            r"'every'; known.*optional",
        ),
        ({"wire": "agent/*/pose", "role": "adversary"}, "missing key 'input'"),
        (listen("agent/*/pose", "poses", role=["adversary"]), r"role.*\['adversary'\].*string"),
        (listen("agent/*/pose", "poses", node=3), r"node.*3.*string"),
        (listen("agent/infra_1/tracks", "tracks"), r"adversary_1 publishes.*'agent/infra_1/tracks'"),
        (listen("agent/ego/tracks", "tracks", "agent"), "input port 'tracks'"),
        (listen("agent/{agent}/pose", "poses"), r"adversary_1.*'agent/infra_1/pose'.*'pose'"),
        (listen("agent/{agent}/pose", "pose", leg="source"), "already receives 'agent/infra_1/pose'"),
        (listen("cc/picture", "tracks", "recorder"), "input port 'tracks'"),
    ],
)
def test_an_impossible_listener_is_refused_with_file_entry_and_reason(entry: dict[str, Any], reason: str) -> None:
    nodes = world(adversary_1=adversary("infra_1"), recorder=node("recorder", "everything:*"))
    with pytest.raises(WiringError, match=rf"^rewrite_0\.toml: listen 1: .*{reason}"):
        resolve(nodes, {"insert": [ON_TRACKS], "listen": [entry]})


def test_a_listen_entry_without_matching_nodes_is_refused() -> None:
    nodes = world(guard=node("defence", "poses:pose", agent="mobile_7"))
    reason = r"no defence belongs to 'agent/\{agent\}/pose': expected one with agent='ego', found guard \(mobile_7\)"
    with pytest.raises(WiringError, match=reason):
        resolve(nodes, {"listen": [listen("agent/{agent}/pose", "poses", "defence")]})
    assert resolve(world(), {"listen": [listen("agent/*/pose", "poses")]}) == resolve(world()), "a role without nodes"


def test_listening_on_a_port_that_already_has_the_wire_is_not_an_error() -> None:
    nodes = world(adversary_1=adversary("infra_1"), adversary_2=adversary("ego"))
    twice = {"listen": [listen("agent/ego/pose", "pose"), listen("agent/ego/pose", "pose")]}
    wiring = resolve(nodes, twice)
    assert heard(wiring, "adversary_2", "pose") == {"agent/ego/pose": "ego"}
    assert heard(wiring, "adversary_1", "pose").keys() == {"agent/ego/pose", "agent/infra_1/pose"}
    assert sum(subscriber == "adversary_1" for key, _, subscriber in wiring.flows() if key == "agent/ego/pose") == 1


# -- one named agent -------------------------------------------------------------------------------------------------


def test_an_insert_for_an_agent_takes_only_the_nodes_of_that_agent() -> None:
    nodes = world(adversary_1=adversary("infra_1"), adversary_2=adversary("ego"), adversary_3=adversary("ego"))
    wiring = resolve(nodes, {"insert": [{**ON_TRACKS, "wire": "agent/ego/tracks"}]})
    chains = {wire.key: wire.interposers for wire in wiring.wires if wire.message == "tracks"}
    assert chains == {
        "agent/ego/tracks": ("adversary_2", "adversary_3"),
        "agent/infra_1/tracks": (),
        "agent/infra_2/tracks": (),
    }
    named = resolve(nodes, {"insert": [{**ON_TRACKS, "wire": "agent/ego/tracks", "node": "adversary_3"}]})
    assert [wire.interposers for wire in named.wires if wire.interposers] == [("adversary_3",)]


def test_nodes_without_an_agent_are_inserted_as_specified() -> None:
    nodes = world(relay=node("relay", "tracks:tracks", "tracks_out:tracks"))
    wiring = resolve(nodes, {"insert": [{**ON_TRACKS, "role": "relay", "wire": "agent/infra_2/tracks"}]})
    assert {wire.key for wire in wiring.wires if wire.interposers} == {"agent/infra_2/tracks"}


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (dict(wire="agent/infra_2/tracks"), r"no adversary belongs.*'agent/infra_2/tracks'"),
        (dict(wire="agent/infra_9/tracks"), r"no wire 'agent/infra_9/tracks'.*'agent/infra_[12]/tracks'"),
        (dict(wire="agent/*/tracks"), r"no wire 'agent/\*/tracks'"),
        (dict(node="adversary_9"), r"node.*'adversary_9'.*'adversary_1'"),
    ],
)
def test_an_insert_with_an_unknown_name_is_refused(change: dict[str, str], reason: str) -> None:
    with pytest.raises(WiringError, match=rf"^rewrite_0\.toml: insert 1: {reason}"):
        resolve(world(adversary_1=adversary("infra_1")), {"insert": [{**ON_TRACKS, **change}]})


# -- presentation ------------------------------------------------------------------------------------------------------


def test_listeners_are_printed_drawn_and_serialised() -> None:
    nodes = world(adversary_1=adversary("infra_1"), guard=DEFENCE, source_guard=DEFENCE)
    entries = [
        listen("agent/infra_1/tracks", "tracks", "defence", node="guard"),
        listen("agent/infra_1/tracks", "tracks", "defence", node="source_guard", leg="source"),
    ]
    wiring = resolve(nodes, {"insert": [ON_TRACKS], "listen": entries})
    assert "infra_1 ── agent/infra_1/tracks/@tap/0 ──▶ source_guard (listens)" in to_text(wiring)
    assert 'adversary_1 --o|"agent/infra_1/tracks"| guard' in to_mermaid(wiring)
    written = next(wire for wire in wiring.to_json()["wires"] if wire["key"] == "agent/infra_1/tracks")
    assert written["subscribers"] == ["broker"]
    assert written["listeners"] == [
        {"node": "guard", "port": "tracks", "source": False, "key": "agent/infra_1/tracks"},
        {"node": "source_guard", "port": "tracks", "source": True, "key": "agent/infra_1/tracks/@tap/0"},
    ]


WIRES = [("agent/*/pose", "poses"), ("agent/infra_2/pose", "poses")]
WIRES += [("agent/*/tracks", "tracks"), ("agent/infra_2/tracks", "tracks"), ("agent/ego/tracks", "tracks")]
LISTENS = st.builds(
    lambda wire, role, source: listen(*wire, role, **({"leg": "source"} if source else {})),
    st.sampled_from(WIRES),
    st.sampled_from(["adversary", "defence"]),
    st.booleans(),
)


def listening(
    nodes: dict[str, NodeOptions], plain: Wiring, entries: list[dict[str, Any]]
) -> set[tuple[str, str]] | None:
    """Additional (key, node) pairs of these listeners; None: one is refused."""
    heard = {(wire.key, end.node): (end.port, False) for wire in plain.wires for end in wire.subscribers}
    pairs = set()
    for entry in entries:
        for wire, name in product(plain.wires, nodes):
            if nodes[name].role != entry["role"] or not fnmatch(wire.key, entry["wire"]):
                continue
            request = entry["input"], "leg" in entry
            taking_part = name in (leg.publisher.node for leg in wire.legs)
            if (taking_part or heard.get((wire.key, name), request) != request) and "*" not in entry["wire"]:
                return None
            if not taking_part and (wire.key, name) not in heard:
                heard[wire.key, name] = request
                pairs.add((wire.legs[0 if request[1] else -1].key, name))
    return pairs


@given(st.lists(LISTENS, max_size=4), st.booleans())
def test_listeners_receive_each_wire_once_but_not_their_own_and_change_nothing_for_others(entries, first) -> None:
    nodes = world(adversary_1=adversary("infra_1"), adversary_2=adversary("ego"), guard=DEFENCE)
    inserts = {"insert": [ON_TRACKS]}
    listens = {"listen": entries}
    plain = resolve(nodes, inserts)
    expected = listening(nodes, plain, entries)
    rewrites = (listens, inserts) if first else (inserts, listens)
    if expected is None:
        with pytest.raises(WiringError, match=": listen "):
            resolve(nodes, *rewrites)
        return
    wiring = resolve(nodes, *rewrites)
    assert {(key, subscriber) for key, _, subscriber in set(wiring.flows()) - set(plain.flows())} == expected
    assert wiring.keys() == plain.keys()
    for name in nodes:
        before, after = plain.ports(name), wiring.ports(name)
        assert after.outputs == before.outputs
        assert after.inputs.items() >= before.inputs.items()
        if name not in ("adversary_1", "adversary_2", "guard"):
            assert after.inputs == before.inputs
    for current, known in zip(wiring.wires, plain.wires, strict=True):
        ears = [end.node for leg in current.every_leg for end in current.receivers(leg)]
        assert len(ears) == len(set(ears)), "once"
        assert {listener.end.node for listener in current.listeners}.isdisjoint(parties(known)), "not its own messages"
        assert (current.legs, current.branches, current.subscribers) == (known.legs, known.branches, known.subscribers)
    assert Wiring.from_json(wiring.to_json()) == wiring


# -- changes during a run ----------------------------------------------------------------------------------------------


def test_a_listener_at_the_source_keeps_its_key_during_a_run() -> None:
    at_source = {"listen": [listen("agent/*/tracks", "tracks", "defence", leg="source")]}
    wiring = resolve(world(guard=DEFENCE), at_source)
    with pytest.raises(WiringError, match=r"listens.*source.*'agent/ego/tracks'"):
        insert(wiring, "mallory", InsertionPoint("agent/ego/tracks", "in", "out"))
    intercepted = resolve(world(guard=DEFENCE, first=adversary("ego")), {"insert": [ON_TRACKS]}, at_source)
    chain = insert(intercepted, "mallory", InsertionPoint("agent/ego/tracks", "in", "out"))
    assert chain.ports("guard") == intercepted.ports("guard")
    assert remove(chain, "mallory") == intercepted
    for both in (chain, intercepted):
        with pytest.raises(WiringError, match=r"listens.*source.*'agent/ego/tracks'"):
            remove(both, "first")


def test_a_listener_that_leaves_receives_nothing_more() -> None:
    nodes = world(first=adversary("ego"))
    wiring = resolve(nodes, {"insert": [ON_TRACKS], "listen": [listen("agent/infra_1/tracks", "tracks")]})
    assert not any(current.listeners for current in remove(wiring, "first").wires)
