"""Nodes are inserted and removed during a run, invisibly to subscribers."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path

import pytest
from launched import Launched, Observer, eventually

from mast_zenoh.errors import NotRunning, StartError
from mast_zenoh.launch import live_interception
from mast_zenoh.launch.tables import read_table
from mast_zenoh.messagelog.reader import read
from mast_zenoh.messages import codec
from mast_zenoh.runtime.protocol.traffic import ATTACHMENT

pytestmark = [pytest.mark.heavy, pytest.mark.mesh]
LIVE = Path(__file__).parents[1] / "support" / "live"
RELAY = str(LIVE / "relay.py")
TRACKS, DETECTIONS = "agent/infra_1/tracks", "agent/infra_1/detections"
TIMES = 50


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
    run.process.send_signal(signal.SIGINT)
    code, output = run.end()
    assert code == 130, output
    return run.record()


def gaps(numbers: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """Gaps between frames in a list of (number, frame), which must be ordered."""
    assert all(before[0] < after[0] for before, after in pairwise(numbers)), "in order, without duplicates"
    return [(before[1], after[1]) for before, after in pairwise(numbers) if after[0] > before[0] + 1]


def lost(run: Launched, observer: Observer) -> list[tuple[str, str, list[tuple[int, int]]]]:
    """Gaps in the intercepted wires by hearer, unless it was congested at the time; asserts the order."""
    recorded = [(m.key, (m.seq, m.frame)) for m in read(run.out) if not m.tap]
    types = {wire["key"]: wire["message"] for wire in json.loads((run.out / "wiring.json").read_text())["wires"]}
    seen = []
    for key, sample in observer.samples:
        header = codec.decode_header(sample.payload.to_bytes(), types[key])
        seen.append((key, (header.seq, header.frame)))
    table = read_table(run.out / "results" / "evaluator" / "heard.parquet")
    heard = list(zip(table["wire"], zip(table["seq"].tolist(), table["frame"].tolist(), strict=True), strict=True))
    all_gaps = [
        (hearer, wire, gaps([number for key, number in messages if key == wire]))
        for hearer, messages in (("stranger", seen), ("recorder", recorded), ("evaluator", heard))
        for wire in sorted({key for key, _ in messages})
    ]
    heard_by = [(hearer, wire) for hearer, wire, _ in all_gaps if wire in (TRACKS, DETECTIONS)]
    assert len(heard_by) == 5, "all three receive them, except detections, which the evaluator does not need"
    # In real time, messages to a congested hearer are dropped, on all wires. Those nobody has touched show when it was.
    congested = {hearer: [] for hearer, _, _ in all_gaps}
    for hearer, wire, missing in all_gaps:
        congested[hearer] += [] if wire in (TRACKS, DETECTIONS) else missing
    return [
        (hearer, wire, left)
        for hearer, wire, missing in all_gaps
        if wire in (TRACKS, DETECTIONS)
        and (left := [gap for gap in missing if not any(overlap(gap, other) for other in congested[hearer])])
    ]


def kinds(observer: Observer, wire: str) -> set[tuple[str, ...]]:
    """What a subscriber of a wire sees of its messages besides their content; asserts that no step is too early.

    When they come is not compared: in real time a busy machine makes steps late.
    """
    seen = set()
    for sample in (sample for key, sample in observer.samples if key == wire):
        frame = codec.decode_header(sample.payload.to_bytes(), wire.rpartition("/")[2]).frame
        mark, _, step = ATTACHMENT.unpack(sample.attachment.to_bytes())
        assert step >= frame
        quality = (sample.priority, sample.congestion_control, sample.express)
        kind = (mark, sample.encoding, *quality, sample.source_info, sample.timestamp, sample.kind)
        seen.add(tuple(map(str, kind)))
    return seen


def overlap(one: tuple[int, int], other: tuple[int, int]) -> bool:
    """Whether two ranges of frames meet."""
    return one[0] <= other[1] and other[0] <= one[1]


@pytest.mark.timeout(600)
def test_fifty_insertions_and_removals_lose_duplicate_and_reorder_nothing(going) -> None:
    run, observer = going("--mode", "realtime", "--rate", "2")
    for i in range(TIMES):
        wire = (TRACKS, DETECTIONS)[i % 2]
        settings = ("keeps=True",) if i % 5 == 0 else ()
        interceptions = live_interception.intercept(run.out, wire, RELAY, name="mallory", settings=settings)
        reached = observer.frame() + 3
        eventually(lambda reached=reached: observer.frame() >= reached, "messages pass through the node")
        assert interceptions["wires"] == [wire]
        assert live_interception.release(run.out, name="mallory")["node"] == "mallory"
    record = stop(run)
    assert [interceptions["action"] for interceptions in record["interceptions"]] == ["intercept", "release"] * TIMES
    taps = {wire: [m.seq for m in read(run.out) if m.tap and m.wire == wire] for wire in (TRACKS, DETECTIONS)}
    assert all(len(numbers) >= 2 * TIMES // 2 for numbers in taps.values()), "it was on the wires"
    assert all(len(set(numbers)) == len(numbers) for numbers in taps.values())
    assert not lost(run, observer)
    assert len(kinds(observer, TRACKS)) == len(kinds(observer, DETECTIONS)) == 1, "with the node and without it"
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


def test_commands_do_not_wait_for_a_run_whose_launcher_was_killed(going) -> None:
    run, _ = going("--mode", "realtime", "--rate", "2")
    run.kill()
    with pytest.raises(NotRunning, match="the run is over: killed"):
        live_interception.intercept(run.out, TRACKS, RELAY)
