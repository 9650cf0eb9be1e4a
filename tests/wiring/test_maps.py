"""Every port of every node gets its key; invalid maps are refused."""

from dataclasses import replace
from pathlib import Path

import pytest
from ports import node

from mast_zenoh.config import bundle
from mast_zenoh.errors import WiringError
from mast_zenoh.wiring import maps
from mast_zenoh.wiring.endpoints import NodeOptions
from mast_zenoh.wiring.model import Input, Wiring, to_mermaid, to_text

MAPS = bundle.ROOT / "keyexpr_maps"


SIMULATOR = node("simulator", outputs="detections:detections clock:clock")
AGENT = node("agent", inputs="detections:detections", outputs="tracks:tracks")
BROKER = node("broker", inputs="tracks:tracks")
MAP = {
    "wire": [
        {
            "key": "agent/{agent}/detections",
            "message": "detections",
            "from": "simulator.detections",
            "to": ["agent.detections"],
        },
        {"key": "agent/{agent}/tracks", "message": "tracks", "from": "agent.tracks", "to": ["broker.tracks"]},
    ]
}


def interposer(**options: str) -> NodeOptions:
    return node("adversary", inputs="seen:detections", outputs="said:detections", **options)


def insertion(role: str = "adversary") -> dict:
    return {"insert": [{"wire": "agent/{agent}/detections", "role": role, "input": "seen", "output": "said"}]}


def resolve(nodes: dict[str, NodeOptions], *sources: dict) -> Wiring:
    return maps.resolve([(f"file_{i}.toml", source) for i, source in enumerate((MAP, *sources))], nodes)


def interposers(wiring: Wiring) -> tuple[str, ...]:
    return tuple(name for wire in wiring.wires for name in wire.interposers)


def test_a_placeholder_creates_one_wire_per_node_of_its_role() -> None:
    wiring = resolve({"simulator": SIMULATOR, "ego": AGENT, "infra_1": AGENT, "broker": BROKER})
    assert wiring.keys() == (
        "agent/ego/detections",
        "agent/infra_1/detections",
        "agent/ego/tracks",
        "agent/infra_1/tracks",
    )
    assert wiring.ports("infra_1").inputs["agent/infra_1/detections"].source == "simulator"
    assert wiring.ports("simulator").outputs["detections", "ego"] == "agent/ego/detections"
    assert set(wiring.ports("broker").inputs) == {"agent/ego/tracks", "agent/infra_1/tracks"}
    of_agents = {name: wiring.find(name, message="tracks") for name in ("ego", "infra_1", "truck")}
    assert {name: wire and wire.key for name, wire in of_agents.items()} == {
        "ego": "agent/ego/tracks",
        "infra_1": "agent/infra_1/tracks",
        "truck": None,
    }


def test_an_optional_insert_can_name_the_wire_of_one_agent() -> None:
    nodes = {"simulator": SIMULATOR, "ego": AGENT, "broker": BROKER, "liar": interposer(agent="ego")}
    entry = insertion()["insert"][0] | {"wire": "agent/ego/detections", "optional": True}
    assert interposers(resolve(nodes, {"insert": [entry]})) == ("liar",)
    absent = resolve(nodes, insertion(), {"insert": [entry | {"wire": "agent/truck/detections"}]})
    assert absent == resolve(nodes, insertion())


@pytest.mark.parametrize("role", ["link", "other link"])
def test_a_map_inserts_no_link_that_is_of_a_single_wire(role: str) -> None:
    link = node("link", inputs="seen:detections", outputs="said:detections", agent="")
    nodes = {"simulator": SIMULATOR, "ego": AGENT, "broker": BROKER, "link_agent_ego_tracks": link}
    assert interposers(resolve(nodes, insertion(role))) == ()


def broadcasts(to: str) -> dict:
    return {"wire": [{"key": "agent/{agent}/broadcast", "message": "tracks", "from": "peer.said", "to": [to]}]}


PEERS = {
    "simulator": SIMULATOR,
    "broker": BROKER,
    **dict.fromkeys(("ego", "infra_1", "infra_2"), AGENT),
    **{
        f"peer_{agent}": node("peer", inputs="heard:tracks", outputs="said:tracks", agent=agent)
        for agent in ("ego", "infra_1", "infra_2")
    },
}


def test_other_leads_to_the_nodes_of_all_other_agents() -> None:
    wiring = resolve(PEERS, broadcasts("other peer.heard"))
    wires = {wire.key: [end.node for end in wire.subscribers] for wire in wiring.wires}
    assert wires["agent/ego/broadcast"] == ["peer_infra_1", "peer_infra_2"]
    assert wires["agent/infra_1/broadcast"] == ["peer_ego", "peer_infra_2"]
    with pytest.raises(WiringError, match=r"peer_ego.*messages.*'agent/ego/broadcast'"):
        resolve(PEERS, broadcasts("peer.heard"))
    with pytest.raises(WiringError, match=r"'others peer\.heard'.*role\.port"):
        resolve(PEERS, broadcasts("others peer.heard"))


def test_each_further_sensor_of_an_agent_has_a_wire_for_interposers_of_its_agent() -> None:
    of_sensors = {**MAP["wire"][0], "key": "agent/{agent}/detections/{sensor}"}
    pole = replace(AGENT, options={"sensor": ("radar", "camera")})
    nodes = {"simulator": SIMULATOR, "ego": AGENT, "infra_1": pole, "adversary_1": interposer(agent="infra_1")}
    on_radar = {"insert": [{**insertion()["insert"][0], "wire": "agent/infra_1/detections/radar"}]}
    wiring = resolve(nodes, {"wire": [of_sensors]}, on_radar)
    outputs = wiring.ports("simulator").outputs
    assert {subject: key for (_, subject), key in outputs.items()} == {
        "ego": "agent/ego/detections",
        "infra_1": "agent/infra_1/detections",
        "infra_1/radar": "agent/infra_1/detections/radar/@tap/0",
        "infra_1/camera": "agent/infra_1/detections/camera",
    }
    assert wiring.ports("infra_1").inputs["agent/infra_1/detections/radar"].subject == "infra_1/radar"
    assert wiring.ports("adversary_1").outputs["said", "infra_1/radar"] == "agent/infra_1/detections/radar"
    assert Wiring.from_json(wiring.to_json()) == wiring
    with pytest.raises(WiringError, match=r"adversary belongs.*'agent/ego/detections'"):
        resolve(nodes, {"insert": [{**insertion()["insert"][0], "wire": "agent/ego/detections"}]})


def test_a_port_cannot_publish_two_wires_of_one_agent() -> None:
    peers = {f"peer_{name}": node("peer", inputs="heard:tracks", outputs="said:tracks", agent=name) for name in "ab"}
    liar = node("adversary", inputs="seen:tracks", outputs="told:tracks", agent="a")
    nodes = {"simulator": SIMULATOR, "a": AGENT, "b": AGENT, "broker": BROKER, **peers, "liar": liar}
    inserts = [
        {"wire": f"agent/{{agent}}/{wire}", "role": "adversary", "input": "seen", "output": "told"}
        for wire in ("broadcast", "tracks")
    ]
    assert resolve(nodes, broadcasts("other peer.heard"), {"insert": inserts[:1]}).passages()
    reason = r"liar\.told would publish on 'agent/a/tracks' and on 'agent/a/broadcast': expected a port for each"
    with pytest.raises(WiringError, match=reason):
        resolve(nodes, broadcasts("other peer.heard"), {"insert": inserts})


@pytest.mark.parametrize(
    ("source", "reason"),
    [
        ({"wires": []}, r"unknown.*'wires'.*'wire'"),
        ({"wire": [{"key": "x"}]}, "'from', 'message', 'to'"),
        ({"wire": [dict(MAP["wire"][0], key="y", message="detection")]}, "mean 'detections'"),
        ({"wire": [dict(MAP["wire"][0], key="a//b")]}, "valid key expression"),
        ({"wire": [dict(MAP["wire"][0], key="a/*/b")]}, "valid key expression"),
        ({"wire": [dict(MAP["wire"][0], key="a/@b")]}, "valid key expression"),
        ({"wire": [dict(MAP["wire"][0], key="{agent}/{broker}")]}, "2 placeholders"),
        ({"wire": [dict(MAP["wire"][0])]}, r"already.*publisher"),
        ({"wire": [dict(MAP["wire"][0], key="y", **{"from": "simulator.detection"})]}, "mean 'detections'"),
        ({"wire": [dict(MAP["wire"][0], key="y", **{"from": "simulater.detections"})]}, "mean 'simulator'"),
        ({"wire": [dict(MAP["wire"][0], key="y", **{"from": "simulator"})]}, "expected role.port"),
        ({"wire": [dict(MAP["wire"][1], key="all/tracks")]}, "2 publishers"),
        ({"wire": [dict(MAP["wire"][0], key="y", to=["agent.tracks"])]}, "input port 'tracks'"),
        ({"wire": [dict(MAP["wire"][0], key="y", **{"from": "simulator.clock"})]}, "carries 'clock' messages"),
        ({"insert": [dict(insertion()["insert"][0], wire="agent/{agent}/detection")]}, "did you mean"),
        ({"insert": [dict(insertion()["insert"][0], role="agent")]}, "input port 'seen'"),
    ],
)
def test_an_invalid_map_is_refused_with_file_entry_and_reason(source: dict, reason: str) -> None:
    nodes = {"simulator": SIMULATOR, "ego": AGENT, "infra_1": AGENT, "broker": BROKER}
    with pytest.raises(WiringError, match=reason) as caught:
        resolve(nodes, source)
    assert "file_1.toml" in str(caught.value)


def test_a_name_that_is_not_a_key_chunk_is_refused() -> None:
    with pytest.raises(WiringError, match="one chunk"):
        resolve({"simulator": SIMULATOR, "a/b": AGENT})


def test_a_missing_or_broken_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(WiringError, match=r"mean 'on_detections\.toml'"):
        maps.load(MAPS / "on_detection.toml")
    (tmp_path / "map.toml").write_text("[[wire")
    with pytest.raises(WiringError, match="not TOML"):
        maps.load(tmp_path / "map.toml")
    with pytest.raises(WiringError, match=r"directory.*key-expression map"):
        maps.load(tmp_path)


def test_the_wiring_is_printed_as_text_and_drawn_with_its_rewrites() -> None:
    nodes = {"simulator": SIMULATOR, "ego": AGENT, "adversary_1": interposer(agent="ego"), "broker": BROKER}
    wiring = resolve(nodes, insertion())
    assert "* agent/ego/detections" in to_text(wiring)
    assert "simulator ── agent/ego/detections/@tap/0 ──▶ adversary_1" in to_text(wiring)
    drawn = to_mermaid(wiring)
    assert drawn.startswith("flowchart LR")
    assert 'simulator -.->|"agent/ego/detections/@tap/0"| adversary_1' in drawn


def test_a_node_that_receives_every_key_receives_tap_legs_and_is_on_no_wire() -> None:
    ear = node("recorder", inputs="everything:*")
    nodes = {"simulator": SIMULATOR, "ego": AGENT, "adversary_1": interposer(agent="ego"), "broker": BROKER}
    without, wiring = resolve(nodes, insertion()), resolve({**nodes, "ear": ear}, insertion())
    assert wiring.wires == without.wires
    heard = wiring.ports("ear").inputs
    assert tuple(heard) == wiring.keys()
    assert heard["agent/ego/detections/@tap/0"] == Input("everything", "ego", "detections", "simulator")
    assert ("agent/ego/detections/@tap/0", "simulator", "ear") in set(wiring.flows())
    assert Wiring.from_json(wiring.to_json()) == wiring
    lines = to_text(wiring).splitlines()
    assert "subscribes to every" in lines[-1]
    assert lines[:-1] == to_text(without).splitlines()
    assert to_mermaid(wiring) == to_mermaid(without)


@pytest.mark.parametrize("more", [dict(outputs="tracks:tracks"), dict(inputs="everything:* clock:clock")])
def test_a_node_that_receives_every_key_has_no_other_port(more: dict[str, str]) -> None:
    ear = node("recorder", **(dict(inputs="everything:*") | more))
    with pytest.raises(WiringError, match=r"'ear'.*subscribes.*every"):
        resolve({"simulator": SIMULATOR, "ego": AGENT, "broker": BROKER, "ear": ear})


@pytest.mark.parametrize(
    "damage",
    [{"nodes": None}, {"nodes": {"ego": None}}, {"overhearers": None}, {"nodes": {"a": {"affects": {"": None}}}}],
)
def test_a_wiring_of_which_parts_are_null_is_read_without_them(damage: dict) -> None:
    assert Wiring.from_json({"wires": [], **damage}).wires == ()
