"""A fault can be of any wire of a map, where it acts follows from the wiring, and of any rule of a link."""

from pathlib import Path
from typing import Any

import pytest
from tiny_world import Run, tiny

from mast_zenoh import scenario
from mast_zenoh.config import bundle
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.links import Rule
from mast_zenoh.wiring import maps
from mast_zenoh.wiring.model import Wiring

CUT = dict(type="Impair", rule=dict(type="Cut"), at=0.3, until=0.6)
RULE = dict(type="Cut", at=0.3, until=0.6)
CUT_FRAMES = {3, 4, 5}

SCOUT = """
import numpy as np

from mast_zenoh.messages import Column, Schema
from mast_zenoh.node import Node

WIND = Schema("wind_of_scouts", 1, "what scouts measure", (Column("speed", "float64", (1,), "m/s", "of the air"),))


class Scout(Node):
    role = "scout"
    inputs = {"clock": "clock", "tracks": "tracks"}
    outputs = {"findings": "tracks", "wind": WIND}

    def on_clock(self, received, context):
        context.publish("wind", {"speed": np.full(1, 3.0)})

    def on_tracks(self, received, context):
        context.publish("findings", received.body, frame=received.frame, time_ns=received.time_ns)
"""
ARCHIVE = """
from mast_zenoh.node import Node
from scout import WIND


class Archive(Node):
    role = "archive"
    inputs = {"findings": "tracks", "wind": WIND}

    def __init__(self):
        self.findings, self.winds = [], []

    def on_findings(self, received, context):
        self.findings.append(received.frame)

    def on_wind(self, received, context):
        self.winds.append(received.frame)
"""
LAB = [
    {"key": "lab/hall", "message": "tracks", "from": "scout.findings", "to": ["archive.findings"]},
    {"key": "lab/wind", "message": "wind_of_scouts", "from": "scout.wind", "to": ["archive.wind"]},
]


def world(*keys: str, name: str = "baseline", settings: tuple[str, ...] = (), **more: Any) -> Resolved:
    def edit(content: dict[str, Any]) -> None:
        content["faults"] = [CUT | dict(on=list(keys))]
        content |= more

    return tiny(name, *settings, edit=edit)


def links(resolved: Resolved) -> dict[str, list[str]]:
    """By link, the kinds of rules that it has."""
    specs = {name: spec.config for name, spec in resolved.nodes.items() if spec.role == "link"}
    return {name: [key for key, rules in config.items() if rules == [RULE]] for name, config in specs.items()}


@pytest.mark.parametrize(
    ("name", "key", "expected"),
    [
        ("baseline", "agent/infra_1/tracks", {"link_infra_1": ["rules_up"]}),
        ("baseline", "agent/infra_*/status", {"link_infra_1": ["rules_up"], "link_infra_2": ["rules_up"]}),
        ("baseline", "cc/picture", {"link_ego": ["rules_down"]}),
        ("baseline", "agent/ego/detections", {"link_ego": ["rules_sensor"]}),
        ("baseline", "cc/collated", {"link_cc_collated": ["rules_up"]}),
        ("peers", "agent/infra_1/broadcast", {"link_infra_1": ["rules_up"]}),
        ("peers", "agent/infra_1/tracks", {"link_agent_infra_1_tracks": ["rules_up"]}),
        ("two_centres", "cc/west/picture", {"link_cc_west_picture": ["rules_up"]}),
        ("two_centres", "agent/infra_2/tracks", {"link_infra_2": ["rules_up"]}),
    ],
)
def test_the_wiring_says_where_a_fault_of_a_wire_acts(name: str, key: str, expected: dict[str, list[str]]) -> None:
    assert links(world(key, name=name)) == expected


def test_a_link_of_a_wire_is_before_all_subscribers_of_this_wire_alone() -> None:
    wiring = Wiring.from_json(world("cc/collated", adversaries={}).wiring)
    assert {wire.key: wire.interposers for wire in wiring.wires if wire.interposers} == {
        "cc/collated": ("link_cc_collated",)
    }


def test_a_cut_wire_carries_nothing_while_the_fault_lasts() -> None:
    run = Run(world("cc/collated"))
    assert not run.failures
    carried = {message.header.frame for message in run.decoded("cc/collated", "collated")}
    assert {message.header.frame for message in run.decoded("cc/collated/@tap/0", "collated")} - carried == CUT_FRAMES
    for shuffle in range(2):
        assert Run(world("cc/collated"), shuffle=shuffle, encode=False).messages == run.messages


def lab(folder: Path, key: str) -> Resolved:
    """A world with two nodes and two wires that the package does not know."""
    (folder / "scout.py").write_text(SCOUT)
    (folder / "archive.py").write_text(ARCHIVE)
    nodes = {role: dict(role=role, file=str(folder / f"{role}.py")) for role in ("scout", "archive")}
    heard = {"agent/ego/tracks": "tracks", "clock": "clock"}
    listening = [{"wire": wire, "role": "scout", "input": port} for wire, port in heard.items()]
    return world(key, nodes=nodes, keyexpr=dict(rewrites=[{"wire": LAB, "listen": listening}]))


@pytest.mark.parametrize(("key", "port"), [("lab/hall", "findings"), ("lab/wind", "winds")])
def test_a_wire_of_a_map_of_ones_own_can_have_faults(tmp_path: Path, key: str, port: str) -> None:
    run = Run(lab(tmp_path, key))
    assert not run.failures
    assert set(range(12)) - set(getattr(run.nodes["archive"], port)) == CUT_FRAMES


def test_a_wire_of_a_map_on_which_agents_can_have_no_links_can_have_faults(tmp_path: Path) -> None:
    without_status = [
        entry
        for entry in maps.load(bundle.ROOT / "keyexpr_maps" / "testbed.toml")["wire"]
        if "status" not in entry["key"]
    ]
    run = Run(world("agent/infra_1/tracks", keyexpr=dict(map={"wire": without_status})))
    carried = {message.header.frame for message in run.decoded("agent/infra_1/tracks", "tracks")}
    assert set(range(12)) - carried == CUT_FRAMES


# -- rules of one's own, and several ones ------------------------------------------------------------------------------

OWN_RULE = """
from mast_zenoh.links import Rule
from mast_zenoh.scenario import load


class EveryNth(Rule):
    fate = "dropped"

    def __init__(self, n, at=0.0, until=None):
        super().__init__(at, until)
        self.n, self.count = n, 0

    def apply(self, passage, row):
        self.count += 1
        return () if self.count % self.n == 0 else (passage,)


def scenario():
    _, base = load("baseline")
    fault = dict(type="Impair", rule=dict(type="EveryNth", n=3), on="infra_1", at=0.5, until=2.0)
    return base | dict(faults=[fault])
"""


class OnlyFirst(Rule):
    """Drops all messages but the first that it sees."""

    fate = "dropped"
    seen = False

    def apply(self, passage, row):
        first, self.seen = not self.seen, True
        return (passage,) if first else ()


def received(run: Run, key: str) -> list[int]:
    """The frames of the messages that the broker gets on the wire of an agent's tracks."""
    (tap,) = (other for other in run.messages if other.startswith(f"{key}/@tap/broker"))
    return [message.header.frame for message in run.decoded(tap, "tracks")]


def test_a_rule_of_ones_own_acts_while_the_fault_lasts() -> None:
    def edit(content: dict) -> None:
        content["faults"] = [dict(type="Impair", rule=dict(type=OnlyFirst), on="infra_1", at=0.3, until=0.7)]

    run = Run(tiny(edit=edit))
    assert not run.failures
    sent = [message.header.frame for message in run.decoded("agent/infra_1/tracks", "tracks")]
    assert [frame for frame in sent if frame not in received(run, "agent/infra_1/tracks")] == [4, 5, 6]


def test_a_rule_of_a_users_file_reaches_every_process(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(OWN_RULE)
    path, content = scenario.load(str(tmp_path / "mine.py"))
    resolved = scenario.resolve(path, content, frames=30)
    assert str(tmp_path / "mine.py") in resolved.modules
    rule = dict(type="EveryNth", n=3, at=0.5, until=2.0)
    assert resolved.nodes["link_infra_1"].config == dict(agent="infra_1", rules_up=[rule], rules_down=[rule])


def test_rules_of_one_fault_act_in_order_on_messages_and_on_detections() -> None:
    blind = dict(type="BlindSector", azimuth_min_deg=-180.0, azimuth_max_deg=180.0)

    def edit(content: dict) -> None:
        content["faults"] = [dict(type="Impair", rule=[dict(type="Cut"), blind], on="infra_1", at=0.3, until=0.6)]

    run = Run(tiny(edit=edit))
    assert set(range(12)) - set(received(run, "agent/infra_1/tracks")) >= {3, 4, 5}
    detections = run.decoded("agent/infra_1/detections", "detections")
    assert [message.header.frame for message in detections if not len(message.body["position"])] == [3, 4, 5]
