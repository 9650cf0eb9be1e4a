"""Verdicts of tools/stopped.py and tools/endings.py on disturbed runs."""

import json
from pathlib import Path

import endings
import pytest
import stopped
from equal_runs import run_alone

ERROR = "error: NodeLost: infra_1 was lost before frame 3"


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """The undisturbed run, an equal run, and a different one."""
    folder, options = tmp_path_factory.mktemp("runs"), dict(frames=4, record=True)
    return [
        run_alone(folder / str(number), "baseline", "n_infrastructure=1", seed=seed, **options)
        for number, seed in enumerate((1, 1, 2))
    ]


def says(run: Path, **record: object) -> None:
    path = run / "run.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | record))


def test_a_run_that_equals_the_undisturbed_one_is_sound_without_churn_and_traceback(runs: list[Path]) -> None:
    assert stopped._judge(runs[1], runs[0], 0, "") == ("ok, exit code 0: equal", [])
    assert stopped._judge(runs[1], runs[0], 0, "Traceback")[1]
    says(runs[1], churn=[{"frame": 3, "node": "infra_1", "what": "lost"}])
    assert stopped._judge(runs[1], runs[0], 0, "")[1]
    says(runs[1], churn=[])


def test_a_run_that_differs_must_report_it(runs: list[Path]) -> None:
    how, broken = stopped._judge(runs[2], runs[0], 0, "")
    assert how == "ok, exit code 0: not equal"
    assert "first difference" in broken[0] or "frame 0" in broken[0]
    says(runs[2], status="node_lost", message="infra_1 was lost\nbecause")
    how = "node_lost, exit code 33: not equal (infra_1 was lost)"
    assert stopped._judge(runs[2], runs[0], 33, ERROR) == (how, [])
    assert stopped._judge(runs[2], runs[0], 33, "")[1] == ["no message"]
    assert stopped._judge(runs[2], runs[0], 0, ERROR)[1] == ["status 'node_lost' with exit code 0"]


def test_a_plan_follows_from_its_number_and_covers_every_scenario() -> None:
    plans = [stopped.Plan.draw(0, number) for number in range(12)]
    assert plans == [stopped.Plan.draw(0, number) for number in range(12)]
    assert {plan.scenario for plan in plans} == stopped.SCENARIOS.keys()
    assert all(0.5 <= stop.for_s <= 10.0 for plan in plans for stop in plan.stops)


def test_claims_about_a_recording_must_be_true(runs: list[Path]) -> None:
    def judged(run: Path, status: str, **changes: object) -> list[str]:
        record = json.loads((run / "run.json").read_text())
        return endings._recording_errors({**record, **changes}, status, run, runs[0])

    complete, cut = {"complete": True}, {"complete": False, "from_frame": 0}
    assert judged(runs[1], "ok", recording=complete) == []
    assert judged(runs[1], "ok", recording=complete, recorded={"messages": 7})[0].endswith("run.json says 7")
    assert judged(runs[2], "interrupted", recording=cut) == []
    assert "undisturbed run" in judged(runs[2], "interrupted", recording=complete)[0]
    assert judged(runs[2], "killed", recorded={})  # complete, but of another run
