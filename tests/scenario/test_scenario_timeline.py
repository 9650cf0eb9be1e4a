"""Faults, links and attacks on the timeline of a scenario, also by settings."""

import json
import logging
from pathlib import Path
from typing import Any

import pytest
from tiny_world import Run, tiny

from mast_zenoh import scenario
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.errors import ConfigurationError
from mast_zenoh.faults import ProcessStep
from mast_zenoh.scenario import load, load_values, resolve
from mast_zenoh.wiring.model import Wiring

TRACKER = dict(type="KalmanBoxTracker3D")
AGENT = dict(pipeline=dict(type="AgentPipeline", tracker=TRACKER, mission=dict(type="PictureFirst")))
CENTRE = dict(
    pipeline=dict(
        type="CommandCenterPipeline",
        clustering=dict(type="SampledAssignmentClusterer", assign_radius=2.0),
        group_tracking=dict(
            type="GroupTrackerWrapper", fusion=dict(type="CovarianceIntersectionFusion"), tracker=TRACKER
        ),
    )
)
ATTACKED = ("n_adversaries=1", "attack_start_s=0.2")


def world(name: str = "baseline", *settings: str, **keys: Any) -> Resolved:
    """A scenario in the tiny world, 12 frames, with additional keys."""
    return tiny(name, *settings, edit=lambda scenario: scenario.update(keys))


def links(resolved: Resolved) -> dict[str, dict[str, Any]]:
    return {name: dict(spec.config) for name, spec in resolved.nodes.items() if spec.role == "link"}


PARTITION = dict(type="Partition", at=0.3, until=0.6, nodes=["infra_1"])


# -- selection of links -----------------------------------------------------------------------------------------------


def test_a_scenario_without_links_and_faults_has_no_link_nodes() -> None:
    plain, empty = world(), world(links={}, faults=[], hosts={})
    assert plain.to_json() == empty.to_json()
    assert plain.wiring == empty.wiring
    assert links(plain) == {}
    assert (plain.steps, plain.timeline, plain.network) == ((), (), {})
    assert Run(plain).messages == Run(empty).messages


def test_only_the_target_of_a_fault_gets_a_link() -> None:
    scenario = world(faults=[PARTITION])
    cut = [dict(type="Cut", at=0.3, until=0.6)]
    assert links(scenario) == {"link_infra_1": dict(agent="infra_1", rules_up=cut, rules_down=cut)}
    wiring = Wiring.from_json(scenario.wiring)
    assert {wire.key for wire in wiring.wires if "link_infra_1" in wire.interposers} == {
        *("agent/infra_1/tracks", "agent/infra_1/status")
    }


def test_a_process_fault_needs_no_link() -> None:
    scenario = world(faults=[dict(type="Kill", at=0.3, node="infra_1", restart_after=0.2)])
    assert links(scenario) == {}
    assert scenario.steps == (ProcessStep(3, "kill", "infra_1"), ProcessStep(5, "start", "infra_1"))


def test_a_partition_keeps_an_agent_out_of_the_collation_until_it_is_healed() -> None:
    scenario = world(faults=[PARTITION], broker=dict(max_age_s=0.0))
    run = Run(scenario)
    assert not run.failures
    named = {m.header.frame: list(m.body["agents"]) for m in run.decoded("cc/collated", "collated")}
    assert [frame for frame, agents in sorted(named.items()) if "infra_1" not in agents] == [3, 4, 5]


def test_the_longest_matching_pattern_selects_the_links_of_an_agent() -> None:
    scenario = world(links={"*": dict(up=[dict(type="Delay", mean_s=0.1)]), "infra_*": "wired", "infra_2": "perfect"})
    rules = {config["agent"]: config for config in links(scenario).values()}
    assert [rule["type"] for rule in rules["ego"]["rules_up"]] == ["Delay"]
    assert rules["ego"]["rules_down"] == []
    assert [rule["type"] for rule in rules["infra_1"]["rules_down"]] == ["Bandwidth", "Delay", "Loss"]
    assert rules["infra_2"]["rules_up"] == []
    assert list(links(world(links={"infra_*": "wired", "mobile_*": "wireless_v2x"}))) == [
        "link_infra_1",
        "link_infra_2",
    ]


def test_faults_come_after_the_rules_of_a_profile_and_of_a_link() -> None:
    own = dict(type="perfect", up=[dict(type="Loss", probability=0.1)])
    scenario = world(links={"infra_1": own}, faults=[PARTITION])
    assert [rule["type"] for rule in links(scenario)["link_infra_1"]["rules_up"]] == ["Loss", "Cut"]
    assert [rule["type"] for rule in links(scenario)["link_infra_1"]["rules_down"]] == ["Cut"]


def test_radio_range_is_measured_from_static_agents() -> None:
    scenario = world(links={"ego": "wireless_v2x"})
    (limit,) = (rule for rule in links(scenario)["link_ego"]["rules_up"] if rule["type"] == "RangeLimit")
    assert len(limit["gateways"]) == 2
    assert all(gateway[2] == 15.0 for gateway in limit["gateways"]), "the poles"


def test_a_rewrite_named_by_the_scenario_keeps_its_position() -> None:
    def own(scenario: dict[str, Any]) -> None:
        scenario["faults"] = [PARTITION]
        scenario["keyexpr"]["rewrites"] = ["network.toml"]

    assert tiny(edit=own).wiring == world(faults=[PARTITION]).wiring
    scenario = world("coordinated", *ATTACKED, faults=[PARTITION])
    (tracks,) = (wire for wire in Wiring.from_json(scenario.wiring).wires if wire.key == "agent/infra_1/tracks")
    assert tracks.interposers == ("adversary_1", "link_infra_1"), "adversaries come before links"


# -- the timeline ----------------------------------------------------------------------------------------------------


def test_attacks_faults_and_links_are_on_one_timeline() -> None:
    kill = dict(type="Kill", at=0.7, node="infra_2", restart_after=0.2)
    scenario = world("uncoordinated", *ATTACKED, links={"infra_*": "wired"}, faults=[kill, PARTITION])
    entries = [(b["kind"], b["type"], b["at_s"], b["until_s"], b["nodes"], b["backend"]) for b in scenario.timeline]
    again = Resolved.from_json(json.loads(json.dumps(scenario.to_json())), scenario.wiring)
    assert (again.steps, again.timeline, again.network) == (scenario.steps, scenario.timeline, scenario.network)
    assert again.nodes["link_infra_1"].config == scenario.nodes["link_infra_1"].config
    assert entries == [
        ("link", "wired", 0.0, None, ["infra_1", "infra_2"], "links"),
        ("attack", "UncoordinatedAttack", 0.2, None, ["adversary_1"], "adversary"),
        ("fault", "Partition", 0.3, 0.6, ["infra_1"], "links"),
        ("fault", "Kill", 0.7, pytest.approx(0.9), ["infra_2"], "process"),
    ]


def test_adversaries_with_equal_starts_share_a_band_and_idle_ones_have_none() -> None:
    (band,) = world("uncoordinated", "n_adversaries=2", "attack_start_s=0.5").timeline
    assert band["nodes"] == ["adversary_1", "adversary_2"]
    (directed,) = world("coordinated", "n_adversaries=2", "attack_start_s=0.5").timeline
    assert directed["label"] == "CoordinatedAttack adversary_1, adversary_2"
    settings = ("n_adversaries=2", "attack_start_s=0.5", "attack=PairedDenial")
    (coordination,) = world("defended", *settings).timeline
    assert coordination["label"] == "PairedDenial adversary_1, adversary_2", "what their coordinator plans"
    assert world("passthrough").timeline == ()
    assert world("uncoordinated", "n_adversaries=1").timeline == (), "at 4 s the run is over"


def test_a_fault_after_the_end_is_reported(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING, "mast.scenario"):
        scenario = world(faults=[dict(PARTITION, at=5.0, until=6.0)])
    assert scenario.timeline == ()
    assert "faults[0]: begins after" in caplog.text


def test_hosts_are_part_of_the_resolved_scenario() -> None:
    def real(scenario: dict[str, Any]) -> None:
        scenario["hosts"] = dict(west=dict(nodes=["infra_*"]))
        scenario["faults"] = [dict(type="HostPartition", at=0.5, until=0.7, hosts=["west"]), PARTITION]
        scenario["run"]["mode"] = "realtime"

    resolved_scenario = tiny(edit=real)
    assert resolved_scenario.network["hosts"]["west"]["nodes"] == ["infra_1", "infra_2", "link_infra_1"]
    assert [band["backend"] for band in resolved_scenario.timeline] == ["links", "network"]


WEAK_SIGNAL = """
from dataclasses import dataclass

from mast_zenoh.faults import LinkFault


@dataclass(frozen=True, kw_only=True)
class WeakSignal(LinkFault):
    strength: float

    def as_rule(self):
        return [dict(type="Loss", probability=self.strength), dict(type="Delay", mean_s=0.2 * self.strength)]
"""


def test_a_user_defined_fault_is_named_like_a_shipped_one(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(
        f"{WEAK_SIGNAL}\n"
        "def scenario():\n"
        f"    return dict(scene=dict(type='TinyScene'), agents={{'*': {AGENT!r}}}, command_center={CENTRE!r},\n"
        "        evaluator=dict(scorer=dict(type='Scorer')),\n"
        "        faults=[dict(type='WeakSignal', at=0.2, until=0.4, nodes='majority', strength=0.5)])\n"
    )
    scenario = resolve(*load(str(tmp_path / "mine.py")), frames=6)
    rules = [config["rules_up"] for config in links(scenario).values()]
    times = dict(at=0.2, until=0.4)
    assert rules == [[dict(type="Loss", probability=0.5, **times), dict(type="Delay", mean_s=0.1, **times)]] * 2
    assert not Run(scenario).failures


# -- delivery order -----------------------------------------------------------------------------------------

EVERYTHING = [
    dict(type="Loss", at=0.1, until=0.6, nodes="agent", probability=0.3),
    dict(type="Delay", at=0.2, until=0.8, nodes=["ego"], mean_s=0.1, jitter_s=0.05),
    dict(type="Corrupt", at=0.1, until=0.9, node="infra_1", probability=0.4, flips=4),
    dict(type="Flood", at=0.4, until=0.6, node="broker", copies=2),
    dict(type="Pause", at=0.3, until=0.6, node="infra_2"),
    dict(type="Kill", at=0.7, node="infra_2", restart_after=0.2),
]


def test_delivery_order_does_not_change_the_effect_of_faults() -> None:
    scenario = world("uncoordinated", *ATTACKED, faults=EVERYTHING)
    plain = Run(scenario)
    for shuffle in range(2):
        shuffled = Run(scenario, shuffle=shuffle)
        assert shuffled.messages == plain.messages
        assert shuffled.packed == plain.packed


# -- refusals -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("keys", "reason"),
    [
        (dict(faults=dict(type="Partition")), r"faults.*list"),
        (dict(faults=["Partition"]), r"faults\[0\].*'Partition'.*dict\(type=…\)"),
        (dict(faults=[dict(type="Partion", at=1.0, node="ego")]), r"type: .*'Partion'; .*'Partition'"),
        (dict(faults=[dict(type="HostPartion", at=1.0)]), "mean 'HostPartition'"),
        (dict(faults=[dict(at=1.0, node="ego")]), r"faults\[0\]\.type.*known: BandwidthLimit"),
        (dict(faults=[dict(PARTITION, nodes=["infra_9"])]), r"faults\[0\]\.nodes.*node.*'infra_9'"),
        (dict(faults=[dict(PARTITION, untill=0.6)]), r"faults\[0\]\.untill.*mean 'until'"),
        (dict(faults=[dict(type="Loss", at=0.1, node="ego", probability=1.5)]), r"probability.*1.5, exp"),
        (
            dict(faults=[dict(type="Impair", at=0.1, node="ego", rule=dict(type="Los"))]),
            r"faults\[0\]\.rule\.type: no Rule",
        ),
        (dict(links={"infra_9": "wired"}), r"links.*'infra_9'.*'infra_"),
        (dict(links={"*": "wierd"}), r"links\['\*'\].*'wierd'.*'wired'"),
        (dict(links={"*": dict(upp=[])}), r"links\['\*'\]\.upp: unknown.*'up'"),
        (dict(links={"*": dict(up=[dict(type="Los")])}), r"links\['\*'\]\.up\[0\]\.type.*named 'Los'"),
        (dict(links={"*": dict(up="Loss")}), r"links\['\*'\]\.up.*'Loss'.*list"),
        (dict(links={"*": 3}), r"links\['\*'\].*3.*profile"),
        (dict(links="wired"), r"links.*'wired'.*dict"),
        (dict(hosts=[]), r"hosts.*dict"),
        (dict(fault=[]), r"fault: unknown.*'faults'"),
        (
            dict(
                faults=[dict(type="Kill", at=0.3, node="link_infra_1")],
                nodes=dict(link_infra_1=dict(role="link", agent="infra_1")),
                keyexpr=dict(rewrites=["network.toml"]),
            ),
            r"'link_infra_1'.*process fault",
        ),
        (dict(faults=[PARTITION], nodes=dict(link_infra_1=dict(role="link", agent="infra_1"))), "fra_1: another"),
    ],
)
def test_an_invalid_timeline_is_refused_with_its_path(keys: dict[str, Any], reason: str) -> None:
    with pytest.raises(ConfigurationError, match=reason) as caught:
        world(**keys)
    assert str(Path("scenarios") / "baseline.py") in str(caught.value)


CUT_OFF = {"type": "Partition", "at": 0.2, "until": None, "nodes": ["infra_1"]}


@pytest.mark.parametrize(
    "text",
    [
        '[{"type": "Partition", "at": 0.2, "until": null, "nodes": ["infra_1"]}]',
        str([CUT_OFF]),
    ],
    ids=["JSON", "Python"],
)
def test_a_setting_gives_a_scenario_without_faults_a_list_of_them(text: str) -> None:
    path, content = load("baseline", [f"faults={text}"])
    assert content["faults"] == [CUT_OFF]
    assert [band["label"] for band in scenario.resolve(path, content, frames=5).timeline] == ["Partition infra_1"]


def test_a_list_of_faults_is_a_parameter_in_python_too_and_its_items_are_set_or_added() -> None:
    def mine(faults: int = 2) -> dict[str, object]:
        return {"faults": [CUT_OFF] * faults}

    for base, value in (("baseline", [CUT_OFF]), ({"name": "mine"}, [CUT_OFF]), (mine, 1)):
        assert load_values(base, {"faults": value})[1]["faults"] == [CUT_OFF]
    for name, count in (("baseline", 0), ("attack_during_partition", 2)):
        _, content = load(name, [f"faults.{count}={CUT_OFF}"])
        assert len(content["faults"]) == count + 1, "the number after the last one adds one"
        assert content["faults"][-1] == CUT_OFF
    _, content = load("baseline", ["faults.0.at=0.4", f"faults=[{CUT_OFF}]"])
    assert content["faults"] == [CUT_OFF | {"at": 0.4}], "whatever the order of settings"


@pytest.mark.parametrize(
    ("setting", "reason"),
    [
        ('faults=[{"type": "Kill", "at": "soon", "node": "ego"}]', r"faults\[0\]\.at.*'soon'.*number"),
        ('faults=[{"type"', r"faults.*list.*dict"),
        ("fault=[]", r"--set fault.*'faults'"),
        ("faults.1={}", r"--set faults\.1.*'1'"),
        ("faults.0.at=1.0", r"--set faults\.0\.at.*'0'"),
    ],
)
def test_an_invalid_fault_is_refused_with_its_place_and_the_nearest_choice(setting: str, reason: str) -> None:
    with pytest.raises(ConfigurationError, match=reason):
        scenario.resolve(*load("baseline", [setting]), frames=5)
