"""Killed, started and paused processes on the mesh: as in one process."""

import signal
import sys
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import psutil
import pytest
from equal_runs import assert_equal
from launched import Launched, Observer, alive, eventually
from simulated_runs import CHURN, resolve

from mast_zenoh.config.resolved import Resolved
from mast_zenoh.launch import run as launcher
from mast_zenoh.messages import codec
from mast_zenoh.run_folder.recording.reader import read

pytestmark = pytest.mark.mesh


def resolved(*steps: tuple[int, str, str], **options: object) -> Resolved:
    return resolve("coordinated", "n_infrastructure=3", "attack_start_s=0.2", steps=steps, **options)


def frames_of(folder: Path, key: str) -> list[int]:
    return [message.frame for message in read(folder) if message.key == key]


def test_in_lock_step_the_mesh_equals_one_process_despite_kills_and_restarts(tmp_path: Path) -> None:
    what = resolved(*CHURN, frames=16)
    mesh = launcher.run(what, tmp_path / "mesh")
    assert mesh.error is None, mesh.error
    inproc = launcher.run(what, tmp_path / "inproc", runtime="inproc")
    assert inproc.error is None
    assert_equal(mesh.folder, inproc.folder)
    done = [{"frame": frame, "action": action, "node": node} for frame, action, node in CHURN]
    in_order = sorted(done, key=lambda step: (step["frame"], step["action"] == "start", step["node"]))
    assert mesh.record["steps"] == inproc.record["steps"] == in_order
    for record in (mesh.record, inproc.record):
        assert record["status"] == "ok"
        assert record["message"] == "", "planned changes are not reported"
        assert record["nodes"]["infra_2"]["ended"].startswith("killed by the")
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
        "from mast_zenoh.config.resolved import ProcessStep\n"
        "from mast_zenoh.launch import run as launcher\n"
        "path, loaded = scenario.load('baseline', ['n_infrastructure=2'])\n"
        "found = scenario.resolve(path, loaded, mode='realtime', rate=1.0, record=True)\n"
        "steps = tuple(ProcessStep(*step) for step in {steps!r})\n"
        "ended = launcher.run(replace(found, steps=steps), Path(sys.argv[1]))\n"
        "print(ended.record['status'])\n"
    )
    return lambda *steps: start(sys.executable, "-c", code.format(steps=steps))


def test_in_real_time_killed_nodes_restart_and_paused_nodes_resume(launch) -> None:
    steps = ((5, "kill", "infra_1"), (5, "pause", "infra_2"), (8, "resume", "infra_2"), (8, "start", "infra_1"))
    run: Launched = launch(*steps)
    with closing(Observer(run.started(), "agent/*/tracks")) as observer:

        def newest(agent: str) -> int:
            heard = [s for key, s in observer.samples if key == f"agent/{agent}/tracks"]
            return codec.decode(heard[-1].payload.to_bytes(), "tracks").header.frame if heard else -1

        eventually(lambda: newest("infra_1") > 8 and newest("infra_2") > 8, "both nodes have returned")
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


def test_a_killed_launcher_leaves_no_node_not_even_a_paused_one_and_a_readable_recording(launch) -> None:
    run: Launched = launch((30, "pause", "infra_1"))
    paused = psutil.Process(run.started()["nodes"]["infra_1"]["pid"])
    eventually(lambda: paused.status() == psutil.STATUS_STOPPED, "infra_1 is suspended")
    pids = run.pids()
    run.process.send_signal(signal.SIGKILL)
    run.end(30.0)
    eventually(lambda: not alive(pids), "all nodes have left", seconds=5.0)
    clocks = frames_of(run.out, "clock")
    assert clocks == list(range(len(clocks)))
    assert len(clocks) >= 12, "a recorder on a busy machine lags, but by less than half of the run"
