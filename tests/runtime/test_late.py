"""Messages that arrive after their batch are counted in metrics.json."""

import json
from pathlib import Path

from tiny_world import tiny

from mast_zenoh.launch import run


def test_late_messages_of_a_slow_link_are_counted_by_agent(tmp_path: Path) -> None:
    def slow(scenario: dict) -> None:
        scenario["links"] = {"infra_1": dict(up=[dict(type="Delay", mean_s=0.25)]), "*": dict(up=[])}

    run_result = run.run(tiny(edit=slow), tmp_path / "run", runtime="inproc")
    assert run_result.error is None
    metrics = json.loads((run_result.folder / "metrics.json").read_text())
    assert metrics["late"] == {"infra_1": 10}, "two of 12 are still in transit at the end"
    assert (run_result.folder / "checks.json").is_file()


def test_a_run_without_late_messages_counts_none(tmp_path: Path) -> None:
    run_result = run.run(tiny(), tmp_path / "run", runtime="inproc")
    assert json.loads((run_result.folder / "metrics.json").read_text())["late"] == {}
    assert not (run_result.folder / "checks.json").exists(), "nothing to check without faults"
