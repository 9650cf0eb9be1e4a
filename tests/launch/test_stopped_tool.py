"""What tools/stopped.py says of a run whose nodes were stopped: equal, not equal and said so, or broken."""

from __future__ import annotations

import importlib.util
import json
import sys
from pathlib import Path
from types import ModuleType

import pytest

from mast_zenoh import scenario
from mast_zenoh.launch import local

ERROR = "error: NodeLost: infra_1 was lost before frame 3"


@pytest.fixture(scope="module")
def tool() -> ModuleType:
    path = Path(__file__).parents[2] / "tools" / "stopped.py"
    spec = importlib.util.spec_from_file_location("stopped", path)
    assert spec is not None
    assert spec.loader is not None
    module = sys.modules["stopped"] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """The undisturbed one, one that equals it, and one that does not."""
    folder = tmp_path_factory.mktemp("runs")
    path, loaded = scenario.load("baseline", ["n_infrastructure=1"])
    made = [
        local.run(
            scenario.resolve(path, loaded, frames=4, seed=seed, record=True), folder / str(number), runtime="inproc"
        )
        for number, seed in enumerate((1, 1, 2))
    ]
    return [run.folder for run in made]


def says(run: Path, **record: object) -> None:
    path = run / "run.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | record))


def test_a_run_that_equals_the_undisturbed_one_is_sound(tool: ModuleType, runs: list[Path]) -> None:
    assert tool._judge(runs[1], runs[0], 0, "") == ("ok, exit code 0: equal", [])


def test_a_run_that_differs_must_say_so(tool: ModuleType, runs: list[Path]) -> None:
    how, broken = tool._judge(runs[2], runs[0], 0, "")
    assert how == "ok, exit code 0: not equal"
    assert "first difference" in broken[0] or "frame 0" in broken[0]
    says(runs[2], status="node_lost", message="infra_1 was lost\nbecause")
    how = "node_lost, exit code 33: not equal (infra_1 was lost)"
    assert tool._judge(runs[2], runs[0], 33, ERROR) == (how, [])
    assert tool._judge(runs[2], runs[0], 33, "")[1] == ["no message"]
    assert tool._judge(runs[2], runs[0], 0, ERROR)[1] == ["status 'node_lost' with exit code 0"]


def test_a_run_that_is_ok_has_no_churn_and_no_traceback(tool: ModuleType, runs: list[Path]) -> None:
    assert tool._judge(runs[1], runs[0], 0, "Traceback")[1]
    says(runs[1], churn=[{"frame": 3, "node": "infra_1", "what": "lost"}])
    assert tool._judge(runs[1], runs[0], 0, "")[1]


def test_a_plan_follows_from_its_number_and_every_scenario_has_its_turn(tool: ModuleType) -> None:
    plans = [tool.Plan.draw(0, number) for number in range(12)]
    assert plans == [tool.Plan.draw(0, number) for number in range(12)]
    assert {plan.scenario for plan in plans} == tool.SCENARIOS.keys()
    assert all(0.5 <= stop.for_s <= 10.0 for plan in plans for stop in plan.stops)
