"""Studies on several processes give equal tables, even when interrupted."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import psutil
import pytest
from launched import eventually
from small_study import tables, write_small

from mast_zenoh.errors import StartError
from mast_zenoh.study import definition, execution, trials

pytest.importorskip("distributed", reason="dask is not installed")

pytestmark = pytest.mark.heavy

DEADLINE_S = 60.0


@pytest.fixture(scope="module")
def study_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_small(tmp_path_factory.mktemp("study"))


@pytest.fixture(scope="module")
def reference(study_file: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """The tables of the study run by one process, one trial after the other."""
    outcome = trials.run(definition.load(str(study_file)), tmp_path_factory.mktemp("reference") / "out", count=4)
    return tables(outcome.out)


def test_a_second_study_on_a_machine_gives_no_warning_of_ports_and_is_reachable_from_nowhere_else() -> None:
    with socket.socket() as other, warnings.catch_warnings():
        with suppress(OSError):  # Dask's own port: another study may have it already
            other.bind(("127.0.0.1", 8787))
            other.listen()
        warnings.simplefilter("error")
        with execution._client(1, None) as client:
            assert client.scheduler_info()["services"]["dashboard"] != 8787
            listening = psutil.Process().net_connections("tcp")
    assert {each.laddr.ip for each in listening if each.status == psutil.CONN_LISTEN} == {"127.0.0.1"}


def study(study_file: Path, out: Path, *words: str) -> subprocess.Popen[str]:
    """Start `mast study` with four seeds, in a process of its own."""
    command = [sys.executable, "-m", "mast_zenoh", "study", str(study_file), "--trials", "4", "--out", str(out), *words]
    pipes: dict[str, Any] = dict(stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    return subprocess.Popen(command, cwd=out.parent, start_new_session=True, **pipes)


@pytest.mark.parametrize("stop", [signal.SIGKILL, signal.SIGINT])
def test_interrupted_study_of_two_jobs_resumes_with_equal_tables(
    study_file: Path, reference: dict[str, bytes], tmp_path: Path, stop: signal.Signals
) -> None:
    out = tmp_path / "out"
    running = study(study_file, out, "--jobs", "2")
    eventually(lambda: len(list((out / "trials").glob("[!.]*"))) >= 2, "two trials", DEADLINE_S)
    workers = psutil.Process(running.pid).children(recursive=True)
    if stop == signal.SIGINT:
        os.killpg(running.pid, stop)  # as a terminal does
    else:
        running.send_signal(stop)
    output, _ = running.communicate(timeout=DEADLINE_S)
    _, alive = psutil.wait_procs(workers, timeout=DEADLINE_S)
    assert not alive, "workers outlive the study"
    finished = {path.name: path.stat().st_mtime_ns for path in (out / "trials").glob("[!.]*")}
    assert len(finished) >= 2
    if stop == signal.SIGINT:
        assert running.returncode == 130, output
        assert "--resume" in output
        assert "Traceback" not in output, "of a worker"
    again = study(study_file, out, "--jobs", "1", "--resume")
    output, _ = again.communicate(timeout=DEADLINE_S)
    assert again.returncode == 0, output
    assert f"{len(finished)} of 12 trials are already done" in output or len(finished) == 12
    for name, written in finished.items():
        assert (out / "trials" / name).stat().st_mtime_ns == written, "a finished trial was repeated"
    assert tables(out) == reference


@contextmanager
def dask(*words: str, cwd: Path) -> Iterator[subprocess.Popen[str]]:
    """Start a scheduler or a worker, like a user by hand."""
    command = [sys.executable, "-m", "dask", *words]
    process = subprocess.Popen(
        command, cwd=cwd, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True, text=True
    )
    try:
        yield process
    finally:
        os.killpg(process.pid, signal.SIGTERM)
        try:
            process.wait(DEADLINE_S)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            raise


def address_in(scheduler_file: Path) -> str:
    """The scheduler's address; "" until it has written it."""
    try:
        return str(json.loads(scheduler_file.read_text())["address"])
    except (OSError, ValueError):
        return ""


def test_a_scheduler_and_two_workers_started_by_hand_run_the_study(
    study_file: Path, reference: dict[str, bytes], tmp_path: Path
) -> None:
    where = tmp_path / "scheduler.json"
    words = ("scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--scheduler-file", str(where))
    with dask(*words, cwd=tmp_path):
        eventually(lambda: address_in(where), "the scheduler", DEADLINE_S)
        joined = ("worker", "--scheduler-file", str(where), "--nthreads", "1", "--no-dashboard", "--no-nanny")
        with dask(*joined, cwd=tmp_path), dask(*joined, cwd=tmp_path):
            running = study(study_file, tmp_path / "out", "--cluster", address_in(where))
            output, _ = running.communicate(timeout=DEADLINE_S)
            assert running.returncode == 0, output
    assert tables(tmp_path / "out") == reference


def test_unreachable_cluster_is_named(study_file: Path, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(execution, "_CONNECT_S", 1)
    loaded = definition.load(str(study_file))
    with pytest.raises(StartError, match=r"--cluster tcp://127\.0\.0\.1:1: no Dask scheduler answers there"):
        trials.run(loaded, tmp_path / "out", count=1, cluster="tcp://127.0.0.1:1")
