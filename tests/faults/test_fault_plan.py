"""Faults become link rules, process steps and timeline bands, or are refused."""

import copy
import inspect
import pickle
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from link_rules import RULES

from mast_zenoh import links
from mast_zenoh.config import registry
from mast_zenoh.errors import ConfigurationError
from mast_zenoh.faults import Fault, FaultPlan, Loss, ProcessStep, plan
from mast_zenoh.faults.plan import draw_agents, frame_at

AGENTS = ("ego", "infra_1", "infra_2", "infra_3", "infra_4")
ROLES = {
    "simulator": "simulator",
    **dict.fromkeys(AGENTS, "agent"),
    "broker": "broker",
    "command_center": "command_center",
    "adversary_1": "adversary",
    "coordinator": "coordinator",
    "evaluator": "evaluator",
    "recorder": "recorder",
}
KINDS = {name: cls for name, cls in registry.known_types(Fault).items() if cls.__module__.startswith("mast_zenoh.")}
TIMES_NS = np.arange(100) * 100_000_000  # 10 s
#: Where faults of wires act, as `Carriers`.
CARRIERS = {
    **{f"agent/{name}/{port}": [(name, "up")] for name in AGENTS for port in ("tracks", "status")},
    **{f"agent/{name}/detections": [(name, "sensor")] for name in AGENTS},
    "agent/ego/detections/radar": [("ego", "sensor/radar")],
    "cc/picture": [("ego", "down"), ("infra_2", "down")],
    "cc/collated": [("cc/collated", "up")],
    "agent/ego/mission": [("agent/ego/mission", "up")],
    "alarm": [("alarm", "up")],
}


def planned(*specs: dict[str, Any], seed: int = 0, lockstep: bool = True, times_ns: np.ndarray = TIMES_NS) -> FaultPlan:
    faults = [(f"mine.py: faults[{i}]", registry.build(s, Fault, f"mine.py: faults[{i}]")) for i, s in enumerate(specs)]
    return plan(faults, ROLES, times_ns, seed, lockstep=lockstep, carriers=lambda: CARRIERS)


# -- times -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("at_s", "frame"), [(0.0, 0), (0.001, 1), (0.1, 1), (0.30000000000000004, 3), (9.9, 99)])
def test_a_step_happens_before_the_first_frame_at_or_after_its_time(at_s: float, frame: int) -> None:
    assert frame_at(TIMES_NS, at_s) == frame


def test_frames_need_not_be_evenly_spaced() -> None:
    times_ns = np.array([0, 100, 150, 400]) * 1_000_000
    assert [frame_at(times_ns, at_s) for at_s in (0.1, 0.12, 0.2, 0.5)] == [1, 2, 3, 4]


# -- links -----------------------------------------------------------------------------------------------------------


def test_a_partition_cuts_both_directions_from_start_to_end() -> None:
    nodes = ["infra_1", "infra_2"]
    fault_plan = planned(dict(type="Partition", at=3.0, until=6.0, nodes=nodes))
    cut = [dict(type="Cut", at=3.0, until=6.0)]
    assert fault_plan.rules == {name: {"up": cut, "down": cut} for name in nodes}
    assert fault_plan.steps == ()
    (band,) = fault_plan.bands
    shown = dict(label="Partition infra_1, infra_2", kind="fault", type="Partition", backend="links", nodes=nodes)
    assert band == shown | dict(at_s=3.0, until_s=6.0)


def test_rules_keep_the_order_of_the_faults() -> None:
    loss = dict(type="Loss", at=5.0, until=6.0, node="infra_1", probability=0.5)
    fault_plan = planned(loss, dict(type="Partition", at=1.0, until=6.0, node="infra_1"))
    assert [rule["type"] for rule in fault_plan.rules["infra_1"]["up"]] == ["Loss", "Cut"]


@pytest.mark.parametrize(
    ("fault", "defaults", "rule_type"),
    [
        (dict(type="Loss", probability=0.25), {}, "Loss"),
        (dict(type="BurstLoss", good_to_bad=0.1, bad_to_good=0.5), dict(loss_good=0.0, loss_bad=1.0), "GilbertElliott"),
        (dict(type="Delay", mean_s=0.2), dict(jitter_s=0.0), "Delay"),
        (dict(type="BandwidthLimit", bits_per_s=1e6), dict(queue_s=0.5), "Bandwidth"),
        (dict(type="Corrupt", probability=0.5, flips=3), {}, "Corrupt"),
        (dict(type="Flood", copies=7), {}, "Flood"),
        (dict(type="Duplicate", probability=1.0), dict(copies=1), "Duplicate"),
        (dict(type="Reorder", probability=0.5), dict(by_s=0.1), "Reorder"),
    ],
)
def test_every_message_fault_is_a_known_link_rule(fault: dict[str, Any], defaults: dict, rule_type: str) -> None:
    rules = planned({**fault, "at": 1.0, "until": 2.0, "node": "ego"}).rules["ego"]["up"]
    assert rules == [fault | defaults | {"type": rule_type, "at": 1.0, "until": 2.0}]
    assert isinstance(registry.build(rules[0], links.Rule, "here"), links.Rule)


@pytest.mark.parametrize("name", RULES)
def test_every_rule_of_a_link_can_be_a_fault_with_all_its_parameters(name: str) -> None:
    rule = dict(type=name, **{key: value for key, value in RULES[name].items() if key not in ("at", "until")})
    rules = planned(dict(type="Impair", rule=rule, on="ego", at=1.0, until=2.0)).rules
    timed = [rule | dict(at=1.0, until=2.0)]
    of_sensor = rule["type"] in ("BlindSector", "GhostDetections")
    assert rules == {"ego": dict(up=[], down=[], sensor=timed) if of_sensor else dict(up=timed, down=timed)}


def test_several_rules_of_one_fault_have_the_same_targets_and_one_band() -> None:
    delay, blind = dict(type="Delay", mean_s=0.2), dict(type="BlindSector", azimuth_min_deg=0.0, azimuth_max_deg=30.0)
    fault = dict(type="Impair", rule=[delay, blind, dict(type="Cut")], on="minority", at=1.0, direction="up")
    for seed in range(5):
        fault_plan = planned(fault, seed=seed)
        (first, second) = fault_plan.rules
        for rules in fault_plan.rules.values():
            assert [rule["type"] for rule in rules["up"]] == ["Delay", "Cut"]
            assert ([rule["type"] for rule in rules["sensor"]], rules["down"]) == (["BlindSector"], [])
        assert [band["nodes"] for band in fault_plan.bands] == [[first, second]]
        assert fault_plan.of_agents == {name: [("Delay, BlindSector, Cut", 1.0, None)] for name in (first, second)}


@pytest.mark.parametrize(
    "aim", [dict(node="infra_1"), dict(nodes=["infra_1"]), dict(on="infra_1"), dict(on=["infra_1"])]
)
def test_the_targets_have_three_names(aim: dict[str, Any]) -> None:
    assert cut(**aim) == ["infra_1"]


def test_named_faults_can_be_made_in_python() -> None:
    fault = Loss(node="ego", at=1.0, probability=0.25)
    assert fault == Loss(node="ego", at=1.0, probability=0.25, direction="both")
    assert pickle.loads(pickle.dumps(fault)) == copy.deepcopy(fault) == fault
    assert repr(fault).startswith("Loss(at=1.0, ")
    with pytest.raises(TypeError, match="probability"):
        Loss(node="ego", at=1.0)


def test_a_directed_fault_acts_in_one_direction() -> None:
    fault_plan = planned(dict(type="Loss", at=1.0, node="ego", probability=0.5, direction="down"))
    assert fault_plan.rules["ego"] == {"up": [], "down": [dict(type="Loss", probability=0.5, at=1.0, until=None)]}


def test_a_slow_node_delays_its_published_messages() -> None:
    slow = dict(type="SlowNode", at=1.0, until=2.0, delay_s=0.3)
    agent = planned({**slow, "node": "infra_1"}).rules
    assert list(agent) == ["infra_1"]
    assert (len(agent["infra_1"]["up"]), len(agent["infra_1"]["down"])) == (1, 0)
    centre = planned({**slow, "node": "command_center"}).rules
    assert list(centre) == list(AGENTS)
    assert all((len(rules["up"]), len(rules["down"])) == (0, 1) for rules in centre.values())


# -- targets ---------------------------------------------------------------------------------------------------------


def cut(seed: int = 0, **aim: Any) -> list[str]:
    return list(planned(dict(type="Partition", at=1.0, until=2.0, **aim), seed=seed).rules)


def test_targets_are_names_and_roles() -> None:
    assert cut(nodes=["infra_2", "ego", "infra_2"]) == ["ego", "infra_2"], "in the order of the scene, once"
    assert cut(nodes="agent") == list(AGENTS)
    assert cut(node="broker") == cut(node="command_center") == list(AGENTS), "the agents cut off from the centre"


def test_random_targets_are_drawn_by_the_seed_of_the_run() -> None:
    assert [len(cut(nodes=word)) for word in ("one", "minority", "majority")] == [1, 2, 3]
    assert cut(nodes="minority", seed=4) == cut(nodes="minority", seed=4)
    assert len({tuple(cut(nodes="minority", seed=seed)) for seed in range(20)}) > 5
    two = planned(*[dict(type="Partition", at=1.0, until=2.0, nodes="one")] * 8)
    assert len({tuple(band["nodes"]) for band in two.bands}) > 1, "every fault draws its targets independently"


@pytest.mark.parametrize("n", range(1, 9))
def test_a_majority_is_more_than_half_of_the_agents_and_a_minority_less(n: int) -> None:
    agents = [f"a{i}" for i in range(n)]
    rng = np.random.default_rng(0)
    assert len(draw_agents("one", agents, rng)) == 1
    assert len(draw_agents("majority", agents, rng)) > n / 2
    minority = len(draw_agents("minority", agents, rng))
    assert minority == 1 or minority < n / 2


def test_a_key_of_a_wire_selects_one_direction() -> None:
    up = planned(dict(type="Partition", at=1.0, until=2.0, nodes="agent/infra_1/tracks")).rules
    assert list(up) == ["infra_1"]
    assert [len(up["infra_1"][way]) for way in ("up", "down")] == [1, 0]
    down = planned(dict(type="Partition", at=1.0, until=2.0, nodes=["cc/picture"])).rules
    assert list(down) == ["ego", "infra_2"], "those that receive it"
    assert [len(down["ego"][way]) for way in ("up", "down")] == [0, 1]
    assert cut(nodes="agent/infra_*/tracks") == ["infra_1", "infra_2", "infra_3", "infra_4"]


def test_a_glob_means_wires_of_links_if_it_matches_any() -> None:
    assert cut(on="agent/ego/*") == ["ego"]
    assert cut(on="cc/*") == ["ego", "infra_2"]
    assert cut(on="agent/*/mission") == ["agent/ego/mission"]


@pytest.mark.parametrize("key", ["cc/collated", "agent/ego/mission", "alarm"])
def test_a_wire_without_a_link_gets_one_for_its_faults(key: str) -> None:
    fault_plan = planned(dict(type="Loss", on=key, at=1.0, probability=0.5), dict(type="Partition", on=key, at=2.0))
    assert [rule["type"] for rule in fault_plan.rules[key]["up"]] == ["Loss", "Cut"]
    assert [band["nodes"] for band in fault_plan.bands] == [[key]] * 2
    assert (list(fault_plan.rules), fault_plan.of_agents) == ([key], {})


def test_any_fault_of_messages_can_be_one_of_detections() -> None:
    fault_plan = planned(dict(type="Loss", on=["agent/ego/detections*", "infra_1"], at=1.0, probability=0.5))
    loss = [dict(type="Loss", probability=0.5, at=1.0, until=None)]
    assert fault_plan.rules["ego"] == {"up": [], "down": [], "sensor": loss, "sensor/radar": loss}
    assert fault_plan.rules["infra_1"] == {"up": loss, "down": loss}
    assert list(fault_plan.of_agents) == ["ego", "infra_1"]


# -- processes -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("fault", "steps", "band"),
    [
        (dict(type="Kill", at=1.0), [(10, "kill")], (1.0, None)),
        (dict(type="Kill", at=4.0, restart_after=2.0), [(40, "kill"), (60, "start")], (4.0, 6.0)),
        (dict(type="Kill", at=9.5, restart_after=2.0), [(95, "kill")], (9.5, None)),
        (dict(type="Leave", at=1.0), [(10, "leave")], (1.0, None)),
        (dict(type="Leave", at=1.0, return_after=1.0), [(10, "leave"), (20, "start")], (1.0, 2.0)),
        (dict(type="Restart", at=1.0), [(10, "leave"), (15, "start")], (1.0, 1.5)),
        (dict(type="Restart", at=1.0, down_s=0.001), [(10, "leave"), (11, "start")], (1.0, 1.001)),
        (dict(type="Restart", at=0.91, down_s=0.01), [(10, "leave"), (11, "start")], (0.91, 0.92)),
        (dict(type="Join", at=2.0), [(20, "start")], (0.0, 2.0)),
        (dict(type="Pause", at=2.0, until=3.0), [(20, "pause"), (30, "resume")], (2.0, 3.0)),
        (dict(type="Pause", at=9.0, until=12.0), [(90, "pause"), (99, "resume")], (9.0, None)),
        (dict(type="Unplug", at=2.0, until=3.0), [(20, "disconnect"), (30, "connect")], (2.0, 3.0)),
        (dict(type="Unplug", at=2.0, until=12.0), [(20, "disconnect"), (99, "connect")], (2.0, None)),
        (dict(type="Unplug", at=9.9, until=12.0), [], (9.9, None)),
    ],
)
def test_every_process_fault_becomes_steps_within_the_run(fault, steps, band) -> None:
    fault_plan = planned({**fault, "node": "infra_1"}, lockstep=False)
    assert fault_plan.steps == tuple(ProcessStep(frame, action, "infra_1") for frame, action in steps)
    assert fault_plan.rules == {}
    (shown,) = fault_plan.bands
    assert (shown["at_s"], shown["until_s"]) == pytest.approx(band)
    assert (shown["kind"], shown["type"], shown["backend"]) == ("fault", fault["type"], "process")
    assert shown["nodes"] == ["infra_1"]


@pytest.mark.parametrize("node", ["broker", "command_center", "adversary_1", "coordinator"])
def test_nodes_other_than_agents_can_be_killed_and_restarted(node: str) -> None:
    fault_plan = planned(dict(type="Kill", at=1.0, node=node, restart_after=1.0))
    assert [step.node for step in fault_plan.steps] == [node, node]


def test_a_partition_that_outlasts_the_run_has_no_end() -> None:
    assert planned(dict(type="Partition", at=9.0, until=20.0, node="infra_2")).bands[0]["until_s"] is None


def test_faults_after_the_last_frame_have_no_effect() -> None:
    partition = dict(type="Partition", at=30.0, until=40.0, node="infra_2")
    fault_plan = planned(dict(type="Kill", at=9.95, node="infra_1"), partition)
    assert (fault_plan.steps, fault_plan.bands) == ((), [])
    assert fault_plan.missed == ["mine.py: faults[0]", "mine.py: faults[1]"]


def test_steps_are_in_the_order_of_frames() -> None:
    kill = dict(type="Kill", at=4.0, node="infra_3", restart_after=2.0)
    assert [step.frame for step in planned(kill, dict(type="Restart", at=1.0, node="ego")).steps] == [10, 15, 40, 60]


def test_a_pause_in_lock_step_holds_the_messages_of_every_link_of_its_node() -> None:
    pause = dict(type="Pause", at=2.0, until=3.0)
    hold = [dict(type="Hold", at=2.0, until=3.0)]
    for node, agents in (("infra_1", ["infra_1"]), ("command_center", AGENTS)):
        fault_plan = planned({**pause, "node": node})
        assert fault_plan.steps == ()
        assert fault_plan.rules == {name: {"up": hold, "down": hold} for name in agents}
        (band,) = fault_plan.bands
        assert (band["backend"], band["nodes"]) == ("links", [node])


def test_faults_of_what_an_agent_sends_are_listed_by_agent() -> None:
    fault_plan = planned(
        dict(type="Loss", at=1.0, until=2.0, node="infra_1", probability=0.5),
        dict(type="Delay", at=1.0, node="infra_2", mean_s=0.2, direction="down"),
        dict(type="Impair", at=3.0, node="infra_1", rule=dict(type="PoseError", yaw_std_rad=0.1)),
        dict(type="Kill", at=4.0, node="infra_3", restart_after=2.0),
        dict(type="Kill", at=4.0, node="broker", restart_after=2.0),
        dict(type="Loss", at=30.0, node="infra_4", probability=0.5),
    )
    of_1 = [("Loss", 1.0, 2.0), ("PoseError", 3.0, None)]
    assert fault_plan.of_agents == {"infra_1": of_1, "infra_3": [("Kill", 4.0, 6.0)]}


# -- refusals --------------------------------------------------------------------------------------------------------

BLIND = dict(type="BlindSector", at=0.3, until=0.8, azimuth_min_deg=-180.0, azimuth_max_deg=180.0)


@pytest.mark.parametrize(
    ("fault", "reason"),
    [
        (dict(type="Partition", at=1.0, nodes=["infra_9"]), r"faults\[0\]\.nodes.*node.*'infra_9'"),
        (dict(type="Unplug", at=2.0, until=3.0, node="ego"), r"Unplug.*lock-step.*Partition"),
        (dict(type="Kill", at=1.0, node="agnet"), r"faults\[0\]\.node.*mean 'agent'"),
        (dict(type="Partition", at=1.0, nodes="majorty"), "mean 'majority'"),
        (dict(type="Partition", at=1.0, nodes="agent/infra_1/trcks"), "mean 'agent/infra_1/tracks'"),
        (dict(type="Partition", at=6.0, until=3.0, node="ego"), r"until.*3.0.*\(6.0\)"),
        (dict(type="Partition", at=3.0, until=3.0, node="ego"), "until: found 3.0"),
        (dict(type="Partition", at=-1.0, node="ego"), r"at.*-1.0.*time"),
        (dict(type="Partition", at=float("nan"), node="ego"), "at: found nan"),
        (dict(type="Pause", at=3.0, until=2.0, node="ego"), "until: found 2.0"),
        (dict(type="Pause", at=3.0, node="ego"), "Pause needs until"),
        (dict(type="Partition", at=1.0), r"`node`.*`nodes`"),
        (dict(type="Partition", at=1.0, node="ego", nodes=["ego"]), r"`node`.*`nodes`"),
        (dict(type="Partition", at=1.0, node="ego", on="ego"), r"`node`.*`nodes`"),
        (dict(type="Partition", at=1.0, on="infra_9"), r"faults\[0\]\.on.*node.*'infra_9'"),
        (dict(type="Impair", at=1.0, on="ego", rule=[]), r"rule.*empty list"),
        (dict(type="Impair", at=1.0, on="ego", rule="Loss"), r"rule.*'Loss'.*dict"),
        (
            dict(type="Impair", at=1.0, on="ego", rule=[dict(type="Cut"), dict(type="Los")]),
            r"rule\[1\]\.type: .*'Loss'",
        ),
        (dict(type="Kill", at=1.0, node="ego", restart_after=0.0), r"restart_after.*0.0.*0"),
        (dict(type="Kill", at=1.0, node="ego", until=2.0), r"until: Kill.*parameter"),
        (dict(type="Kill", at=0.0, node="ego"), r"at.*0.0.*after"),
        (dict(type="Loss", at=1.0, node="ego"), "Loss needs probability"),
        (dict(type="Loss", at=1.0, node="ego", probability=0.1, direction="upp"), "mean 'up'"),
        (dict(type="Kill", at=1.0, node="simulator"), r"'simulator'.*drives.*scene"),
        (dict(type="Kill", at=1.0, node="evaluator"), r"measures.*run"),
        (dict(type="Leave", at=1.0, node="recorder"), r"records.*run"),
        (dict(type="Partition", at=1.0, node="adversary_1"), r"'adversary_1' \(adversary\).*link"),
        (dict(type="Pause", at=1.0, until=2.0, node="coordinator"), r"no link.*own"),
        (BLIND | dict(node="broker"), r"'broker' \(broker\).*sensor"),
        (BLIND | dict(node="adversary_1"), r"'adversary_1' \(adversary\).*link"),
        (BLIND | dict(node="agent/ego/tracks"), "mean 'agent/ego/detections'"),
    ],
)
def test_an_invalid_fault_is_refused_with_its_location(fault: dict[str, Any], reason: str) -> None:
    with pytest.raises(ConfigurationError, match=reason) as caught:
        planned(fault)
    assert str(caught.value).startswith("mine.py: faults[0]")


KILL = dict(type="Kill", at=2.0, node="ego", restart_after=2.0)


@pytest.mark.parametrize(
    ("other", "reason"),
    [
        (dict(type="Kill", at=3.0, node="ego"), r"faults\[1\]: kill.*down.*\[0\]"),
        (dict(type="Leave", at=3.0, node="ego"), r"leave of 'ego'.*down"),
        (dict(type="Pause", at=3.0, until=5.0, node="ego"), r"pause of 'ego'.*down"),
        (dict(type="Join", at=3.0, node="ego"), r"start of 'ego'.*up"),
        (dict(type="Pause", at=1.0, until=3.0, node="ego"), r"faults\[0\].*'ego'.*paused"),
        (dict(type="Join", at=2.5, node="ego"), "(kill|start) of 'ego'"),
        (dict(type="Kill", at=4.0, node="ego"), r"another action.*same"),
        (dict(type="Kill", at=20.0, node="ego", restart_after=1.0), None),
        (dict(type="Kill", at=3.0, node="infra_1"), None),
        (dict(type="Partition", at=3.0, until=4.0, node="ego"), None),
    ],
)
@pytest.mark.parametrize("lockstep", [True, False])
def test_impossible_actions_on_processes_are_refused(other: dict[str, Any], reason: str | None, lockstep: bool) -> None:
    if reason is None:
        planned(KILL, other, lockstep=lockstep)
        return
    with pytest.raises(ConfigurationError, match=reason):
        planned(KILL, other, lockstep=lockstep)


def test_a_disconnected_node_cannot_be_killed_or_paused() -> None:
    unplug = dict(type="Unplug", at=2.0, until=3.0, node="infra_1")
    for other in (dict(type="Kill", at=2.5, node="infra_1"), dict(type="Pause", at=2.5, until=4.0, node="infra_1")):
        with pytest.raises(ConfigurationError, match=r"'infra_1'.*cut off.*\[0\]"):
            planned(unplug, other, lockstep=False)


ANYTHING = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-3, 200),
    st.floats(),
    st.sampled_from([*ROLES, *ROLES.values(), "one", "majority", "cc/picture", "agent/*/tracks", "", "up", "Loss"]),
    st.lists(st.sampled_from([*ROLES, "nobody"]), max_size=3),
    st.just({"type": "Cut"}),
)
PARAMETERS = sorted({name for cls in KINDS.values() for name in inspect.signature(cls).parameters})


@given(
    st.lists(
        st.fixed_dictionaries(
            {"type": st.sampled_from(sorted(KINDS)), "at": st.floats(0.0, 12.0) | ANYTHING},
            optional={name: ANYTHING for name in PARAMETERS if name != "at"},
        ),
        max_size=4,
    ),
    st.booleans(),
)
def test_every_list_of_faults_is_planned_or_refused(specs: list[dict[str, Any]], lockstep: bool) -> None:
    refused, fault_plan = "", FaultPlan()
    try:
        fault_plan = planned(*specs, lockstep=lockstep)
    except ConfigurationError as error:
        refused = str(error)
    assert refused.startswith("mine.py: faults[") or len(fault_plan.bands) + len(fault_plan.missed) == len(specs)
    assert all(0 <= step.frame < len(TIMES_NS) for step in fault_plan.steps)
