"""A rewrite with `to` affects one subscriber only."""

from typing import Any

import pytest
import zenoh
from hypothesis import given
from hypothesis import strategies as st
from ports import node

from mast_zenoh.errors import WiringError
from mast_zenoh.wiring import maps
from mast_zenoh.wiring.endpoints import NodeOptions
from mast_zenoh.wiring.model import TAP, Endpoint, Wiring, to_mermaid, to_text

SUBSCRIBERS = ["broker.tracks", "evaluator.tracks"]
TRACKS = {"key": "agent/{agent}/tracks", "message": "tracks", "from": "agent.tracks", "to": SUBSCRIBERS}
PICTURE = {
    "key": "cc/picture",
    "message": "picture",
    "from": "command_center.picture",
    "to": ["agent.picture", "evaluator.picture"],
}
POSE = {
    "key": "agent/{agent}/pose",
    "message": "pose",
    "from": "simulator.pose",
    "to": ["agent.pose", "adversary.pose"],
}
PORTS = "seen:tracks picture:picture", "said:tracks picture_out:picture"


def world(*agents: str, **more: NodeOptions) -> dict[str, NodeOptions]:
    return {
        **{name: node("agent", "picture:picture", "tracks:tracks") for name in agents},
        "broker": node("broker", "tracks:tracks"),
        "evaluator": node("evaluator", "tracks:tracks picture:picture"),
        "cc": node("command_center", outputs="picture:picture"),
        **more,
    }


def up(role: str = "link", to: str | None = "broker") -> dict:
    entry = {"wire": "agent/{agent}/tracks", "role": role, "input": "seen", "output": "said"}
    return {"insert": [entry if to is None else entry | {"to": to}]}


def down(role: str = "link", to: str | None = "agent") -> dict:
    entry = {"wire": "cc/picture", "role": role, "input": "picture", "output": "picture_out"}
    return {"insert": [entry if to is None else entry | {"to": to}]}


def resolve(nodes: dict[str, NodeOptions], *rewrites: dict, wires: tuple[dict, ...] = (TRACKS, PICTURE)) -> Wiring:
    return maps.resolve([(f"file_{i}.toml", source) for i, source in enumerate(({"wire": wires}, *rewrites))], nodes)


@pytest.mark.parametrize(
    ("rewrite", "reason"),
    [
        (up(to="brokre"), r"file_1.toml.*'brokre'.*'broker'"),
        (up(to="agent"), r"'agent'.*'agent/{agent}/tracks'; known"),
        (up(to=["broker"]), r"role.*subscribes.*wire"),
        (up(to=""), "role '' subscribes"),
    ],
)
def test_a_rewrite_for_a_role_that_does_not_subscribe_to_the_wire_is_refused(rewrite: dict, reason: str) -> None:
    with pytest.raises(WiringError, match=reason):
        resolve(world("ego", link_1=node("link", *PORTS, agent="ego")), rewrite)


def test_a_link_before_one_of_several_subscribers_must_name_the_subscriber() -> None:
    with pytest.raises(WiringError, match=r"'cc/picture'.*infra_1.*link_1"):
        resolve(world("ego", "infra_1", link_1=node("link", *PORTS)), down())
    assert resolve(world("ego", link_1=node("link", *PORTS)), down()).ports("ego").inputs.keys() == {
        "cc/picture/@tap/ego/0"
    }


def test_a_node_is_on_a_wire_only_once() -> None:
    nodes = world("ego", link_1=node("link", *PORTS, agent="ego"))
    for rewrites in ((up(), up()), (up(), up(to="evaluator")), (up(to=None), up()), (up(), up(to=None))):
        with pytest.raises(WiringError, match=r"link_1.*already.*'agent/ego/tracks'"):
            resolve(nodes, *rewrites)


names = st.from_regex(r"[a-z0-9]{1,4}", fullmatch=True)


@given(agents=st.lists(names, min_size=1, max_size=4, unique=True), data=st.data())
def test_any_mix_of_links_and_adversaries_delivers_every_wire_once_to_every_subscriber(agents, data) -> None:
    nodes = world(*(f"a_{name}" for name in agents))
    plain = resolve(nodes)
    plain_keys = plain.keys()
    rewrites, order, before_agent = [], [], {}
    for i, letter in enumerate("bcdef"[: data.draw(st.integers(0, 5))]):
        agent = "a_" + data.draw(st.sampled_from(agents))
        nodes[str(i)] = node(f"role_{letter}", *PORTS, agent=agent)  # a name that looks like the number of a tap
        to = data.draw(st.sampled_from([None, "broker", "evaluator"]))
        rewrites.append(up(f"role_{letter}", to))
        order.append((str(i), agent, to))
        if data.draw(st.booleans()):
            rewrites.append(down(f"role_{letter}", "agent"))
            before_agent.setdefault(agent, []).append(str(i))
    wiring = resolve(nodes, *rewrites)

    keys = wiring.keys()
    assert len(keys) == len(set(keys)), "one publisher per key"
    for key in keys:
        zenoh.KeyExpr(key)
        if TAP in key:
            assert not zenoh.KeyExpr("**").intersects(zenoh.KeyExpr(key)), "wildcards do not see taps"
            assert not any(zenoh.KeyExpr(f"{other}/**").intersects(zenoh.KeyExpr(key)) for other in plain_keys)

    hears = {leg.key: leg.subscribers for _, leg in wiring.legs()}
    passes = {}  # an interposer's input key to its output key
    for name in (name for name in nodes if name not in world(*(f"a_{a}" for a in agents))):
        ports = wiring.ports(name)
        for key, hear in ports.inputs.items():
            passes[name, key] = ports.outputs["said" if hear.port == "seen" else "picture_out", hear.subject]
    for wire, before in zip(wiring.wires, plain.wires, strict=True):
        reached: list[tuple[Endpoint, tuple[str, ...]]] = []
        waves = [(wire.legs[0].key, ())]
        while waves:
            key, way = waves.pop()
            for end in hears[key]:
                if (end.node, key) in passes:
                    assert end.node not in way, "no loop"
                    waves.append((passes[end.node, key], (*way, end.node)))
                else:
                    reached.append((end, way))
        assert sorted(end.node for end, _ in reached) == sorted(end.node for end in before.legs[0].subscribers)
        assert wire.subscribers == before.subscribers
        assert wire.legs[-1].key == before.legs[0].key
        for end, way in reached:
            if wire.message == "picture":
                assert way == tuple(before_agent.get(end.node, ())), "only before the agent that its option names"
            else:
                own = [(n, to) for n, agent, to in order if agent == wire.subject and to in (None, end.node)]
                on_trunk_first = sorted(own, key=lambda entry: entry[1] is not None)
                assert way == tuple(n for n, to in on_trunk_first), "in the order of the rewrites"
    for name in nodes:
        if nodes[name].role in ("broker", "evaluator", "agent"):
            with_, without = wiring.ports(name), plain.ports(name)
            assert sorted(map(str, with_.inputs.values())) == sorted(map(str, without.inputs.values()))
    assert Wiring.from_json(wiring.to_json()) == wiring


def test_branches_are_printed_drawn_and_overheard() -> None:
    nodes = world("ego", link_1=node("link", *PORTS, agent="ego"), ear=node("recorder", "everything:*"))
    wiring = resolve(nodes, up())
    text = to_text(wiring)
    assert "ego ─▶ ([link_1] ─▶ broker), evaluator" in text
    assert "ego ── agent/ego/tracks ──▶ link_1, evaluator" in text
    assert "link_1 ── agent/ego/tracks/@tap/broker/0 ──▶ broker" in text
    assert 'link_1 -.->|"agent/ego/tracks/@tap/broker/0"| broker' in to_mermaid(wiring)
    assert "agent/ego/tracks/@tap/broker/0" in wiring.ports("ear").inputs
    tracks_wire = next(wire for wire in wiring.to_json()["wires"] if wire["key"] == "agent/ego/tracks")
    assert tracks_wire["subscribers"] == ["broker", "evaluator"]
    assert tracks_wire["interposers"] == ["link_1"]
    assert [leg.get("before") for leg in tracks_wire["legs"]] == [None, "broker"]


def on_pose(**more: str) -> dict:
    entry = {"wire": "agent/{agent}/pose", "role": "adversary", "input": "pose", "output": "pose_out"}
    return {"insert": [entry | more]}


def posed(**adversaries: Any) -> dict[str, NodeOptions]:
    return {
        "simulator": node("simulator", outputs="pose:pose"),
        **{name: node("agent", "pose:pose") for name in ("ego", "infra_1", "infra_2")},
        **{
            name: NodeOptions("adversary", {"agent": agent}, {"pose": "pose"}, {"pose_out": "pose"})
            for name, agent in adversaries.items()
        },
    }


def resolve_pose(nodes: dict[str, NodeOptions], *rewrites: dict) -> Wiring:
    return resolve(nodes, *rewrites, wires=(POSE,))


def test_a_subscriber_that_is_inserted_into_its_wire_receives_it_once() -> None:
    nodes = posed(adversary_1="infra_1")
    for rewrite, received, sent in (
        (on_pose(to="agent"), "agent/infra_1/pose", "agent/infra_1/pose/@tap/infra_1/0"),
        (on_pose(), "agent/infra_1/pose/@tap/0", "agent/infra_1/pose"),
    ):
        wiring = resolve_pose(nodes, rewrite)
        assert set(wiring.ports("adversary_1").inputs) == {received}
        assert wiring.ports("adversary_1").outputs == {("pose_out", "infra_1"): sent}
        assert set(wiring.ports("infra_1").inputs) == {sent}


def test_two_subscribers_that_are_inserted_into_their_wire_make_a_chain() -> None:
    wiring = resolve_pose(posed(adversary_1="infra_1", adversary_2="infra_1"), on_pose(to="agent"))
    legs = [f"agent/infra_1/pose/@tap/infra_1/{i}" for i in range(2)]
    assert set(wiring.ports("adversary_1").inputs) == {"agent/infra_1/pose"}
    assert set(wiring.ports("adversary_2").inputs) == {legs[0]}
    assert set(wiring.ports("infra_1").inputs) == {legs[1]}


HEARD = {"key": "agent/{agent}/broadcast", "message": "tracks", "from": "peer.broadcast", "to": ["other peer.heard"]}
AGENTS = ("ego", "infra_1", "infra_2")


def hearing(*linked: str) -> dict[str, NodeOptions]:
    return {
        **{name: node("agent") for name in AGENTS},
        **{f"peer_{name}": node("peer", "heard:tracks", "broadcast:tracks", agent=name) for name in AGENTS},
        **{f"link_{a}": node("link", "in:tracks", "out:tracks", agent=a, peer=f"peer_{a}") for a in linked},
    }


def before_peers(role: str = "other link", to: str = "peer", **more: Any) -> dict:
    entry = {"wire": "agent/{agent}/broadcast", "role": role, "input": "in", "output": "out", "to": to}
    return {"insert": [entry | more]}


def test_the_links_of_all_other_agents_come_before_the_peers_that_their_options_name() -> None:
    wiring = resolve(hearing("ego", "infra_1"), before_peers(), wires=(HEARD,))
    branches = {
        wire.subject: {branch.subscriber.node: [leg.publisher.node for leg in branch.legs] for branch in wire.branches}
        for wire in wiring.wires
    }
    assert branches == {
        "ego": {"peer_infra_1": ["link_infra_1"]},
        "infra_1": {"peer_ego": ["link_ego"]},
        "infra_2": {"peer_ego": ["link_ego"], "peer_infra_1": ["link_infra_1"]},
    }


def test_an_agents_own_link_cannot_come_before_its_peer_which_does_not_hear_it() -> None:
    with pytest.raises(WiringError, match=r"link_ego.*peer_ego.*'agent/ego/broadcast'"):
        resolve(hearing("ego"), before_peers("link"), wires=(HEARD,))


def test_an_optional_rewrite_for_a_role_that_does_not_subscribe_is_left_out() -> None:
    nodes = hearing("ego")
    with pytest.raises(WiringError, match="role 'broker' subscribes"):
        resolve(nodes, before_peers(to="broker"), wires=(HEARD,))
    plain = resolve(nodes, wires=(HEARD,))
    assert resolve(nodes, before_peers(to="broker", optional=True), wires=(HEARD,)) == plain
