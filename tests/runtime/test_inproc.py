"""All messages of a run are a function of its scenario and seed."""

from functools import cache
from pathlib import Path
from typing import Any

import pytest
from tiny_world import Run, tiny

from mast_zenoh.config.resolved import Resolved
from mast_zenoh.errors import RunError
from mast_zenoh.mesh import inproc
from mast_zenoh.mesh.control import results
from mast_zenoh.mesh.inproc import InProcess

LINK = Path(__file__).with_name("lossy_link.py")
ATTACKED = ("n_adversaries=1", "attack_start_s=0.2")


def with_loss(scenario: dict[str, Any], doubles: bool = False) -> None:
    """Insert the lossy link before infra_1 and let the broker wait a little."""
    scenario["nodes"] = {"link": dict(role="lossy", file=str(LINK), agent="infra_1", doubles=doubles)}
    insert = [
        dict(wire=f"agent/{{agent}}/{port}", role="lossy", input=port, output=f"{port}_out")
        for port in ("pose", "detections")
    ]
    scenario["keyexpr"]["rewrites"] = [{"insert": insert}, *scenario["keyexpr"]["rewrites"]]
    scenario["broker"] = dict(latency_s=0.1, patience=1)


@cache
def world(name: str, *settings: str, lossy: bool = False, infrastructure: int = 2, seed: int = 0) -> Resolved:
    edit = with_loss if lossy else None
    return tiny(name, *settings, edit=edit, infrastructure=infrastructure, seed=seed)


@cache
def played(name: str, *settings: str, **options: Any) -> Run:
    run = Run(world(name, *settings, **options))
    assert not run.failures
    assert not run.rejected
    return run


def test_an_agent_without_sensor_data_still_publishes_in_every_frame() -> None:
    run = played("coordinated", *ATTACKED, lossy=True)
    for key in ("agent/infra_1/tracks/@tap/0", "agent/infra_1/tracks"):
        frames = [message.header.frame for message in run.decoded(key, "tracks")]
        assert frames == list(range(11)), "the last frame has no next clock"


def test_interposers_that_change_nothing_leave_no_trace() -> None:
    plain, tapped = played("baseline"), played("passthrough")
    taps = {key for key in tapped.messages if "@tap" in key}
    assert len(taps) == 6, "two wires of each of three agents"
    assert {key: payloads for key, payloads in tapped.messages.items() if key not in taps} == plain.messages
    measured = [dict(run.results["evaluator"]["metrics"]) for run in (plain, tapped)]
    interposers = [metrics.pop("interposers") for metrics in measured]
    achieved = [metrics.pop("achieved") for metrics in measured]
    assert measured[0] == measured[1]
    assert not interposers[0]
    assert not achieved[0]
    assert all(verdict["effects"] == {} for verdict in interposers[1].values())
    assert not any(verdict["success_centre"] or verdict["success_ego"] for verdict in achieved[1].values())
    for name in ("metrics", "objects", "targets", "driving"):
        assert results.pack(tapped.results["evaluator"]["tables"][name]) == results.pack(
            plain.results["evaluator"]["tables"][name]
        )
    for tap in taps:
        assert tapped.messages[tap] == plain.messages[tap.split("/@tap")[0]]


def test_an_attack_that_has_not_started_changes_nothing() -> None:
    plain = played("baseline")
    for name in ("uncoordinated", "coordinated"):
        waiting = played(name, "n_adversaries=2", "attack_start_s=99.0")
        assert {key: waiting.messages[key] for key in plain.messages} == plain.messages


def test_the_same_seed_gives_the_same_run_and_another_seed_another_run() -> None:
    for name in ("uncoordinated", "coordinated"):
        again = Run(tiny(name, *ATTACKED))
        assert again.messages == played(name, *ATTACKED).messages
        other = played(name, *ATTACKED, seed=1)
        for key in ("agent/ego/detections", "agent/infra_1/tracks", "cc/picture"):
            assert other.messages[key] != again.messages[key]
        report = "attack/adversary_1/report"
        assert other.decoded(report, "attack_report")[0].body["after_position"].tobytes() != (
            again.decoded(report, "attack_report")[0].body["after_position"].tobytes()
        )


@pytest.mark.parametrize("name", ["uncoordinated", "coordinated"])
def test_one_more_adversary_does_not_change_the_random_streams_of_others(name: str) -> None:
    """Common random numbers: unattacked data and the first adversary are equal."""
    plain, one, two = (
        played("baseline", infrastructure=3),
        played(name, "n_adversaries=1", "attack_start_s=0.2", infrastructure=3),
        played(name, "n_adversaries=2", "attack_start_s=0.2", infrastructure=3),
    )
    for run, untouched in ((one, ("ego", "infra_2", "infra_3")), (two, ("ego", "infra_3"))):
        for agent in untouched:
            for what in ("detections", "tracks"):
                assert run.messages[f"agent/{agent}/{what}"] == plain.messages[f"agent/{agent}/{what}"]
        assert run.messages["cc/picture"] != plain.messages["cc/picture"]
    if name == "uncoordinated":
        for key in ("attack/adversary_1/report", "agent/infra_1/detections", "agent/infra_1/tracks"):
            assert one.messages[key] == two.messages[key]


def test_a_pole_that_acts_gets_the_picture_and_changes_nothing_else() -> None:
    usual, acting = Run(tiny()), Run(tiny(acting=True))
    more = {"agent/infra_1/mission", "agent/infra_2/mission"}
    assert acting.messages.keys() - usual.messages.keys() == more
    assert {key: acting.messages[key] for key in usual.messages} == usual.messages
    assert all(len(acting.messages[key]) == 12 for key in more)


@pytest.mark.parametrize("infrastructure", [0, 6])
def test_runs_work_with_any_number_of_agents(infrastructure: int) -> None:
    run = played("baseline", infrastructure=infrastructure)
    agents = ["ego", *(f"infra_{i + 1}" for i in range(infrastructure))]
    assert list(run.results["evaluator"]["metrics"]["agents"]) == agents
    for agent in agents:
        assert len(run.messages[f"agent/{agent}/tracks"]) == 12
        assert len(run.messages[f"agent/{agent}/mission"]) == (12 if agent == "ego" else 0), "a pole acts on nothing"
    collation = run.results["broker"]["collation"]
    assert collation == {"complete": 12, "overdue": 0, "late": {}, "overflowed": 0, "absurd": 0}
    assert run.decoded("cc/collated", "collated")[-1].body["agents"].tolist() == sorted(agents)
    for agent in ("ego", "infra_1", "infra_2")[: infrastructure + 1]:
        key = f"agent/{agent}/tracks"
        assert run.messages[key] == played("baseline").messages[key], "more agents change nothing for the others"


def test_progress_is_reported_frame_by_frame() -> None:
    progress: list[int] = []
    outcome = InProcess(world("baseline"), progress=progress.append).run()
    assert progress == list(range(1, 13))
    assert outcome[""]["frames"] == 12
    assert outcome["evaluator"]["metrics"]["frames"] == 12


def test_a_run_needs_exactly_one_driver() -> None:
    resolved = world("baseline")
    nodes = {name: spec for name, spec in resolved.nodes.items() if name != "simulator"}
    wires = [wire for wire in resolved.wiring["wires"] if wire["publisher"] != "simulator"]
    without = Resolved(**{**vars(resolved), "nodes": nodes, "wiring": {"wires": wires}})
    with pytest.raises(RunError, match=r"nodes drive.*simulator"):
        InProcess(without)


def test_nodes_that_answer_each_other_without_end_fail_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(inproc, "MAX_DELIVERIES", 8)
    with pytest.raises(RunError, match=r"frame 0.*deliveries"):
        InProcess(world("baseline")).run()
