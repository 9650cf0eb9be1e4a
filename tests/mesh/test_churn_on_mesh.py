"""Processes that a scenario kills, starts and pauses: the run goes on as in one process, and nothing stays behind."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import psutil
import pytest
from launched import Observer, alive, eventually

from mast_zenoh import codec, scenario
from mast_zenoh.faults.steps import ProcessStep
from mast_zenoh.launch import local
from mast_zenoh.messagelog.difference import compare
from mast_zenoh.messagelog.explain import explain
from mast_zenoh.messagelog.reader import read
from mast_zenoh.scenario import Resolved

pytestmark = pytest.mark.mesh

#: One after the other, and two at once; some come back, one comes late, one never does.
STEPS = (
    (2, "start", "infra_3"),
    (3, "kill", "infra_1"),
    (5, "start", "infra_1"),
    (6, "kill", "adversary_1"),
    (6, "kill", "command_center"),
    (8, "kill", "broker"),
    (8, "start", "command_center"),
    (10, "start", "adversary_1"),
    (10, "start", "broker"),
    (11, "leave", "ego"),
    (12, "kill", "infra_2"),
    (13, "start", "ego"),
)


def resolved(*steps: tuple[int, str, str], frames: int, **options: object) -> Resolved:
    path, loaded = scenario.load("coordinated", ["n_infrastructure=3", "attack_start_s=0.2"])
    found = scenario.resolve(path, loaded, frames=frames, record=True, **options)
    return replace(found, steps=tuple(ProcessStep(*step) for step in steps))


def frames_of(folder: Path, key: str) -> list[int]:
    return [message.frame for message in read(folder) if message.key == key]


def test_in_lock_step_the_mesh_says_what_one_process_says_whoever_dies_and_comes_back(tmp_path: Path) -> None:
    what = resolved(*STEPS, frames=16)
    mesh = local.run(what, tmp_path / "mesh")
    assert mesh.error is None, mesh.error
    inproc = local.run(what, tmp_path / "inproc", runtime="inproc")
    assert inproc.error is None
    found = compare(mesh.folder, inproc.folder, taps=True)
    assert found.first is None, "\n".join(explain(found))
    assert found.equal == len(list(read(mesh.folder)))
    assert (mesh.folder / "metrics.json").read_bytes() == (inproc.folder / "metrics.json").read_bytes()
    assert frames_of(mesh.folder, "agent/infra_1/tracks/@tap/0") == [0, 1, 2, *range(5, 16)]
    assert frames_of(mesh.folder, "agent/infra_1/tracks") == [0, 1, 2, 5, *range(10, 16)], "its adversary was away"
    assert frames_of(mesh.folder, "agent/infra_3/tracks") == list(range(2, 16))
    done = [{"frame": frame, "action": action, "node": node} for frame, action, node in STEPS]
    in_order = sorted(done, key=lambda step: (step["frame"], step["action"] == "start", step["node"]))
    assert mesh.record["steps"] == inproc.record["steps"] == in_order
    for record in (mesh.record, inproc.record):
        assert record["status"] == "ok"
        assert record["message"] == "", "what the scenario wants is no news"
        assert record["nodes"]["infra_2"]["ended"].startswith("killed by the scenario")
        assert record["nodes"]["ego"]["exit"] == 0
        assert {name for name, node in record["nodes"].items() if node["restarts"]} == {
            "infra_1",
            "adversary_1",
            "command_center",
            "broker",
            "ego",
        }


def started(tmp_path: Path, *steps: tuple[int, str, str]) -> tuple[subprocess.Popen[bytes], Path]:
    """A run in real time, longer than any test, whose launcher is a process of its own."""
    script = tmp_path / "launch.py"
    script.write_text(
        "import sys\n"
        "from dataclasses import replace\n"
        "from pathlib import Path\n"
        "from mast_zenoh import scenario\n"
        "from mast_zenoh.faults.steps import ProcessStep\n"
        "from mast_zenoh.launch import local\n"
        "path, loaded = scenario.load('baseline', ['n_infrastructure=2'])\n"
        "found = scenario.resolve(path, loaded, mode='realtime', rate=0.5, record=True)\n"
        f"steps = tuple(ProcessStep(*step) for step in {steps!r})\n"
        "ended = local.run(replace(found, steps=steps), Path(sys.argv[1]))\n"
        "print(ended.record['status'])\n"
    )
    out = tmp_path / "run"
    return subprocess.Popen([sys.executable, str(script), str(out)], stdout=subprocess.PIPE), out


def record_of(out: Path) -> dict[str, Any]:
    """run.json, as soon as it names the processes."""

    def named() -> dict[str, Any] | None:
        path = out / "run.json"
        record = json.loads(path.read_text()) if path.is_file() else {}
        return record if record.get("nodes") else None

    return eventually(named, "run.json names the nodes")


def test_in_real_time_who_is_killed_comes_back_and_who_is_paused_goes_on(tmp_path: Path) -> None:
    steps = ((5, "kill", "infra_1"), (5, "pause", "infra_2"), (8, "resume", "infra_2"), (8, "start", "infra_1"))
    launcher, out = started(tmp_path, *steps)
    try:
        observer = Observer(record_of(out), "agent/*/tracks")
        try:

            def newest(agent: str) -> int:
                heard = [s for key, s in observer.samples if key == f"agent/{agent}/tracks"]
                return codec.decode(heard[-1].payload.to_bytes(), "tracks").header.frame if heard else -1

            eventually(lambda: newest("infra_1") > 8 and newest("infra_2") > 8, "both are there again")
        finally:
            observer.close()
        launcher.send_signal(signal.SIGINT)
        output, _ = launcher.communicate(timeout=30)
    finally:
        launcher.kill()
        launcher.communicate()
    assert output.split() == [b"interrupted"]
    record = json.loads((out / "run.json").read_text())
    assert {name: node["restarts"] for name, node in record["nodes"].items() if node["restarts"]} == {"infra_1": 1}
    assert all(node["exit"] == 0 for node in record["nodes"].values()), record["nodes"]
    assert sorted(tuple(step.values()) for step in record["steps"]) == sorted(steps)
    heard = frames_of(out, "agent/infra_1/tracks")
    assert heard[:5] == list(range(5)), "it was killed when frame 5 was due"
    assert min(frame for frame in heard if frame > 5) >= 8
    clocks = frames_of(out, "clock")
    assert clocks == list(range(len(clocks))), "nobody stalls the clock"


def paused(out: Path, node: str) -> list[int]:
    """The pids of all nodes, when this one stands still."""

    nodes = record_of(out)["nodes"]
    process = psutil.Process(nodes[node]["pid"])
    eventually(lambda: process.status() == psutil.STATUS_STOPPED, f"{node} stands still")
    return [told["pid"] for told in nodes.values()]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL], ids=["Ctrl-C", "killed launcher"])
def test_however_a_run_ends_a_node_that_stands_still_does_not_stay_behind(
    tmp_path: Path, number: signal.Signals
) -> None:
    launcher, out = started(tmp_path, (2, "pause", "infra_1"))
    try:
        pids = paused(out, "infra_1")
        launcher.send_signal(number)
        output, _ = launcher.communicate(timeout=30)
        eventually(lambda: not alive(pids), "all nodes have left", seconds=5.0)
    finally:
        launcher.kill()
        launcher.communicate()
    if number == signal.SIGINT:
        assert output.split() == [b"interrupted"]
        nodes = json.loads((out / "run.json").read_text())["nodes"]
        assert {node["ended"] for node in nodes.values()} == {"ok"}, "it was let go on, and has handed in"


def test_who_still_stands_still_at_the_end_is_let_go_on(tmp_path: Path) -> None:
    ended = local.run(resolved((5, "pause", "infra_1"), frames=10, mode="realtime", rate=2.0), tmp_path / "run")
    assert ended.error is None, ended.error
    assert ended.record["nodes"]["infra_1"]["ended"] == "ok"


def test_who_dies_of_itself_beside_what_is_planned_is_still_dealt_with(tmp_path: Path) -> None:
    """A command centre that dies unplanned fails the run, whatever the scenario does to others."""
    launcher, out = started(tmp_path, (2, "kill", "infra_1"), (3, "pause", "infra_2"))
    try:
        paused(out, "infra_2")
        nodes = json.loads((out / "run.json").read_text())["nodes"]
        os.kill(nodes["command_center"]["pid"], signal.SIGKILL)
        output, _ = launcher.communicate(timeout=30)
    finally:
        launcher.kill()
        launcher.communicate()
    assert output.split() == [b"failed"]
    record = json.loads((out / "run.json").read_text())
    assert "command_center killed by signal 9" in record["message"]
    assert record["nodes"]["infra_1"]["ended"].startswith("killed by the scenario")
