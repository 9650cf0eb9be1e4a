"""Messages after their batch are counted and reported in metrics.json."""

import json
from pathlib import Path

from tiny_world import tiny

from mast_zenoh.launch import run


def test_late_messages_of_a_slow_link_are_in_the_metrics_by_agent(tmp_path: Path) -> None:
    def slow(scenario: dict) -> None:
        scenario["links"] = {"infra_1": dict(up=[dict(type="Delay", mean_s=0.25)]), "*": dict(up=[])}

    outcome = run.run(tiny(edit=slow), tmp_path / "run", runtime="inproc")
    assert outcome.error is None
    metrics = json.loads((outcome.folder / "metrics.json").read_text())
    assert metrics["late"] == {"infra_1": 10}, "two of 12 are still in transit at the end"
    assert (outcome.folder / "checks.json").is_file()


def test_without_late_messages_no_agent_is_named(tmp_path: Path) -> None:
    outcome = run.run(tiny(), tmp_path / "run", runtime="inproc")
    assert json.loads((outcome.folder / "metrics.json").read_text())["late"] == {}
    assert not (outcome.folder / "checks.json").exists(), "nothing to check without faults"
