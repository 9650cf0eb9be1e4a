"""Nodes are inserted and removed during a run, invisibly to subscribers."""

import json
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from launched import Launched, Observer, eventually

from mast_zenoh.errors import NotRunning, StartError
from mast_zenoh.launch import live_interception
from mast_zenoh.mesh.protocol.traffic import ATTACHMENT
from mast_zenoh.run_folder.recording.reader import read

pytestmark = [pytest.mark.heavy, pytest.mark.mesh]
LIVE = Path(__file__).parents[1] / "support" / "live"
RELAY = str(LIVE / "relay.py")
TRACKS, DETECTIONS = "agent/infra_1/tracks", "agent/infra_1/detections"
TIMES = 6


@pytest.fixture
def going(launch) -> Iterator[Callable[..., tuple[Launched, Observer]]]:
    """A started run of the quiet scenario, and an observer of all keys."""
    observers: list[Observer] = []

    def begin(*arguments: str) -> tuple[Launched, Observer]:
        run: Launched = launch(str(LIVE / "quiet.py"), *arguments)
        observers.append(Observer(run.started()))
        eventually(lambda: observers[-1].frame() > 3, "frames are played")
        return run, observers[-1]

    yield begin
    for observer in observers:
        observer.close()


def stop(run: Launched) -> dict:
    """run.json of a run that was stopped."""
    run.interrupted()
    return run.record()


def test_insertions_and_removals_lose_duplicate_and_reorder_nothing_and_subscribers_see_nothing(going) -> None:
    """Many more of them are in the simulated runs."""
    run, observer = going("--mode", "lockstep")
    for i in range(TIMES):
        wire = (TRACKS, DETECTIONS)[i % 2]
        settings = ("keeps=True",) if i % 3 == 0 else ()
        change = live_interception.intercept(run.out, wire, RELAY, name="mallory", settings=settings)
        assert change["wires"] == [wire]
        reached = observer.frame() + 3
        eventually(lambda reached=reached: observer.frame() >= reached, "messages pass through the node")
        assert live_interception.release(run.out, name="mallory")["node"] == "mallory"
    record = stop(run)
    assert [change["action"] for change in record["interceptions"]] == ["intercept", "release"] * TIMES
    recorded = list(read(run.out))
    for wire in (TRACKS, DETECTIONS):
        numbers = [message.seq for message in recorded if message.key == wire]
        assert numbers == list(range(len(numbers)))
        tapped = [message.seq for message in recorded if message.tap and message.wire == wire]
        assert len(set(tapped)) == len(tapped) >= 3 * TIMES // 2, "it was on the wire"
        kinds = set()
        for sample in (sample for key, sample in observer.samples if key == wire):
            mark, _, _ = ATTACHMENT.unpack(sample.attachment.to_bytes())
            quality = (sample.priority, sample.congestion_control, sample.express)
            kinds.add(
                tuple(map(str, (mark, sample.encoding, *quality, sample.source_info, sample.timestamp, sample.kind)))
            )
        assert len(kinds) == 1, "with the node and without it"
    logs = "".join(path.read_text() for path in (run.out / "logs").iterdir())
    assert "may be lost" not in logs
    assert "Traceback" not in logs
    assert all(node["ended"].endswith("ok") for node in record["nodes"].values()), record["nodes"]


def mast(*arguments: str, cwd: Path) -> tuple[int, str]:
    """(exit code, output) of a command."""
    command = [sys.executable, "-m", "mast_zenoh", *arguments]
    process = subprocess.run(command, cwd=cwd, capture_output=True, text=True, check=False)
    return process.returncode, process.stdout + process.stderr


def test_the_commands_report_success_or_the_reason_for_failure_which_changes_nothing(going, tmp_path: Path) -> None:
    run, _ = going("--mode", "realtime", "--rate", "2")
    (tmp_path / "mine.py").write_text((LIVE / "relay.py").read_text())
    folder = str(run.out)
    code, output = mast("intercept", folder, "--wire", TRACKS, "--with", "mine.py", cwd=tmp_path)
    assert (code, output[: output.index(" from")]) == (0, f"mine_1 is on {TRACKS}"), output
    code, output = mast("intercept", folder, "--wire", "agent/infra_1/track", "--with", "mine.py", cwd=tmp_path)
    assert code == 11
    assert "did you mean 'agent/infra_1/tracks'?" in output
    code, output = mast("release", folder, "--wire", TRACKS, cwd=tmp_path)
    assert (code, output[: output.index(" from")]) == (0, f"mine_1 is off {TRACKS}"), output
    assert mast("release", folder, "--name", "mine_1", cwd=tmp_path)[0] == 11
    assert mast("release", folder, cwd=tmp_path)[0] == 2
    wiring, nodes = (run.out / "wiring.json").read_text(), json.loads((run.out / "scenario.json").read_text())["nodes"]
    relay = (LIVE / "relay.py").read_text()
    dies = "assert not os.path.exists('wiring.json'), 'no licence found'"
    (tmp_path / "stillborn.py").write_text(f"import os\n{relay.replace('self.keeps = keeps', dies)}")
    with pytest.raises(StartError, match=r"exit code 1.*logs/stillborn_1\.log"):
        live_interception.intercept(run.out, TRACKS, str(tmp_path / "stillborn.py"))
    secret = (run.out / "control.key").read_bytes()
    (run.out / "control.key").write_bytes(b"guessed")
    with pytest.raises(Exception, match="not sealed with this run's secret"):
        live_interception.intercept(run.out, TRACKS, RELAY)
    (run.out / "control.key").write_bytes(secret)
    assert (run.out / "wiring.json").read_text() == wiring
    assert json.loads((run.out / "scenario.json").read_text())["nodes"] == nodes
    stop(run)
    assert not (run.out / "control.key").exists()
    code, output = mast("intercept", folder, "--wire", TRACKS, "--with", "mine.py", cwd=tmp_path)
    assert code == 26
    assert "the run is over" in output


@pytest.mark.parametrize("mode", ["lockstep", "realtime"])
def test_a_lidar_that_is_attacked_during_a_run_loses_points_and_the_recording_has_them(launch, mode: str) -> None:
    sparse = ("lidar=VLP-16", "n_infrastructure=0", "n_mobile=0", "attack=none")
    pace = ("--rate", "0.4") if mode == "realtime" else ()
    run = launch("spoofed", "--mode", mode, *pace, *(word for each in sparse for word in ("--set", each)))
    run.at_frame(5)
    settings = ("attack.start_s=0", "attack.place=None", "attack.sector_deg=60")
    change = live_interception.intercept(run.out, "agent/ego/points", "HighFrequencyRemoval", settings=settings)
    assert change["wires"] == ["agent/ego/points"]
    run.at_frame(change["frame"] + 12)
    live_interception.release(run.out, name=change["node"])
    record = stop(run)
    assert record["recording"] == {"complete": True}
    scans: dict[int, dict[bool, bytes]] = {}
    for message in read(run.out):
        if message.message == "points":
            assert message.wire == "agent/ego/points"
            scans.setdefault(message.frame, {})[message.tap] = message.payload
    assert min(scans) == change["frame"], "before, points are not recorded"
    assert sum(legs[True] != legs[False] for legs in scans.values()) >= 2
    effects = pq.read_table(run.out / "attacks.parquet").to_pylist()
    removed = [row for row in effects if row["effect"] == "removed"]
    assert {row["interposer"] for row in removed} == {change["node"]}
    assert sum(row["points"] for row in removed) > 10
    assert {row["frame"] for row in removed} <= set(scans)


def test_commands_do_not_wait_for_a_run_whose_launcher_was_killed(going) -> None:
    run, _ = going("--mode", "realtime", "--rate", "2")
    run.kill()
    with pytest.raises(NotRunning, match="the run is over: killed"):
        live_interception.intercept(run.out, TRACKS, RELAY)
