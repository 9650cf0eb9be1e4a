"""Runs on the mesh are bitwise equal to each other and to one process."""

from __future__ import annotations

import json
import os
import signal
import tarfile
from pathlib import Path

import pytest
from launched import Launched, Observer, eventually

from mast_zenoh import scenario
from mast_zenoh.launch import run as launcher
from mast_zenoh.messagelog.difference import compare
from mast_zenoh.messagelog.explain import explain
from mast_zenoh.messagelog.reader import read

pytestmark = pytest.mark.mesh
DATA = Path(os.environ.get("MAST_DATA") or Path(__file__).parents[3] / "shared" / "data")
FRAMES = 8


def in_process(out: Path, name: str, *settings: str) -> Path:
    """The same run in one process."""
    path, loaded = scenario.load(name, settings)
    outcome = launcher.run(scenario.resolve(path, loaded, frames=FRAMES, record=True), out, runtime="inproc")
    assert outcome.error is None
    return outcome.folder


def on_mesh(launch, name: str, *settings: str) -> Path:
    """The run folder of a fully recorded run on the mesh."""
    words = [word for setting in settings for word in ("--set", setting)]
    run: Launched = launch(name, "--frames", str(FRAMES), *words)
    code, output = run.end()
    assert code == 0, output
    assert run.record()["recorded"] == {"messages": len(list(read(run.out))), "malformed": 0, "lost": 0}
    return run.out


def assert_equal(a: Path, b: Path, *, taps: bool = True) -> None:
    difference = compare(a, b, taps=taps)
    assert difference.first is None, "\n".join(explain(difference))
    assert difference.equal == sum(taps or not message.tap for message in read(a)) > 0


def test_two_runs_on_the_mesh_and_one_in_one_process_are_equal(launch, tmp_path: Path) -> None:
    what = ("coordinated", "n_infrastructure=5", "n_adversaries=2", "attack_start_s=0.2")
    first, second = on_mesh(launch, *what), on_mesh(launch, *what)
    assert any(message.message == "attack_report" for message in read(first)), "a difference could show"
    assert_equal(first, second)
    assert_equal(first, in_process(tmp_path / "inproc", *what))


def test_interposers_that_change_nothing_leave_no_trace_in_the_recording(launch, tmp_path: Path) -> None:
    tapped = on_mesh(launch, "passthrough", "n_infrastructure=2")
    assert_equal(in_process(tmp_path / "plain", "baseline", "n_infrastructure=2"), tapped, taps=False)
    assert_equal(in_process(tmp_path / "tapped", "passthrough", "n_infrastructure=2"), tapped)


OWN_PIPELINE = """
import numpy as np

from mast_zenoh.config import loading
from mast_zenoh.pipelines import Pipeline

_, baseline = loading.function("scenarios", "baseline", "scenario")


class EveryTrack(Pipeline):
    def step(self, time_ns, states, agent, agents, weights=None):
        order = np.lexsort((states.id, np.array(agents)[agent]))
        return states.select(order).with_(id=np.arange(len(states))), np.ones(len(states), np.int64)

    def reset(self):
        pass


def scenario():
    made = baseline(n_infrastructure=1)
    del made["command_center"]
    return made | dict(commandcenter=dict(pipeline=dict(type="EveryTrack")))
"""


def test_a_user_defined_pipeline_gives_the_same_pictures_on_the_mesh_and_in_one_process(launch, tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(OWN_PIPELINE)
    run = on_mesh(launch, str(tmp_path / "mine.py"))
    assert not any(node.get("failures") for node in json.loads((run / "run.json").read_text())["nodes"].values())
    assert_equal(run, in_process(tmp_path / "inproc", str(tmp_path / "mine.py")))
    assert sum(message.wire == "cc/picture" for message in read(run)) == FRAMES


LISTENING = """
from mast_zenoh.config import loading

_, baseline = loading.function("scenarios", "baseline", "scenario")


def scenario(folder=""):
    every = dict(wire="agent/*/tracks", role="defence", input="tracks")
    guard = dict(role="defence", file=folder + "/guard.py")
    return baseline(n_infrastructure=2) | dict(
        adversaries=dict(
            shadow=dict(file=folder + "/shadow.py", agent="infra_1", heard=["ego", "infra_1", "infra_2"]),
            eve=dict(agent="infra_2", attack=dict(type="UncoordinatedAttack", start_s=0.2)),
        ),
        nodes=dict(guard=guard, source_guard=guard),
        keyexpr=dict(
            rewrites=[
                "on_detections.toml",
                {"listen": [dict(wire="agent/*/pose", role="adversary", input="poses", node="shadow")]},
                {"listen": [every | dict(node="guard"), every | dict(node="source_guard", leg="source")]},
            ]
        ),
    )
"""


def test_listeners_receive_the_same_on_the_mesh_and_in_one_process(launch, tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(LISTENING)
    what = (str(tmp_path / "mine.py"), f"folder={Path(__file__).parents[1] / 'support'}")
    run = on_mesh(launch, *what)
    assert not any(node.get("failures") for node in json.loads((run / "run.json").read_text())["nodes"].values())
    assert_equal(run, in_process(tmp_path / "inproc", *what))
    before, after = (
        [m.payload for m in read(run) if m.key == f"agent/infra_1/detections{leg}"] for leg in ("/@tap/0", "")
    )
    assert len(before) == len(after) == FRAMES
    assert not set(before) & set(after), "every pose was received, so every message was changed"


def test_the_reference_scene_is_the_same_on_the_mesh_and_in_one_process(launch, tmp_path: Path) -> None:
    archive = DATA / "scene_a.tar.gz"
    if not archive.exists():
        pytest.skip(f"no reference data: {archive} is missing (set MAST_DATA)")
    with tarfile.open(archive) as tar:
        tar.extractall(tmp_path, filter="data")
    what = ("uncoordinated", f"scene=avstack:{tmp_path / 'scene_a'}", "attack_start_s=0.2")
    assert_equal(on_mesh(launch, *what), in_process(tmp_path / "inproc", *what))


def test_a_real_log_is_the_same_on_the_mesh_and_in_one_process(launch, tmp_path: Path) -> None:
    logs = sorted((DATA / "av2_logs").glob("*/city_SE3_egovehicle.feather"))
    if not logs:
        pytest.skip(f"no reference data: no log in {DATA / 'av2_logs'} (set MAST_DATA)")
    what = ("uncoordinated", f"scene=av2:{logs[0].parent}", "n_infrastructure=1", "n_adversaries=1")
    assert_equal(on_mesh(launch, *what), in_process(tmp_path / "inproc", *what))


@pytest.mark.parametrize("victim", ["launcher", "recorder"])
def test_the_recording_is_readable_whichever_node_is_killed(launch, tmp_path: Path, victim: str) -> None:
    run: Launched = launch("baseline", "--set", "n_infrastructure=1", "--mode", "realtime", "--rate", "6")
    record = run.started()
    observer = Observer(record, "clock")
    try:
        eventually(lambda: observer.frame() >= 60, "60 clocks")
    finally:
        observer.close()
    if victim == "launcher":
        run.kill()
        eventually(
            lambda: (run.out / "messages.mcap").read_bytes().endswith(b"MCAP0\r\n"), "the recorder has closed its file"
        )
    else:
        os.kill(record["nodes"]["recorder"]["pid"], signal.SIGKILL)
        assert run.end()[0] == 22, "a run that can no longer be recorded has failed"
    frames = [message.frame for message in read(run.out) if message.key == "clock"]
    assert frames == list(range(len(frames)))
    assert len(frames) >= 25, "a recorder on a busy machine lags, but by less than half of the run"
