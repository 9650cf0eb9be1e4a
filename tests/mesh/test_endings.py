"""However a run ends, nothing is left running, and what it has found up to then can be read."""

from __future__ import annotations

import json
import os
import signal
from pathlib import Path

import pytest
from launched import Launched, Observer, alive, eventually

from mast_zenoh import codec

pytestmark = pytest.mark.mesh

#: Slow enough to be in the middle of it, quick enough for a test.
PACED = ("--mode", "realtime", "--rate", "3", "--frames", "60")


def at_frame(run: Launched, frame: int) -> dict:
    """run.json, when the run has come to a frame."""
    record = run.started()
    observer = Observer(record, "clock")
    try:
        eventually(lambda: observer.frame() >= frame, f"{frame} clocks")
    finally:
        observer.close()
    return record


@pytest.mark.parametrize("mode", [PACED, ("--frames", "150", "--allow-churn")], ids=["real time", "lock-step"])
def test_a_killed_agent_does_not_end_the_run(launch, mode: tuple[str, ...]) -> None:
    run: Launched = launch("baseline", *mode)
    record = at_frame(run, 15)
    os.kill(record["nodes"]["infra_2"]["pid"], signal.SIGKILL)
    code, output = run.end()
    assert code == 0, output
    record = run.record()
    assert record["status"] == "ok"
    assert record["nodes"]["infra_2"]["ended"] == "killed by signal 9 (SIGKILL)"
    assert record["nodes"]["infra_1"]["ended"] == "ok"
    assert "infra_2" in record["message"]
    assert "infra_2 killed by signal 9" in output
    assert json.loads((run.out / "metrics.json").read_text())["frames"] == record["frames"]


def test_an_agent_whose_policy_is_restart_comes_back_at_the_current_frame(launch, tmp_path: Path) -> None:
    (tmp_path / "phoenix.py").write_text(
        "from mast_zenoh import loading\n"
        "_, baseline = loading.function('scenarios', 'baseline', 'scenario')\n"
        "def scenario():\n"
        "    made = baseline()\n"
        "    return made | dict(agents=made['agents'] | dict(infra_2=made['agents']['*'] | dict(on_exit='restart')))\n"
    )
    run: Launched = launch(str(tmp_path / "phoenix.py"), "--mode", "realtime", "--frames", "100")
    record = at_frame(run, 15)
    observer = Observer(record, "agent/infra_2/tracks")
    try:
        eventually(lambda: observer.samples, "infra_2 speaks")
        os.kill(record["nodes"]["infra_2"]["pid"], signal.SIGKILL)
        code, output = run.end()
    finally:
        observer.close()
    assert code == 0, output
    node = run.record()["nodes"]["infra_2"]
    assert node["restarts"] == 1
    assert node["pid"] != record["nodes"]["infra_2"]["pid"]
    assert node["last_frame"] == 99, "it took part to the end"
    frames = [codec.decode(sample.payload.to_bytes(), "tracks").header.frame for _, sample in observer.samples]
    assert frames == sorted(frames)
    assert frames[-1] == 99
    assert len(frames) < 100 - frames[0], "frames went by while it was away"


def test_a_dead_command_centre_fails_the_run_with_its_own_exit_code(launch) -> None:
    run: Launched = launch("baseline", *PACED)
    record = at_frame(run, 10)
    os.kill(record["nodes"]["command_center"]["pid"], signal.SIGKILL)
    code, output = run.end()
    assert code == 22, output
    assert "command_center killed by signal 9" in output
    record = run.record()
    assert record["status"] == "failed"
    assert (run.out / "metrics.json").is_file(), "what was found up to then is kept"


def test_who_drives_a_scene_that_nobody_else_is_left_to_see_does_not_play_on(launch, tmp_path: Path) -> None:
    (tmp_path / "alone.py").write_text(
        "from mast_zenoh import loading\n"
        "_, baseline = loading.function('scenarios', 'baseline', 'scenario')\n"
        "def scenario():\n"
        "    roles = ('broker', 'command_center', 'evaluator')\n"
        "    made = baseline()\n"
        "    made |= {role: made[role] | dict(on_exit='continue') for role in roles}\n"
        "    return made | dict(run=dict(record=False))\n"
    )
    run: Launched = launch(str(tmp_path / "alone.py"))
    record = at_frame(run, 5)
    for name, node in record["nodes"].items():
        if name != "simulator":
            os.kill(node["pid"], signal.SIGKILL)
    code, output = run.end()
    assert code == 23, output
    assert "nobody else is on the mesh" in output


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_run_that_is_stopped_keeps_what_it_has(launch, number: signal.Signals) -> None:
    run: Launched = launch("baseline", *PACED)
    at_frame(run, 20)
    run.process.send_signal(number)
    code, output = run.end()
    assert code == 130, output
    record = run.record()
    assert record["status"] == "interrupted"
    assert all(node["exit"] == 0 for node in record["nodes"].values()), record["nodes"]
    assert 20 <= json.loads((run.out / "metrics.json").read_text())["frames"] < 60


def test_a_killed_launcher_takes_its_nodes_with_it(launch) -> None:
    run: Launched = launch("uncoordinated", *PACED)
    at_frame(run, 10)
    pids = run.pids()
    assert alive(pids) == pids
    run.kill()
    eventually(lambda: not alive(pids), "all nodes have left", seconds=5.0)
    assert run.record()["status"] == "running", "what was written before is readable"


def test_a_node_that_hangs_is_ended(launch, tmp_path: Path) -> None:
    run: Launched = launch("baseline", *PACED)
    record = at_frame(run, 5)
    os.kill(record["nodes"]["infra_3"]["pid"], signal.SIGSTOP)
    run.process.send_signal(signal.SIGINT)
    code, output = run.end()
    assert code == 130, output
    assert "kill" in run.record()["nodes"]["infra_3"]["ended"]


def test_a_node_that_cannot_start_is_named_with_its_last_words(launch, tmp_path: Path) -> None:
    (tmp_path / "broken.py").write_text(
        "import os\n"
        "from mast_zenoh.node import Node\n"
        "class Broken(Node):\n"
        "    role = 'adversary'\n"
        "    inputs = {'clock': 'clock'}\n"
        "    def __init__(self, agent: str):\n"
        "        if os.path.exists('wiring.json'):  # in the run folder: in its own process\n"
        "            raise SystemExit('no licence found')\n"
        "    def on_clock(self, received, context): ...\n"
    )
    (tmp_path / "mine.py").write_text(
        "from mast_zenoh import loading\n"
        "_, baseline = loading.function('scenarios', 'baseline', 'scenario')\n"
        "def scenario():\n"
        "    return baseline() | dict(adversaries=dict(mallory=dict(file='broken.py', agent='infra_1')))\n"
    )
    run: Launched = launch(str(tmp_path / "mine.py"), *PACED)
    code, output = run.end()
    assert code == 21, output
    assert "mallory ended before the first frame: exit code 1" in output
    assert "no licence found" in output
    others = [node["ended"] for name, node in run.record()["nodes"].items() if name != "mallory"]
    assert set(others) == {"ok"}, "also who was still starting has heard that it is to stop"


def test_a_folder_that_holds_something_is_not_written_into(launch, tmp_path: Path) -> None:
    (tmp_path / "run_0").mkdir()
    (tmp_path / "run_0" / "thesis.txt").write_text("precious")
    code, output = launch("baseline", *PACED).end()
    assert code == 15
    assert "is not empty" in output
    assert [path.name for path in (tmp_path / "run_0").iterdir()] == ["thesis.txt"]
