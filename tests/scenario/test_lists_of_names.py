"""A list of names means exactly its members: none, one or many."""

import json
from pathlib import Path
from typing import Any

import pytest
from equal_runs import assert_equal, run_alone

from mast_zenoh import scenario
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.errors import ConfigurationError
from mast_zenoh.run_folder.finding import Finding
from mast_zenoh.study import definition

EVERY = ["ego", "infra_1", "infra_2", "infra_3", "infra_4"]
LISTS = pytest.mark.parametrize("names", [[], ["infra_3"], ["infra_4", "infra_1"], EVERY], ids=len)


def idle(part: str, named: str) -> tuple[Finding, ...]:
    """What is said of a part that names no agent, node or host."""
    return (Finding("idle", (part,), f"no {named}"),)


def resolved(name: str, *settings: str, **options: Any) -> Resolved:
    return scenario.resolve(*scenario.load(name, settings), frames=3, **options)


def wires_of(run: Resolved, node: str) -> set[str]:
    """The wires that a node interposes."""
    return {wire["key"] for wire in run.wiring["wires"] if node in wire["interposers"]}


@LISTS
@pytest.mark.parametrize(("name", "port"), [("uncoordinated", "detections"), ("passthrough", "tracks")])
def test_an_adversary_is_on_the_wires_of_exactly_the_agents_of_its_list(name: str, port: str, names: list[str]) -> None:
    rewrites = f'keyexpr.rewrites=["on_{port}.toml"]'
    _, content = scenario.load(name)
    (first, *others) = content["adversaries"]
    run = resolved(name, rewrites, f"adversaries.{first}.agent={json.dumps(names)}")
    assert wires_of(run, first) == {f"agent/{agent}/{port}" for agent in names}
    for other in others:
        assert wires_of(run, other) == {f"agent/{content['adversaries'][other]['agent']}/{port}"}
    assert run.idle == idle(first, "agent") * (not names)


def test_an_adversary_of_a_list_of_one_sends_what_that_of_its_name_sends(tmp_path: Path) -> None:
    settings = ("uncoordinated", "n_adversaries=1", "attack_start_s=0.2")
    options = dict(frames=8, record=True)
    runs = [
        run_alone(tmp_path / str(k), *settings, f"adversaries.adversary_1.agent={agent}", **options)
        for k, agent in enumerate(("infra_3", '["infra_3"]'))
    ]
    assert_equal(*runs)
    assert json.loads((runs[1] / "metrics.json").read_text())["interposers"]["adversary_1"]["effects"]


def test_an_adversary_of_no_agent_changes_nothing(tmp_path: Path) -> None:
    options = dict(frames=8, record=True)
    none = run_alone(tmp_path / "none", "coordinated", "n_adversaries=1", "adversaries.adversary_1.agent=[]", **options)
    assert_equal(none, run_alone(tmp_path / "without", "coordinated", "n_adversaries=0", **options))


def test_an_adversary_that_does_not_say_whose_wires_it_is_on_is_refused() -> None:
    with pytest.raises(ConfigurationError, match=r"adversary_1\.agent.*none.*agent"):
        resolved("uncoordinated", "adversaries.adversary_1.agent=none")


@pytest.mark.parametrize("agents", [("n_infrastructure=1", "n_mobile=0"), ("n_infrastructure=0", "n_mobile=1")])
def test_peers_may_have_one_other_agent_that_lies(agents: tuple[str, ...]) -> None:
    run = resolved("peers", *agents, "n_adversaries=1", "on=heard")
    (other,) = [name for name, spec in run.nodes.items() if spec.role == "agent" and name != "ego"]
    assert wires_of(run, "adversary_1") == {f"agent/{other}/broadcast"}


@LISTS
def test_a_coordinator_directs_exactly_the_adversaries_of_its_list(names: list[str]) -> None:
    directed = [f"adversary_{k}" for k in range(1, 1 + len(names) % 3)]
    run = resolved("coordinated", "n_adversaries=2", f"coordinator.adversaries={directed}")
    assert list(run.nodes["coordinator"].config["adversaries"]) == directed


@pytest.mark.parametrize(
    ("name", "setting", "message"),
    [
        ("coordinated", 'coordinator.adversaries=["adversary_9"]', r"adversary.*called 'adversary_9'"),
        ("defended", 'command_center.pipeline.integrity.anchors=["infra_9"]', r"anchors.*called 'infra_9'"),
        ("defended", 'command_center.pipeline.integrity.anchors=["*"]', r"integrity.anchors.*called '\*'"),
        (
            "defended",
            'command_center.pipeline.integrity={"type": "FaultOrLie", "stage": '
            '{"type": "TruthDiscovery", "anchors": ["infra_1", "infra_22"]}}',
            r"integrity.stage.anchors.*'infra_22'.*'infra_2'",
        ),
    ],
)
def test_a_name_of_nobody_in_a_list_is_refused(name: str, setting: str, message: str) -> None:
    settings = ["defence=SequentialConsistency"] if name == "defended" else []
    with pytest.raises(ConfigurationError, match=message):
        resolved(name, *settings, setting)


def test_a_coordinator_does_not_direct_an_adversary_of_no_agent() -> None:
    run = resolved("coordinated", "n_adversaries=2", "adversaries.adversary_1.agent=[]")
    assert run.nodes["coordinator"].config["adversaries"] == ["adversary_2"]


@LISTS
@pytest.mark.parametrize("fault", ["Loss", "Pause", "Kill"])
def test_a_fault_strikes_exactly_the_nodes_of_its_list(fault: str, names: list[str]) -> None:
    own = {"Loss": {"probability": 0.5}, "Pause": {"until": 0.2}, "Kill": {}}[fault]
    run = resolved("baseline", f"faults={[dict(type=fault, at=0.1, nodes=names, **own)]}")
    struck = {step.node for step in run.steps} | {
        spec.config["agent"] for spec in run.nodes.values() if spec.role == "link"
    }
    assert struck == set(names)
    assert [set(band["nodes"]) for band in run.timeline] == [set(names)] * bool(names)
    assert run.idle == idle(f"faults[0] ({fault})", "node") * (not names)


@pytest.mark.parametrize("names", [[], ["a"], ["a", "b"]], ids=len)
def test_a_fault_of_hosts_strikes_exactly_those_of_its_list(names: list[str]) -> None:
    hosts = dict(a=dict(nodes=["infra_1"]), b=dict(nodes=["infra_2"]))
    path, content = scenario.load("baseline")
    content |= dict(hosts=hosts, faults=[dict(type="HostPartition", at=0.1, hosts=names)])
    run = scenario.resolve(path, content, frames=3, mode="realtime")
    assert [fault["hosts"] for fault in run.network["faults"]] == [names]
    assert run.idle == idle("faults[0] (HostPartition)", "host") * (not names)


@LISTS
def test_links_are_of_exactly_the_agents_that_are_named(names: list[str]) -> None:
    path, content = scenario.load("baseline")
    run = scenario.resolve(path, content | dict(links=dict.fromkeys(names, "wired")), frames=3)
    assert {spec.config["agent"] for spec in run.nodes.values() if spec.role == "link"} == set(names)


def test_a_study_of_no_defence_or_no_fusion_is_refused_instead_of_one_of_all() -> None:
    for study, empty in (("driving", "defences="), ("fusion", "fusions="), ("stone_soup", "trackers=")):
        with pytest.raises(ConfigurationError, match=r"must return.*dict"):
            definition.load(study, [empty])


@pytest.mark.parametrize("study", ["delay", "monte_carlo", "driving"])
def test_a_list_of_scenes_is_what_its_text_with_commas_is(study: str) -> None:
    scenes = ["intersection:5", "intersection:8"]
    listed, text = (
        definition.load_values(study, dict(scenes=scenes)),
        definition.load(study, [f"scenes={','.join(scenes)}"]),
    )
    assert [scene.label for scene in listed.scenes] == [scene.label for scene in text.scenes] == scenes
