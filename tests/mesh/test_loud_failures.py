"""Failed handlers on a mesh are reported exactly as in one process."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import failing
import pytest
from launched import Launched

from mast_zenoh import scenario
from mast_zenoh.launch import run as launcher

pytestmark = [pytest.mark.heavy, pytest.mark.mesh]


def failures(record: dict[str, Any]) -> dict[str, Any]:
    return {name: node["failures"] for name, node in record["nodes"].items() if node["failures"]}


def test_failures_on_a_mesh_equal_those_in_one_process_and_set_the_exit_code(launch, tmp_path: Path) -> None:
    """Also those of a process that is killed and replaced."""
    failing.write("attack", tmp_path)
    path = tmp_path / "killed.py"
    path.write_text(
        "from attack import Fragile, scenario as attacked\n\n"
        "def scenario():\n"
        "    faults = [dict(type='Kill', at=0.8, node='eve', restart_after=0.2)]\n"
        "    return attacked() | dict(faults=faults)\n"
    )
    run: Launched = launch(str(path), "--frames", "14", "--no-record")
    output = run.ended(30)
    record = run.record()
    assert record["status"] == "handler_failures"
    assert "HandlerFailed: handlers failed, so the numbers may be wrong:\n  eve.on_detections failed 7 times" in output
    assert str(run.out / "logs" / "eve.log") in output
    (entry,) = failures(record)["eve"]
    assert (entry["count"], entry["frames"], entry["first_frame"], entry["last_frame"]) == (7, 7, 5, 13)
    file, loaded = scenario.load(str(path), [])
    alone = launcher.run(scenario.resolve(file, loaded, frames=14), tmp_path / "inproc", runtime="inproc")
    assert failures(record) == failures(alone.record)
    assert (run.out / "metrics.json").is_file(), "the results are kept as evidence"
