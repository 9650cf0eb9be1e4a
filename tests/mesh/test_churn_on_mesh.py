"""Killed, started and paused processes on the mesh: as in one process."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import psutil
import pytest
from launched import Launched, Observer, alive, eventually

from mast_zenoh import scenario
from mast_zenoh.config.process_steps import ProcessStep
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.launch import run as launcher
from mast_zenoh.messagelog.difference import compare
from mast_zenoh.messagelog.explain import explain
from mast_zenoh.messagelog.reader import read
from mast_zenoh.messages import codec

pytestmark = pytest.mark.mesh

#: One after the other, and two at once; some return, one joins late, one never returns.
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
    resolved_scenario = scenario.resolve(path, loaded, frames=frames, record=True, **options)
    return replace(resolved_scenario, steps=tuple(ProcessStep(*step) for step in steps))


def frames_of(folder: Path, key: str) -> list[int]:
    return [message.frame for message in read(folder) if message.key == key]


def test_in_lock_step_the_mesh_equals_one_process_despite_kills_and_restarts(tmp_path: Path) -> None:
    what = resolved(*STEPS, frames=16)
    mesh = launcher.run(what, tmp_path / "mesh")
    assert mesh.error is None, mesh.error
    inproc = launcher.run(what, tmp_path / "inproc", runtime="inproc")
    assert inproc.error is None
    difference = compare(mesh.folder, inproc.folder, taps=True)
    assert difference.first is None, "\n".join(explain(difference))
    assert difference.equal == len(list(read(mesh.folder)))
    assert (mesh.folder / "metrics.json").read_bytes() == (inproc.folder / "metrics.json").read_bytes()
    assert frames_of(mesh.folder, "agent/infra_1/tracks/@tap/0") == [0, 1, 2, *range(5, 16)]
    assert frames_of(mesh.folder, "agent/infra_1/tracks") == [0, 1, 2, 5, *range(10, 16)], "its adversary was away"
    assert frames_of(mesh.folder, "agent/infra_3/tracks") == list(range(2, 16))
    done = [{"frame": frame, "action": action, "node": node} for frame, action, node in STEPS]
    in_order = sorted(done, key=lambda step: (step["frame"], step["action"] == "start", step["node"]))
    assert mesh.record["steps"] == inproc.record["steps"] == in_order
    for record in (mesh.record, inproc.record):
        assert record["status"] == "ok"
        assert record["message"] == "", "planned changes are not reported"
        assert record["nodes"]["infra_2"]["ended"].startswith("killed by the scenario")
        assert record["nodes"]["ego"]["exit"] == 0
        assert {name for name, node in record["nodes"].items() if node["restarts"]} == {
            "infra_1",
            "adversary_1",
            "command_center",
            "broker",
            "ego",
        }


@pytest.fixture
def launch(start: Callable[..., Launched]) -> Callable[..., Launched]:
    """Starts real-time runs, longer than any test, with these process steps."""
    code = (
        "import sys\n"
        "from dataclasses import replace\n"
        "from pathlib import Path\n"
        "from mast_zenoh import scenario\n"
        "from mast_zenoh.config.process_steps import ProcessStep\n"
        "from mast_zenoh.launch import run as launcher\n"
        "path, loaded = scenario.load('baseline', ['n_infrastructure=2'])\n"
        "found = scenario.resolve(path, loaded, mode='realtime', rate=0.5, record=True)\n"
        "steps = tuple(ProcessStep(*step) for step in {steps!r})\n"
        "ended = launcher.run(replace(found, steps=steps), Path(sys.argv[1]))\n"
        "print(ended.record['status'])\n"
    )
    return lambda *steps: start(sys.executable, "-c", code.format(steps=steps))


def test_in_real_time_killed_nodes_restart_and_paused_nodes_resume(launch) -> None:
    steps = ((5, "kill", "infra_1"), (5, "pause", "infra_2"), (8, "resume", "infra_2"), (8, "start", "infra_1"))
    run: Launched = launch(*steps)
    observer = Observer(run.started(), "agent/*/tracks")
    try:

        def newest(agent: str) -> int:
            heard = [s for key, s in observer.samples if key == f"agent/{agent}/tracks"]
            return codec.decode(heard[-1].payload.to_bytes(), "tracks").header.frame if heard else -1

        eventually(lambda: newest("infra_1") > 8 and newest("infra_2") > 8, "both nodes have returned")
    finally:
        observer.close()
    run.process.send_signal(signal.SIGINT)
    _, output = run.end(30.0)
    assert output.split() == ["interrupted"]
    record = run.record()
    assert {name: node["restarts"] for name, node in record["nodes"].items() if node["restarts"]} == {"infra_1": 1}
    assert all(node["exit"] == 0 for node in record["nodes"].values()), record["nodes"]
    assert sorted(tuple(step.values()) for step in record["steps"]) == sorted(steps)
    heard = frames_of(run.out, "agent/infra_1/tracks")
    assert heard[:5] == list(range(5)), "it was killed when frame 5 was due"
    assert min(frame for frame in heard if frame > 5) >= 8
    clocks = frames_of(run.out, "clock")
    assert clocks == list(range(len(clocks))), "the clock was not delayed"


def wait_until_paused(run: Launched, node: str) -> None:
    """Wait until a node is suspended."""
    process = psutil.Process(run.started()["nodes"][node]["pid"])
    eventually(lambda: process.status() == psutil.STATUS_STOPPED, f"{node} is suspended")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL], ids=["Ctrl-C", "killed launcher"])
def test_a_paused_node_never_outlives_its_run(launch, number: signal.Signals) -> None:
    run: Launched = launch((2, "pause", "infra_1"))
    wait_until_paused(run, "infra_1")
    pids = run.pids()
    run.process.send_signal(number)
    _, output = run.end(30.0)
    eventually(lambda: not alive(pids), "all nodes have left", seconds=5.0)
    if number == signal.SIGINT:
        assert output.split() == ["interrupted"]
        ended = {node["ended"] for node in run.record()["nodes"].values()}
        assert ended == {"ok"}, "it was resumed and returned its results"


def test_a_node_still_paused_at_the_end_is_resumed(tmp_path: Path) -> None:
    outcome = launcher.run(resolved((5, "pause", "infra_1"), frames=10, mode="realtime", rate=2.0), tmp_path / "run")
    assert outcome.error is None, outcome.error
    assert outcome.record["nodes"]["infra_1"]["ended"] == "ok"


def test_an_unplanned_death_among_planned_ones_is_handled(launch) -> None:
    """An unplanned death of the command centre fails the run despite planned ones."""
    run: Launched = launch((2, "kill", "infra_1"), (3, "pause", "infra_2"))
    wait_until_paused(run, "infra_2")
    os.kill(run.record()["nodes"]["command_center"]["pid"], signal.SIGKILL)
    _, output = run.end(30.0)
    assert output.split() == ["failed"]
    record = run.record()
    assert "command_center killed by signal 9" in record["message"]
    assert record["nodes"]["infra_1"]["ended"].startswith("killed by the scenario")
