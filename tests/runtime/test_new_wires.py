"""A new wire is one key-expression map: links, faults, adversaries and metrics act on it, whatever it carries."""

import json
import re
from functools import cache
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import pytest

import mast_zenoh as mast
from mast_zenoh.errors import WiringError
from mast_zenoh.runs.run import Run
from mast_zenoh.show.findings.adversaries import limits
from mast_zenoh.show.number_text import DASH
from mast_zenoh.show.tables.of_run import message_table
from mast_zenoh.show.tables.scores import score_table
from mast_zenoh.study.numbers import numbers

INTENTS = """
[[wire]]
key = "agent/{agent}/intents"
message = "tracks"
from = "agent.intents"
to = ["other peer.intents"]
estimate = "intents"
"""
INSERTS = """
[[insert]]
wire = "WIRE"
role = "adversary"

[[insert]]
wire = "WIRE"
role = "link"
"""
AGENT = '''
from agent import Agent


class IntentAgent(Agent):
    """Also says which objects it will watch."""

    outputs = {**Agent.outputs, "intents": "tracks"}

    def publish_tracks(self, perceived, tracks, context):
        super().publish_tracks(perceived, tracks, context)
        origin, rotation = self.pipeline.reference(perceived.pose)
        body = tracks.select(slice(0, 30)).columns() | {"origin": origin, "rotation": rotation}
        context.publish("intents", body, frame=perceived.frame, time_ns=perceived.time_ns)
'''
OF_TRACKS = """
from mast_zenoh import scenario as scenarios


def scenario(wires="fuse", more=()):
    _, content = scenarios.load("peers", ["n_infrastructure=2", "n_mobile=0"])
    content["agents"] = {"*": content["agents"]["*"] | dict(file="my_agent.py")}
    attack = dict(type="UncoordinatedAttack", start_s=0.5, selection=dict(
        type="UncoordinatedSelection", n_false_positives=4.0, exact_number=True, region="in_view"))
    return content | dict(
        name="intents",
        adversaries=dict(liar=dict(type="Adversary", agent="infra_1", attack=attack)),
        links={"infra_2": dict(up=[dict(type="Loss", probability=0.5)])},
        keyexpr=dict(map="testbed.toml", rewrites=["peers.toml", f"intents_{wires}.toml", *more]),
    )
"""
OF_OFFERS = '''
import numpy as np

from mast_zenoh import scenario as scenarios
from mast_zenoh.attacks import PassThrough
from mast_zenoh.messages import Column, Schema
from mast_zenoh.metrics import MessageMetric
from mast_zenoh.node import Node

OFFER = Schema("offer", 1, "what a shop asks", (Column("price", "float64", (1,), "EUR", "of all"),))


class Shop(Node):
    role = "shop"
    inputs = {"clock": "clock"}
    outputs = {"offer": OFFER}

    def on_clock(self, received, context):
        context.publish("offer", {"price": np.array([10.0])})


class Buyer(Node):
    role = "buyer"
    takes = ("offer",)
    message_types = {"offer": OFFER}

    def __init__(self):
        self.paid = []

    def on_offer(self, received, context):
        self.paid.append((received.frame, received.subject, float(received.body["price"][0])))

    def finish(self, context):
        return {"paid": self.paid}


class Cheat(PassThrough):
    """Doubles prices."""

    def forge(self, message, frame, time_ns, body):
        return {**body, "price": 2.0 * body["price"]} if message == "offer" else body


class Price(MessageMetric):
    """Price."""

    message = "offer"
    unit = "EUR"
    range = (0.0, float("inf"))

    def per_message(self, frame, subject, body):
        return body["price"][0] if subject == "north" else None


def scenario(fault=""):
    _, content = scenarios.load("baseline", ["n_infrastructure=1", "n_mobile=0"])
    if fault:
        content["faults"] = [dict(type="Partition", on=fault, at=0.5, until=1.0)]
    shops = {name: dict(role="shop", file="offers.py", type="Shop") for name in ("north", "south")}
    return content | dict(
        name="offers",
        nodes={
            **shops,
            "buyer": dict(role="buyer", file="offers.py", type="Buyer"),
            "cable": dict(role="link", rules_up=[dict(type="Loss", probability=0.5)]),
        },
        evaluator=dict(metrics=[dict(type="Price")]),
        adversaries=dict(cheat=dict(type="Adversary", agent="ego", attack=dict(type="Cheat"))),
        keyexpr=dict(
            map="testbed.toml",
            rewrites=["offers.toml", dict(listen=[dict(wire="clock", role="shop", input="clock")])],
        ),
    )
'''
OFFERS = """
[[wire]]
key = "shop/{shop}/offer"
message = "offer"
from = "shop.offer"
to = ["buyer.bid"]
"""


@cache
def folder() -> Path:
    """A user's folder."""
    made = Path(mkdtemp())
    inserts = INSERTS.replace("WIRE", "agent/{agent}/intents")
    files = {
        "my_agent.py": AGENT,
        "intents.py": OF_TRACKS,
        "intents_fuse.toml": f"{INTENTS}fuse = true\n{inserts}",
        "intents_hear.toml": f"{INTENTS}{inserts}",
        "offers.py": OF_OFFERS,
        "offers.toml": OFFERS + INSERTS.replace("WIRE", "shop/{shop}/offer"),
    }
    for name, text in files.items():
        (made / name).write_text(text)
    return made


@cache
def played(name: str, **parameters: Any) -> mast.Run:
    out = folder() / "_".join(["run", name, *map(str, parameters.values())]).replace("/", "_")
    return mast.run(str(folder() / name), frames=25, seed=1, out=str(out), record=True, runtime="inproc", **parameters)


def test_peers_fuse_a_further_wire_and_its_lies_are_blamed() -> None:
    run = played("intents.py", wires="fuse")
    assert run.summary["agents"]["ego"]["picture"]["fp_split"]["attack"] > 0.3
    assert run.summary["interposers"]["liar"]["wires"] == ["agent/infra_1/intents"]
    assert run.summary["interposers"]["liar"]["agreement"] == "agrees"


def test_a_link_acts_on_several_wires_of_one_type() -> None:
    run = played("intents.py", wires="fuse")
    rows = run.attacks.to_pylist()
    lost = {row["wire"] for row in rows if row["interposer"] == "link_infra_2" and row["effect"] == "dropped"}
    assert lost == {"agent/infra_2/broadcast", "agent/infra_2/intents"}
    assert run.summary["interposers"]["link_infra_2"]["agreement"] == "agrees"


def test_what_is_on_a_further_wire_is_an_estimate_with_all_metrics() -> None:
    intents = played("intents.py", wires="fuse").summary["agents"]["infra_2"]["intents"]
    assert intents["tp"]["mean"] > 0.0
    assert intents["fp_split"]["attack"] == 0.0, "it is scored as it was sent"


def test_peers_only_hear_a_wire_that_is_not_for_fusion_and_no_estimate_depends_on_it() -> None:
    run = played("intents.py", wires="hear")
    assert run.summary["agents"]["ego"]["picture"]["fp_split"]["attack"] == 0.0
    reasons = [(each.cause, each.where) for each in limits(run) if each.who == ("liar",)]
    assert reasons == [(("no estimate",), "agent/infra_1/intents")]
    counts = json.loads((run.path / "results" / "peer_ego" / "results.json").read_text())["radio"]
    assert counts["intents/infra_1"] == 25


def test_of_an_adversary_on_two_wires_the_report_says_on_which_no_estimate_depends() -> None:
    run = played("intents.py", wires="hear", more=("on_broadcast.toml",))
    told = [each for each in limits(run) if each.who == ("liar",)]
    assert [each.where for each in told if each.cause == ("no estimate",)] == ["agent/infra_1/intents"]
    assert {cause for each in run.findings if each.kind == "change" for cause in each.cause} >= {"liar"}


LOSSLESS = """
from mast_zenoh import scenario as scenarios


def scenario():
    _, content = scenarios.load("baseline", ["n_infrastructure=1", "n_mobile=0"])
    fault = dict(type="Loss", on="agent/infra_1/pose", probability=0.0, at=0.5, until=1.0)
    return content | dict(name="lossless", faults=[fault])
"""
ON_DETECTIONS = """
[[insert]]
wire = "agent/{agent}/detections"
role = "adversary"
"""


def test_lies_about_detections_are_blamed_for_errors_on_a_wire_that_a_subclass_adds() -> None:
    (folder() / "intents_sensor.toml").write_text(f"{INTENTS}fuse = true\n{ON_DETECTIONS}")
    intents = played("intents.py", wires="sensor").summary["agents"]["infra_1"]["intents"]
    assert intents["fp_split"]["attack"] > 1.0


def test_a_link_on_a_wire_whose_port_it_uses_itself_forwards_the_messages() -> None:
    (folder() / "lossless.py").write_text(LOSSLESS)
    run = played("lossless.py")
    assert run.summary["agents"]["infra_1"]["local"]["tp"]["mean"] > 5.0
    assert not run.attacks.num_rows


OF_OTHERS = """
from mast_zenoh import scenario as scenarios


def scenario():
    _, content = scenarios.load("peers", ["n_infrastructure=2", "n_mobile=0"])
    faults = [dict(type="Loss", on="scene/truth", probability=0.0, at=1.0)]
    faults += [dict(type="Partition", on="agent/infra_1/status", at=1.0)]
    lossy = dict(up=[dict(type="Loss", probability=0.7)])
    return content | dict(name="of_others", faults=faults, links={"infra_2": lossy})
"""


def test_errors_are_due_to_the_link_that_acted_not_to_faults_on_wires_that_nothing_depends_on() -> None:
    (folder() / "of_others.py").write_text(OF_OTHERS)
    run = played("of_others.py")
    causes = {cause for each in run.findings if each.kind == "change" for cause in each.cause}
    assert causes == {"link_infra_2"}
    assert [each.who for each in limits(run) if each.cause == ("no estimate",)] == [("link_agent_infra_1_status",)]
    idle = [(*each.who, each.what, each.when and each.when[0]) for each in run.findings if each.kind == "idle"]
    assert idle == [("Loss scene/truth", "fault", 1.0)]


def test_a_fault_of_a_wire_that_is_no_agents_acts_on_it_alone_though_a_map_puts_links_there() -> None:
    run = played("offers.py", fault="shop/north/offer")
    assert not {name for name, node in run.record["nodes"].items() if name in ("link_ego", "link_infra_1")}
    rows = [row for row in run.attacks.to_pylist() if row["interposer"].startswith("link_")]
    assert {(row["interposer"], row["wire"], row["effect"]) for row in rows} == {
        ("link_shop_north_offer", "shop/north/offer", "dropped")
    }
    assert all(0.5 <= row["frame"] * 0.1 < 1.0 for row in rows)


EVERY_WIRE = """
from mast_zenoh import scenario as scenarios


def scenario(on="agent/ego/pose"):
    _, content = scenarios.load("peers", ["n_infrastructure=1", "n_mobile=1", "gossip=true"])
    fault = dict(type="Impair", rule=dict(type="Loss", probability=0.5), on=on, at=0.2)
    return content | dict(name="lossy", faults=[fault])
"""


@pytest.mark.parametrize("key", ["scene/truth", "agent/infra_1/gossip"])
def test_a_fault_of_any_wire_is_measured_reported_and_checked(key: str) -> None:
    (folder() / "every_wire.py").write_text(EVERY_WIRE)
    run = played("every_wire.py", on=key)
    assert {row["effect"] for row in run.attacks.to_pylist() if row["wire"] == key} == {"dropped"}
    checks = json.loads((run.path / "checks.json").read_text())["checks"]
    assert all(each["ok"] for each in checks if each["name"] == "sequences"), checks


#: By what is wrong: what replaces it in the entry, and what the error says.
WRONG = {
    "role in the key": ("{agent}/intents", "{agnet}/intents", "no role 'agnet'; did you mean 'agent'?"),
    "input port": ("other peer.intents", "other agent.mission", "has no input port 'mission'"),
    "two ports": ('["other peer.intents"]', '["other peer.intents", "other peer.spare"]', "on 'intents', 'spare'"),
    "estimate of another wire": ('= "intents"', '= "local"', "'local' is already that of 'agent/"),
    "estimate on arrival": ('= "intents"', '= "received"', "'received' is measured where messages arrive"),
    "estimate of poses": ('message = "tracks"', 'message = "pose"', "messages of type 'pose', expected objects"),
    "wire of the same sender": ("estimate =", 'of = "agent/{agent}/track"\nestimate =', "did you mean 'agent/"),
    "clock": ('message = "tracks"', 'message = "clock"', "expected the simulator: a run has one clock"),
    "kind of fuse": ("estimate =", 'fuse = "yes"\nestimate =', "fuse: found 'yes', expected true or false"),
    "brackets": ("[[wire]]", "[wire]", "expected [[wire]] with two brackets"),
}


@pytest.mark.parametrize("what", WRONG)
def test_a_wrong_wire_is_refused_with_its_place(what: str) -> None:
    right, wrong, message = WRONG[what]
    assert right in INTENTS
    name = what.replace(" ", "_")
    (folder() / f"intents_{name}.toml").write_text(INTENTS.replace(right, wrong))
    with pytest.raises(WiringError, match=re.escape(message)) as refused:
        played("intents.py", wires=name)
    assert "intents" in str(refused.value)


@pytest.mark.parametrize(
    ("insert", "message"),
    [
        ('role = "link"\ninput = "intents"\noutput = "elsewhere"', "expected 'intents_out'"),
        ('role = "link"\ninput = "pose"', "carries 'pose' messages"),
        ('role = "peer"', "input port 'intents'"),
    ],
)
def test_a_node_is_only_inserted_where_it_sends_messages_on(insert: str, message: str) -> None:
    entry = f'[[insert]]\nwire = "agent/{{agent}}/intents"\n{insert}\n'
    name = f"insert_{abs(hash(insert))}"
    (folder() / f"intents_{name}.toml").write_text(f"{INTENTS}{entry}")
    with pytest.raises(WiringError, match=re.escape(message)):
        played("intents.py", wires=name)


def test_links_adversaries_and_metrics_act_on_a_message_type_of_the_users_own() -> None:
    run = played("offers.py")
    effects = run.summary["interposers"]
    assert effects["cheat"]["effects"] == {"reframed": 50}
    assert 0 < effects["cable"]["effects"]["dropped"] < 50
    assert {each["agreement"] for each in effects.values()} == {"agrees"}
    assert effects["cable"]["wires"] == ["shop/north/offer", "shop/south/offer"]
    assert run.summary["messages"]["shop/north/offer"]["price"] == {"mean": 10.0, "std": 0.0}, "as it was sent"
    assert run.summary["messages"]["shop/south/offer"]["price"] == {"mean": None, "std": None}


def test_of_changes_on_which_no_estimate_depends_the_report_says_just_that() -> None:
    findings = {each.kind: each for each in played("offers.py").findings}
    assert findings["limited"].cause == ("no estimate",)
    assert not {"unattributed", "during"} & findings.keys()


def test_estimates_and_metrics_of_ones_own_are_in_the_tables_with_their_units() -> None:
    run = played("offers.py")
    described = {"per": "message", "heading": "", "unit": "EUR", "digits": 2, "whole": False, "range": [0.0, None]}
    assert run.summary["own_metrics"] == {"price": described}
    lines = message_table(Run(run.path)).lines
    assert lines == [
        ("shop/north/offer", "price (EUR)", "10.00", "0.00"),
        ("shop/south/offer", "price (EUR)", DASH, DASH),
    ]
    of_study = [each[:4] for each in numbers(run.summary) if each.metric == "price"]
    assert ("shop/north/offer", "messages", "price", 10.0) in of_study
    run = played("intents.py", wires="fuse")
    summary, table = run.summary, score_table({"run": run})
    assert table.estimates[-1] == "intents"
    assert table.score("tp", "run", "intents").mean == summary["agents"]["ego"]["intents"]["tp"]["mean"]
