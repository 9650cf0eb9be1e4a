"""Failed handlers on a mesh are reported exactly as in one process."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import failing
import psutil
import pytest
from launched import Launched

from mast_zenoh import scenario
from mast_zenoh.launch import run as launcher
from mast_zenoh.launch.tables import read_table
from mast_zenoh.run_files import read_json

pytestmark = [pytest.mark.heavy, pytest.mark.mesh]
FRAMES = 12


def in_process(path: Path, out: Path, frames: int = FRAMES) -> dict[str, Any]:
    """run.json of the same scenario in one process."""
    file, loaded = scenario.load(str(path), [])
    return launcher.run(scenario.resolve(file, loaded, frames=frames), out, runtime="inproc").record


def failures(record: dict[str, Any]) -> dict[str, Any]:
    return {name: node["failures"] for name, node in record["nodes"].items() if node["failures"]}


def test_failures_on_a_mesh_equal_those_in_one_process_and_set_the_exit_code(launch, tmp_path: Path) -> None:
    message = "evaluator.finish failed once in frame 11: ZeroDivisionError: division by zero ("
    path = failing.write("evaluator", tmp_path)
    run: Launched = launch(str(path), "--frames", str(FRAMES), "--no-record")
    code, output = run.end()
    assert code == 30, output
    record = run.record()
    assert record["status"] == "handler_failures"
    assert f"HandlerFailed: handlers failed, so the numbers may be wrong:\n  {message}" in output
    (node,) = failures(record)
    assert str(run.out / "logs" / f"{node}.log") in output
    assert failures(record) == failures(in_process(path, tmp_path / "inproc"))
    assert not (run.out / "metrics.json").is_file()


def test_a_node_that_fails_to_start_ends_the_run_on_a_mesh_and_in_one_process(launch, tmp_path: Path) -> None:
    path = failing.write("start", tmp_path)
    node = tmp_path / "idle.py"
    node.write_text(node.read_text().replace("FileNotFoundError", "GeneratorExit"))
    run: Launched = launch(str(path), "--frames", str(FRAMES), "--no-record", "--allow-failures")
    code, output = run.end()
    assert code == 21, output
    message = "eve.start failed once before the first frame: GeneratorExit: no weights ("
    assert f"StartError: {message}" in output
    record = in_process(path, tmp_path / "inproc")
    assert record["status"] == run.record()["status"] == "failed"
    assert record["message"].startswith(message)
    assert failures(record) == failures(run.record())


def test_failures_of_a_killed_node_are_kept(launch, tmp_path: Path) -> None:
    failing.write("attack", tmp_path)
    (tmp_path / "killed.py").write_text(
        "from attack import Fragile, scenario as attacked\n\n"
        "def scenario():\n"
        "    faults = [dict(type='Kill', at=0.8, node='eve', restart_after=0.2)]\n"
        "    return attacked() | dict(faults=faults)\n"
    )
    run: Launched = launch(str(tmp_path / "killed.py"), "--frames", "14", "--no-record")
    code, output = run.end()
    assert code == 30, output
    (entry,) = failures(run.record())["eve"]
    assert (entry["count"], entry["frames"], entry["first_frame"], entry["last_frame"]) == (7, 7, 5, 13)
    assert failures(run.record()) == failures(in_process(tmp_path / "killed.py", tmp_path / "inproc", 14))


def test_a_node_file_without_main_runs_and_its_process_title_names_the_node(launch, tmp_path: Path) -> None:
    path = failing.write("second", tmp_path)
    assert "__main__" not in (tmp_path / "counter.py").read_text()
    run: Launched = launch(str(path), "--mode", "realtime", "--rate", "5", "--frames", "20")
    commands = {
        name: psutil.Process(node["pid"]).cmdline()
        for name, node in run.started()["nodes"].items()
        if psutil.pid_exists(node["pid"])
    }
    code, output = run.end()
    assert code == 0, output
    for name in ("counter", "other"):
        assert str(tmp_path / "counter.py") in commands[name]
        assert commands[name][commands[name].index("--name") + 1] == name
    own = run.out / "results" / "counter"
    assert read_table(own / "metrics.parquet")["frame"].tolist() == [*range(20)]
    assert read_json(run.out / "metrics.json")["frames"] == 20
    assert "results: 1 refused: other: table '../other': expected a name" in output
    assert not list(tmp_path.rglob("other.parquet"))


def test_a_node_that_exits_with_0_before_the_first_frame_fails_the_run(launch, tmp_path: Path) -> None:
    path = failing.write("second", tmp_path)
    file = tmp_path / "counter.py"
    leaves = "        if __import__('os').path.exists('wiring.json'):\n            raise SystemExit(0)\n"
    file.write_text(file.read_text().replace("        self.table = table\n", f"        self.table = table\n{leaves}"))
    run: Launched = launch(str(path), "--frames", "3", "--no-record")
    code, output = run.end()
    assert code == 21, output
    what = "ended before the first frame: exit code 0, but it handed in no results"
    assert f"counter {what}" in output or f"other {what}" in output
    ended = {name: node["ended"] for name, node in run.record()["nodes"].items()}
    assert "ok" not in (ended["counter"], ended["other"])
