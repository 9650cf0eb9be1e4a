"""However a run ends, no process remains and its results are readable; what a terminal shows of it is measured."""

import json
import os
import signal
import sys
import threading
from itertools import dropwhile
from pathlib import Path

import held_back
import psutil
import pytest
from drawn_statuses import console, drawn_statuses, evaluated
from endings_table import ending
from held_back import allow
from launched import Launched, eventually

from mast_zenoh import scenario
from mast_zenoh.launch import run as launcher
from mast_zenoh.launch.liveness import current_record
from mast_zenoh.run_folder.recording.reader import read

pytestmark = [pytest.mark.heavy, pytest.mark.mesh]

#: Fewer agents than usual, because how a run ends does not depend on their number.
BASELINE = ("baseline", "--set", "n_infrastructure=2")


def suspend(run: Launched, seconds: float) -> None:
    """Suspend the launcher, and with it the router, for a while."""
    run.process.send_signal(signal.SIGSTOP)
    eventually(lambda: psutil.Process(run.process.pid).status() == psutil.STATUS_STOPPED, "the launcher is suspended")
    threading.Event().wait(seconds)
    run.process.send_signal(signal.SIGCONT)


SHORT = "launcher suspended for less than 20 s and resumed, lock-step (Ctrl-Z, SIGSTOP)"


def test_a_suspended_launcher_resumes_a_lock_step_run_without_effect(launch) -> None:
    run: Launched = launch(*BASELINE, "--frames", "60")
    run.at_frame(15)
    suspend(run, 4.0)
    code, output = run.end()
    assert (run.record()["status"], code) == ending(SHORT)
    assert "Traceback" not in output
    assert run.record()["churn"] == []
    assert {message.frame for message in read(run.out)} == set(range(60))


def test_a_launcher_suspended_too_long_in_real_time_names_lost_nodes(launch) -> None:
    run: Launched = launch(*BASELINE, "--mode", "realtime", "--frames", "80")
    run.at_frame(15)
    suspend(run, 4.0)
    code, output = run.end()
    what = "launcher suspended for more than 2 s and resumed, real time"
    assert (run.record()["status"], code) == ending(what), output
    assert "Traceback" not in output
    assert "lost" in {each["what"] for each in run.record()["churn"]}
    list(read(run.out))


def test_a_launcher_suspended_too_long_fails_a_run_with_remote_nodes(start, tmp_path) -> None:
    allow(tmp_path / "run_0", 20)
    run = start(sys.executable, held_back.__file__, "baseline", PYTHONPATH=os.pathsep.join(sys.path))
    run.at_frame(20)
    suspend(run, 4.0)
    allow(run.out, 1000)
    code, output = run.end()
    what = "launcher suspended for more than 2 s and resumed, lock-step, nodes elsewhere"
    assert (run.record()["status"], code) in (ending(what), ("node_lost", 33)), output
    assert "lost" in {each["what"] for each in run.record()["churn"]}
    list(read(run.out))


@pytest.mark.parametrize("stage", ["starting", "collecting"])
def test_a_launcher_killed_at_either_end_of_a_run_leaves_no_nodes_running(start, stage, tmp_path) -> None:
    mast = (sys.executable, str(Path(__file__).parents[1] / "support" / "at_stage.py"), stage, "SIGKILL", "--")
    run = start(*mast, "run", *BASELINE, "--frames", "30", "--no-report", "--out")
    code, output = run.end()
    assert code == -signal.SIGKILL
    assert "Traceback" not in output

    def left() -> list[psutil.Process]:
        processes = psutil.process_iter(["cmdline", "status"])
        ended = psutil.STATUS_ZOMBIE
        return [p for p in processes if p.info["status"] != ended and str(run.out) in (p.info["cmdline"] or ())]

    eventually(lambda: not left(), "all nodes have left", seconds=20.0)
    assert stage == "starting" or current_record(run.record())["status"] == "killed"
    if (run.out / "messages.mcap").is_file():
        list(read(run.out))


def test_nodes_that_fill_the_disk_fail_the_run(launch, tiny_disk: Path, tmp_path: Path) -> None:
    (tmp_path / "run_0").symlink_to(tiny_disk)
    code, output = launch(*BASELINE, "--frames", "150").end()
    record = json.loads((tiny_disk / "run.json").read_text())
    assert (record["status"], code) == ending("disk full while the scene is played"), output
    assert "messages.mcap: cannot be written: No space left on device" in output
    assert "Traceback" not in output
    assert record["recording"]["complete"] is False
    list(read(tiny_disk))


SILENT = {"evaluator", "recorder"}


@pytest.mark.parametrize(("mode", "secure", "frames"), [("lockstep", "acl", 120), ("realtime", "open", 60)])
def test_rates_lags_and_the_score_are_those_of_the_run(monkeypatch, tmp_path, mode, secure, frames) -> None:
    drawn = drawn_statuses(monkeypatch)
    path, loaded = scenario.load(
        "coordinated", ("n_infrastructure=2", "n_adversaries=1", f"attack_start_s={frames / 20}")
    )
    resolved = scenario.resolve(path, loaded, frames=frames, mode=mode, rate=2.0, record=True)
    ended = launcher.run(resolved, tmp_path / "run", secure=secure, console=console(80))
    assert ended.error is None
    playing = [each for each in drawn if each.activities]
    heard = [each for each in playing if all(each.activities[name].drops is not None for name in ("ego", "broker"))]
    for name in resolved.nodes.keys() - SILENT:
        activities = [each.activities[name] for each in playing]
        assert any(each.rate_hz for each in activities), name
        assert min(each.lag for each in activities if each.lag is not None) <= 1, name
    assert all(each.activities[name].rate_hz is None for each in playing for name in SILENT)
    if mode == "lockstep":
        assert all(each.activities[name].drops == 0 for each in heard for name in ("simulator", "ego", "broker"))
    states = {
        (each.frame > frames // 2, each.states["adversary_1"]) for each in playing if each.states["ego"] == "running"
    }
    assert states >= {(False, "running"), (True, "attack")}
    expected = evaluated(ended.folder)
    scores = [each.score for each in playing if each.score is not None]
    assert len({each.frame for each in scores}) > 3
    assert all(each[2:5] == expected[each.frame] for each in scores)
    # The scores begin while the scene is played: the clock of the first pictures may have gone by.
    latencies = list(dropwhile(lambda latency: latency is None, (each.latency_ms for each in scores)))
    assert bool(latencies) == (mode == "realtime")
    assert all(latency is not None and latency > 0.0 for latency in latencies)
