"""However a run ends, no process remains and its results are readable."""

from __future__ import annotations

import json
import os
import signal
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import held_back
import psutil
import pytest
from endings_table import ending
from held_back import allow
from launched import Launched, eventually

from mast_zenoh.launch.liveness import current_record
from mast_zenoh.run_folder.recording.reader import read

pytestmark = [pytest.mark.heavy, pytest.mark.mesh]

#: Fewer agents than usual, because how a run ends does not depend on their number.
BASELINE = ("baseline", "--set", "n_infrastructure=2")

#: Slow enough to be interrupted midway, fast enough for a test.
PACED = ("--mode", "realtime", "--rate", "3", "--frames", "60")


def test_a_second_signal_ends_nodes_at_once_and_leaves_a_readable_recording(launch) -> None:
    run: Launched = launch(*BASELINE, *PACED)
    run.at_frame(10)
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        run.process.send_signal(number)
    code, output = run.end()
    assert (run.record()["status"], code) == ending("second signal while the scene is played"), output
    assert "Traceback" not in output
    list(read(run.out))


def test_a_signal_while_nodes_start_ends_them(launch) -> None:
    run: Launched = launch(*BASELINE, *PACED)
    run.started()
    run.process.send_signal(signal.SIGINT)
    code, output = run.end()
    assert (run.record()["status"], code) == ending("signal while nodes start"), output
    assert "Traceback" not in output


def suspend(run: Launched, seconds: float) -> None:
    """Suspend the launcher, and with it the router, for a while."""
    run.process.send_signal(signal.SIGSTOP)
    eventually(lambda: psutil.Process(run.process.pid).status() == psutil.STATUS_STOPPED, "the launcher is suspended")
    threading.Event().wait(seconds)
    run.process.send_signal(signal.SIGCONT)


SHORT = "launcher suspended for less than 20 s and resumed, lock-step (Ctrl-Z, SIGSTOP)"


def test_a_suspended_launcher_resumes_a_lock_step_run_without_effect(launch) -> None:
    run: Launched = launch(*BASELINE, "--frames", "150")
    run.at_frame(15)
    suspend(run, 5.0)
    code, output = run.end()
    assert (run.record()["status"], code) == ending(SHORT)
    assert "Traceback" not in output
    assert run.record()["churn"] == []
    assert {message.frame for message in read(run.out)} == set(range(150))


def test_a_launcher_suspended_too_long_in_real_time_names_lost_nodes(launch) -> None:
    run: Launched = launch(*BASELINE, "--mode", "realtime", "--frames", "120")
    run.at_frame(15)
    suspend(run, 5.0)
    code, output = run.end()
    what = "launcher suspended for more than 2 s and resumed, real time"
    assert (run.record()["status"], code) == ending(what), output
    assert "Traceback" not in output
    assert "lost" in {each["what"] for each in run.record()["churn"]}
    list(read(run.out))


def test_a_launcher_suspended_too_long_fails_a_run_with_remote_nodes(
    start: Callable[..., Launched], tmp_path: Path
) -> None:
    allow(tmp_path / "run_0", 20)
    run = start(sys.executable, held_back.__file__, "baseline", PYTHONPATH=os.pathsep.join(sys.path))
    run.at_frame(20)
    suspend(run, 5.0)
    allow(run.out, 1000)
    code, output = run.end()
    what = "launcher suspended for more than 2 s and resumed, lock-step, nodes elsewhere"
    assert (run.record()["status"], code) in (ending(what), ("node_lost", 33)), output
    assert "lost" in {each["what"] for each in run.record()["churn"]}
    list(read(run.out))


@pytest.mark.parametrize("stage", ["starting", "collecting"])
def test_a_launcher_killed_at_either_end_of_a_run_leaves_no_nodes_running(
    start: Callable[..., Launched], stage: str, tmp_path: Path
) -> None:
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
