"""The trust of a trial, kept for the figure."""

from __future__ import annotations

import json
from typing import Any

import pytest

import mast_zenoh as mast
from mast_zenoh.study.defences.matrix import MAX_AGENTS, panel, suspends
from mast_zenoh.study.defences.matrix_trial import outnumbered, trace


def kept(**changes: Any) -> dict[str, Any]:
    """The trace of one honest agent, changed."""
    quiet = dict(time_s=[0.0, 0.2], log_odds=[None, 4.0], states={"faulty": [], "suspended": []}, lies=[], faults=[])
    return quiet | changes


def test_of_many_agents_those_that_lie_fail_or_are_suspended_are_shown() -> None:
    agents = {f"agent_{index}": kept() for index in range(9)}
    agents["agent_6"] = kept(lies=[[1.0, 2.0]])
    agents["agent_7"] = kept(faults=[["Loss", 1.0, 2.0]])
    agents["agent_8"] = kept(states={"faulty": [], "suspended": [[1.0, 2.0]]})
    drawn = panel({"end_s": 3.0, "agents": agents}, "title")
    assert [agent.agent for agent in drawn.agents] == ["agent_0", "agent_1", "agent_6", "agent_7", "agent_8"]
    assert (len(drawn.agents), drawn.left_out) == (MAX_AGENTS, 4)
    assert suspends({"agents": agents})
    assert not suspends({"agents": {"agent_0": kept()}})


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> mast.Run:
    """A run of 4 s whose liar begins at 2 s."""
    settings = dict(attack="uncoordinated", placement="poles", n_adversaries=1, attack_start_s=2.0)
    folder = tmp_path_factory.mktemp("traces") / "run"
    options = dict(frames=40, runtime="inproc", seed=0, out=folder, scene="intersection:8")
    return mast.run("defence_cell", defence="FaultOrLie", **options, **settings)  # type: ignore[arg-type]


def test_a_trace_survives_json_and_has_lies_and_suspensions(run: mast.Run) -> None:
    content = trace(run.path)
    assert content is not None
    content = json.loads(json.dumps(content, allow_nan=False))
    drawn = panel(content, "title")
    agents = {agent.agent: agent for agent in drawn.agents}
    assert list(agents) == ["ego", "infra_1", "infra_2", "infra_3", "infra_4"]
    assert drawn.end_s == pytest.approx(4.0)
    (begin, end), *_ = agents["infra_1"].lies
    assert begin == pytest.approx(2.0, abs=0.3)
    assert suspends(content)
    assert begin <= agents["infra_1"].states["suspended"][0][0] < 4.0
    assert agents["infra_1"].value[-1] < 0.0 < agents["infra_2"].value[-1]
    assert len(agents["ego"].time_s) == pytest.approx(20, abs=1), "twice as coarse as the frames"
    assert end <= 4.1


def test_a_trace_is_small(run: mast.Run) -> None:
    content = trace(run.path)
    assert content is not None
    assert len(json.dumps(content)) < 4000, "every trial of a study keeps it"


def test_only_observable_lies_can_be_outnumbered() -> None:
    lies: dict[str, Any] = dict(
        observable=[True, True, True, False], honest_viewers=[2, 1, 1, 0], lying_viewers=[1, 1, 2, 3]
    )
    assert outnumbered(lies) == pytest.approx(1 / 3), "a tie outnumbers nobody"
    assert outnumbered({name: column[3:] for name, column in lies.items()}) is None
