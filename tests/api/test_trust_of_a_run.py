"""Runs whose command centre judges agents: its trust in tables, and what it was worth."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mast_zenoh as mast
from mast_zenoh.errors import RunFolderError
from mast_zenoh.integrity import STATES
from mast_zenoh.launch.measurement import measure
from mast_zenoh.runs.observability import observability
from mast_zenoh.scenario.reading import load

pytestmark = pytest.mark.heavy

LOSS_S = (2.0, 3.0)
FAULTS: list[dict[str, Any]] = [
    dict(type="Loss", at=LOSS_S[0], until=LOSS_S[1], node="infra_2", probability=0.5),
    dict(type="Delay", at=2.0, node="infra_3", mean_s=0.1, direction="down"),
]
COLUMNS = (
    *("frame", "time_s", "agent", "mean", "log_odds", "state", "reason"),
    *("fault_offset_x", "fault_offset_y", "fault_turn", "fault_delay", "fault_loss"),
)


@pytest.fixture(scope="module")
def judged(tmp_path_factory: pytest.TempPathFactory) -> mast.Run:
    """A run with one adversary and two faults, whose command centre judges agents."""
    out = tmp_path_factory.mktemp("judged") / "run"
    _, scenario = load("defended", ["n_adversaries=1", "defence=SequentialConsistency", "scene_index=7"])
    return mast.run(scenario | dict(faults=FAULTS), frames=130, seed=11, out=out)


def agents(run: mast.Run) -> dict[str, Any]:
    """The agents' part of `integrity`."""
    part: dict[str, Any] = run.summary["integrity"]["agents"]
    return part


def test_trust_of_every_agent_is_a_table(judged: mast.Run) -> None:
    table = judged.trust
    assert tuple(table.column_names) == COLUMNS
    assert set(table["agent"].to_pylist()) == set(judged.agents)
    assert set(table["state"].to_pylist()) <= set(STATES)


def test_objects_of_the_centre_are_a_table_with_those_withheld(judged: mast.Run) -> None:
    table = judged.trust_objects
    withheld = table["withheld"].to_numpy(zero_copy_only=False)
    assert withheld.any()
    assert not withheld.all()
    kept = {
        (frame, id_)
        for frame, id_, left_out in zip(table["frame"].to_pylist(), table["id"].to_pylist(), withheld, strict=True)
        if not left_out
    }
    picture = judged.picture
    assert kept == set(zip(picture["frame"].to_pylist(), picture["id"].to_pylist(), strict=True))


def test_a_run_without_trust_has_neither_tables_nor_metrics_of_it(attacked: mast.Run) -> None:
    assert "integrity" not in attacked.summary
    assert not list(attacked.path.glob("trust*"))
    with pytest.raises(RunFolderError, match=r"trust\.parquet: missing"):
        _ = attacked.trust


def test_trust_is_measured_again_from_the_recording(judged: mast.Run, tmp_path: Path) -> None:
    before, table = judged.summary, judged.trust
    assert measure(judged.path) == []
    assert judged.summary == before
    assert judged.trust.equals(table)


def test_lies_are_observable_where_honest_agents_would_have_returns(judged: mast.Run) -> None:
    result = observability(judged)
    changes = judged.attacks.to_pydict()
    of_adversary = [role == "adversary" for role in changes["role"]]
    assert result.lies.num_rows == sum(of_adversary)
    lies = result.lies.to_pydict()
    assert set(lies["agent"]) == {"infra_1"}
    assert lies["observable"] == [n > 0 for n in lies["honest_viewers"]]
    pairs = zip(lies["honest_viewers"], lies["lying_viewers"], strict=True)
    assert lies["identifiable"] == [honest > lying for honest, lying in pairs]
    assert max(lies["honest_viewers"]) <= 4
    assert max(lies["lying_viewers"]) == 1


def test_delays_count_from_the_first_observable_lie(judged: mast.Run) -> None:
    result = observability(judged.path)
    first = result.first_observable_s["infra_1"]
    assert first is not None
    assert first >= result.first_lie_s["infra_1"] == agents(judged)["infra_1"]["first_lie_s"]
    suspended = agents(judged)["infra_1"]["suspensions"][0]["from_s"]
    assert result.suspended_after_s["infra_1"] == pytest.approx(suspended - first)


def test_hidden_objects_are_observable_if_an_honest_agent_sees_the_true_one(judged: mast.Run) -> None:
    lies = observability(judged).lies.to_pylist()
    truth = judged.truth.to_pylist()
    checked = 0
    for lie in lies:
        if lie["effect"] == "removed":
            near = [
                row
                for row in truth
                if row["frame"] == lie["frame"] and np.hypot(row["x"] - lie["x"], row["y"] - lie["y"]) < 4.0
            ]
            seen = any(row["points"] >= 5 for row in near)
            assert lie["honest_viewers"] + lie["lying_viewers"] == 0 or seen
            checked += 1
    assert checked


def test_observability_works_without_trust_and_without_adversaries(baseline: mast.Run, attacked: mast.Run) -> None:
    assert observability(baseline).lies.num_rows == 0
    result = observability(attacked)
    assert result.lies.num_rows > 0
    assert set(result.suspended_after_s.values()) == {None}
