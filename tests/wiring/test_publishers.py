"""A rewrite can give a wire another publisher; all else on the wire stays."""

from typing import Any

import pytest
from ports import node

from mast_zenoh.errors import WiringError
from mast_zenoh.wiring import maps
from mast_zenoh.wiring.endpoints import NodeOptions
from mast_zenoh.wiring.model import Wiring

MAP: dict[str, Any] = {
    "wire": [
        {
            "key": "agent/{agent}/points",
            "message": "points",
            "from": "simulator.points",
            "to": ["detector.points"],
        },
        {
            "key": "agent/{agent}/detections",
            "message": "detections",
            "from": "simulator.detections",
            "to": ["agent.detections"],
        },
    ]
}
PUBLISH = {"publish": [{"wire": "agent/{agent}/detections", "role": "detector", "output": "detections"}]}
ADVERSARY = {"insert": [{"wire": "agent/{agent}/detections", "role": "adversary"}]}


def detector(agent: str, outputs: str = "detections:detections") -> NodeOptions:
    return node("detector", "points:points", outputs, agent=agent)


def resolve(*rewrites: dict[str, Any], **nodes: NodeOptions) -> Wiring:
    every = {
        "simulator": node("simulator", outputs="points:points detections:detections"),
        **{name: node("agent", "detections:detections") for name in ("ego", "infra_1")},
        **nodes,
    }
    return maps.resolve([("map.toml", MAP), *((f"rewrite_{i}.toml", r) for i, r in enumerate(rewrites))], every)


def publishers(wiring: Wiring) -> dict[str, str]:
    return {wire.key: wire.legs[0].publisher.node for wire in wiring.wires if wire.message == "detections"}


def test_a_detector_publishes_the_detections_of_its_agent_and_the_simulator_those_of_all_others() -> None:
    wiring = resolve(PUBLISH, detector_1=detector("infra_1"))
    assert publishers(wiring) == {"agent/ego/detections": "simulator", "agent/infra_1/detections": "detector_1"}
    assert wiring.ports("ego").inputs.keys() == {"agent/ego/detections"}


def test_without_a_node_of_the_role_nothing_changes() -> None:
    assert set(publishers(resolve(PUBLISH)).values()) == {"simulator"}


def test_an_interposer_comes_after_the_new_publisher_in_whatever_order_they_are_named() -> None:
    liar = node("adversary", "detections:detections", "detections_out:detections", agent="infra_1")
    nodes = {"detector_1": detector("infra_1"), "adversary_1": liar}
    for rewrites in ((PUBLISH, ADVERSARY), (ADVERSARY, PUBLISH)):
        wire = next(wire for wire in resolve(*rewrites, **nodes).wires if wire.key == "agent/infra_1/detections")
        assert [leg.publisher.node for leg in wire.legs] == ["detector_1", "adversary_1"]


@pytest.mark.parametrize(
    ("rewrite", "nodes", "message"),
    [
        (PUBLISH, {"detector_1": detector("infra_1", "")}, r"publish 1: detector_1 has no output port 'detections'"),
        (PUBLISH, {f"detector_{i}": detector("ego") for i in (1, 2)}, "found detector_1, detector_2, expected one"),
        (PUBLISH, {"detector_1": detector("infra_7")}, r"no detector belongs to .*found detector_1 \(infra_7\)"),
        ({"publish": [{"wire": "agent/{agent}/detection", "role": "x", "output": "y"}]}, {}, "no wire .*did you mean"),
        ({"publish": [{"wire": "agent/{agent}/detections", "role": "agent", "output": "y"}]}, {}, "no output port 'y'"),
        ({"publish": [{"wire": "agent/{agent}/detections"}]}, {}, "missing keys 'output', 'role'"),
    ],
)
def test_a_publisher_that_cannot_be_is_refused(rewrite: Any, nodes: Any, message: str) -> None:
    with pytest.raises(WiringError, match=message):
        resolve(rewrite, **nodes)
