"""Replays on a mesh, started like a user does."""

import json
from pathlib import Path

import pytest
from launched import MAST
from tiny_world import tiny

from mast_zenoh.launch import replay
from mast_zenoh.launch import run as launcher
from mast_zenoh.run_folder.recording.difference import compare

pytestmark = pytest.mark.mesh
FRAMES = 20


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An attacked run on lossy links, whose command centre is killed and restarted, recorded in one process."""

    def edit(content: dict) -> None:
        content["links"] = {"*": dict(up=[dict(type="Delay", mean_s=0.12), dict(type="Loss", probability=0.2)])}
        content["faults"] = [dict(type="Kill", at=0.8, restart_after=0.2, node="command_center")]

    resolved = tiny("uncoordinated", "attack_start_s=0.3", "n_adversaries=1", frames=FRAMES, edit=edit, record=True)
    run = launcher.run(resolved, tmp_path_factory.mktemp("recorded") / "run", runtime="inproc")
    assert run.error is None
    return run.folder


def test_one_process_and_a_secure_mesh_replay_each_other_to_the_last_byte(start, recorded, tmp_path) -> None:
    run = start(*MAST, "replay", str(recorded), "--secure", "--no-report", "--out")
    run.ended()
    on_mesh, record = run.out, run.record()
    assert (record["runtime"], record["security"], record["status"]) == ("mesh", "acl", "ok")
    assert len({node["pid"] for node in record["nodes"].values()}) == len(record["nodes"]), "one process each"
    pictures = compare(recorded, on_mesh, wires=("cc/picture",))
    assert (pictures.first, pictures.equal) == (None, FRAMES - 3)
    assert not compare(recorded, on_mesh, taps=True, ignore=("agent/*/mission",)).differing
    again = launcher.run(replay.resolve(on_mesh).resolved, tmp_path / "again", runtime="inproc")
    assert compare(on_mesh, again.folder, taps=True).first is None


def test_an_endless_paced_replay_ends_with_results_when_interrupted(start, recorded) -> None:
    command = (*MAST, "replay", str(recorded), "--loop", "--rate", "2", "--no-report", "--out")
    run = start(*command)
    run.until(run.recorded, "the recorder has started")
    run.until(lambda: (run.out / "messages.mcap").stat().st_size > 200_000, "the recording was repeated")
    run.interrupted()
    metrics = json.loads((run.out / "metrics.json").read_text())
    assert metrics["frames"] > FRAMES
    assert run.record()["mode"] == "realtime"
    assert (metrics["replay"]["repeats"], metrics["replay"]["frames"]) == (None, FRAMES)
