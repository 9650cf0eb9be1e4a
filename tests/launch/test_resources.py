"""Too little memory and too few file descriptors are told on one line, and never look like a success."""

import errno
import os
import resource
import subprocess
import sys
from pathlib import Path

import pytest

from mast_zenoh import scenario
from mast_zenoh.errors import DiskFull, NodeFileError, ResourcesExhausted, StartError
from mast_zenoh.launch import ending, run
from mast_zenoh.run_folder import read_json

CODE = ResourcesExhausted.exit_code


@pytest.mark.parametrize("error", [MemoryError(), ImportError("libarrow.so: failed to map segment from shared object")])
def test_a_table_that_cannot_be_written_for_want_of_memory_fails_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    def fail(*_: object) -> None:
        raise error

    monkeypatch.setattr("mast_zenoh.run_folder.tables.to_arrow", fail)
    resolved = scenario.resolve(*scenario.load("baseline", []), frames=2)
    ended = run.run(resolved, runtime="inproc", out=tmp_path / "run")
    assert isinstance(ended.error, ResourcesExhausted)
    assert read_json(tmp_path / "run" / "run.json")["status"] == "failed"


@pytest.mark.parametrize(
    "error",
    [
        MemoryError(),
        OSError(errno.EMFILE, "Too many open files"),
        ImportError("libblas.so: cannot allocate memory in static TLS block"),
    ],
)
def test_exhausted_resources_have_their_own_error(error: Exception) -> None:
    assert isinstance(ending.from_exception(error), ResourcesExhausted)


@pytest.mark.parametrize("cause", [DiskFull("messages.mcap: No space left"), OSError(errno.ENOSPC, "No space left")])
def test_a_node_that_finds_the_disk_full_when_it_starts_ends_the_run_like_any_full_disk(cause: Exception) -> None:
    error = StartError("recorder.start failed")
    error.__cause__ = cause
    assert type(ending.from_exception(error)) is DiskFull


def test_a_missing_module_is_a_defect_and_no_lack_of_memory() -> None:
    assert ending.from_exception(ImportError("No module named 'x'")) is None


def test_a_low_hard_limit_of_descriptors_is_told_at_once(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "mast_zenoh", "run", "baseline", "--frames", "2", "--out", str(tmp_path / "run")],
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_NOFILE, (40, 40)),
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    assert done.returncode == CODE
    assert "40 file descriptors" in " ".join(done.stderr.split())
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "run").exists()


def test_a_low_soft_limit_is_raised_as_far_as_needed(monkeypatch: pytest.MonkeyPatch) -> None:
    limits = []
    monkeypatch.setattr(resource, "getrlimit", lambda kind: (40, 4096))
    monkeypatch.setattr(resource, "setrlimit", lambda kind, pair: limits.append(pair))
    run.ensure_descriptors(10)
    assert limits == [(run.BASE + 10 * run.PER_NODE, 4096)]


def test_a_start_without_memory_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "typer.py").write_text("raise MemoryError\n")
    done = subprocess.run(
        [sys.executable, "-m", "mast_zenoh"],
        env=dict(os.environ, PYTHONPATH=str(tmp_path)),
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    assert (done.returncode, done.stdout) == (CODE, "")
    assert "cannot start: MemoryError" in done.stderr


@pytest.mark.parametrize(
    ("definition", "found"),
    [
        ("restamps_s = 3.0", "found 3.0"),
        ("def restamps_s(self, duration_s): return 'long'", "returned 'long'"),
        ("def restamps_s(self, duration_s): return 1 / 0", "ZeroDivisionError"),
        ("def restamps_s(self): return 0.0", "TypeError"),
    ],
)
def test_an_unusable_restamps_s_of_a_user_is_named(tmp_path: Path, definition: str, found: str) -> None:
    agent = "loading.node_class(bundle.ROOT / 'nodes' / 'agent.py')"
    text = f"from mast_zenoh.config import bundle, loading\nclass Mine({agent}):\n    {definition}\n"
    (tmp_path / "mine.py").write_text(text)
    _, content = scenario.load("baseline")
    content["agents"]["*"]["file"] = "mine.py"
    with pytest.raises(NodeFileError, match=rf"Mine\.restamps_s.*{found}.*method"):
        scenario.resolve(tmp_path / "scenario", content, frames=2)
