"""However `mast run` ends, run.json and the exit code are as documented."""

import json
import os
import resource
import signal
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest
from endings_table import ENDINGS, Ending, ending
from fuzzing import Fuzzing
from launched import MAST

from mast_zenoh.run_folder.recording.reader import read

pytestmark = [pytest.mark.heavy, pytest.mark.long]

STAGED = (sys.executable, "-m", "at_stage")  # as a module, like MAST: Python ends scripts differently
RUN = ("run", "baseline", "--runtime", "inproc", "--frames", "12", "--no-report", "--out")


class FinishedCommand:
    """A finished command: its exit code, output and folder."""

    def __init__(self, out: Path, command: Sequence[str], **options: object) -> None:
        pipes = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
        defaults = {"env": {**os.environ, "PYTHONPATH": str(Path(__file__).parents[1] / "support")}}
        process = subprocess.run(
            [*command, str(out)], text=True, cwd=out.parent, timeout=120, **(pipes | defaults | options)
        )
        self.out = out
        self.code = process.returncode if process.returncode >= 0 else 128 - process.returncode  # like a shell
        self.text = (process.stdout or "") + (process.stderr or "")

    @property
    def status(self) -> str:
        """The status in run.json; "" if there is none."""
        path = self.out / "run.json"
        return json.loads(path.read_text())["status"] if path.is_file() else ""

    def assert_matches(self, row: Ending) -> None:
        """Assert that the ending matches a row of the table, and common rules."""
        assert (self.status, self.code) == row, self.text
        assert "Traceback" not in self.text
        reserve = {".reserve"} if row.status == "running" else set()  # space for a run.json that was never written
        assert {path.name for path in self.out.glob(".*")} <= reserve, "no temporary file remains"
        if (self.out / "messages.mcap").is_file():
            list(read(self.out))


@pytest.fixture
def out(tmp_path: Path) -> Path:
    return tmp_path / "run"


def at(stage: str, *actions: str, run: Sequence[str] = RUN) -> tuple[str, ...]:
    return (*STAGED, stage, *actions, "--", *run)


def with_report() -> list[str]:
    return [word for word in RUN if word != "--no-report"]


def file_size_limit(size: int) -> Callable[[], None]:
    """Limit the files that a command writes to `size` bytes, like a full disk."""
    return lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))


INTERRUPTED_CLASS = """
import signal, sys
from unittest import mock
when = sys.argv.pop(1)
class Raiser:
    def __set_name__(self, owner, name): signal.raise_signal(signal.SIGTERM)
    def find_spec(self, name, path=None, target=None): name == when and make()
def make(*_, **__): type("Made", (), {"field": Raiser()})
sys.meta_path.insert(0, Raiser())
from mast_zenoh.__main__ import main
with mock.patch("mast_zenoh.scenario.resolve", make) if when == "resolving" else mock.MagicMock(): main()
"""


@pytest.mark.parametrize("when", ["mast_zenoh.launch.stop_signals", "mast_zenoh.cli.app", "resolving"])
def test_a_signal_while_a_class_is_created_prints_one_line(out: Path, when: str) -> None:
    """Python 3.11 turns an exception in `__set_name__` into a RuntimeError."""
    outcome = FinishedCommand(out, (sys.executable, "-c", INTERRUPTED_CLASS, when, *RUN))
    outcome.assert_matches(ending("signal before the run folder exists"))
    assert "error: Interrupted" in outcome.text


@pytest.mark.parametrize(
    ("stage", "signals", "case", "kept", "absent"),
    [
        ("loading", "SIGTERM", "signal before the run folder exists", (), (".",)),
        ("starting", "SIGHUP", "signal while nodes start", (), ("metrics.json",)),
        ("playing", "SIGINT", "signal while the scene is played", ("metrics.json", "report.html"), ()),
        ("playing", "SIGHUP SIGTERM SIGINT", "second signal while the scene is played", (), ()),
        ("collecting", "SIGINT SIGTERM", "signal while results are collected", ("metrics.parquet",), ("report.html",)),
        ("reporting", "SIGINT", "signal while the report is drawn", ("metrics.json",), ("report.html",)),
    ],
)
def test_a_signal_at_any_stage_ends_the_run_as_documented(
    out: Path, stage: str, signals: str, case: str, kept: tuple[str, ...], absent: tuple[str, ...]
) -> None:
    outcome = FinishedCommand(out, at(stage, *signals.split(), run=with_report()))
    outcome.assert_matches(ending(case))
    assert all((out / name).exists() for name in kept)
    assert not any((out / name).exists() for name in absent)
    if case == "signal while the scene is played":
        assert json.loads((out / "metrics.json").read_text())["frames"] == 3
    if case == "second signal while the scene is played":
        recording = json.loads((out / "run.json").read_text())["recording"]
        assert recording == {"complete": False, "from_frame": 0}, "the first chunk was not yet written"
    if stage == "reporting":
        assert f"mast report {out}" in outcome.text.replace("\n", "")


@pytest.mark.parametrize(
    ("stage", "case"),
    [
        ("loading", "launcher killed before the run folder exists"),
        ("playing", "launcher killed (SIGKILL)"),
        ("reporting", "launcher killed while the report is drawn"),
    ],
)
def test_a_launcher_killed_at_any_stage_leaves_a_readable_run_folder(out: Path, stage: str, case: str) -> None:
    FinishedCommand(out, at(stage, "SIGKILL", run=with_report())).assert_matches(ending(case))
    assert out.exists() == (stage != "loading")
    if stage != "loading":
        report = subprocess.run([*MAST, "report", str(out)], capture_output=True, text=True)
        assert report.returncode == 0, report.stderr
        assert (out / "report.html").is_file()


def test_a_run_under_nohup_survives_its_terminal(out: Path) -> None:
    outcome = FinishedCommand(
        out, at("playing", "SIGHUP"), preexec_fn=lambda: signal.signal(signal.SIGHUP, signal.SIG_IGN)
    )
    outcome.assert_matches(Ending("ok", 0))


@pytest.mark.parametrize(
    ("stream", "case"),
    [
        ("stdout", "reader of standard output gone (`head -0`)"),
        ("stderr", "reader of standard error gone"),
        ("full", "standard output on a full disk (`> /dev/full`)"),
        *((closed, "standard output or error closed (`>&-`)") for closed in ("1", "0 1 2")),
    ],
)
def test_a_stream_that_takes_nothing_does_not_fail_the_run(out: Path, stream: str, case: str) -> None:
    """A full disk is an error, but the run is kept; the descriptor of a closed stream is not used again."""
    reading, writing = os.pipe()
    os.close(reading)
    options: dict[str, object] = {stream: writing}
    with Path("/dev/full").open("w") as full:
        if stream == "full":
            options = {"stdout": full}
        elif case.endswith("closed (`>&-`)"):
            options = {"preexec_fn": lambda: [os.close(int(number)) for number in stream.split()]}
        try:
            outcome = FinishedCommand(out, (*MAST, *RUN), **options)
        finally:
            os.close(writing)
    outcome.assert_matches(ending(case))
    assert ("standard output: No space left on device" in outcome.text) == (stream == "full")


def test_a_disk_that_is_full_from_the_start_leaves_no_run_folder(out: Path) -> None:
    outcome = FinishedCommand(out, (*MAST, *RUN), preexec_fn=file_size_limit(1 << 17))
    outcome.assert_matches(ending("disk full while the run folder is made"))
    assert f"error: DiskFull: {out}: File too large: a run cannot begin there" in " ".join(outcome.text.split())
    assert not any(out.iterdir())


def test_a_recording_that_fills_the_disk_fails_the_run_but_keeps_its_results(out: Path) -> None:
    command = [word if word != "12" else "120" for word in (*MAST, *RUN)]
    outcome = FinishedCommand(out, command, preexec_fn=file_size_limit(3_500_000))
    outcome.assert_matches(ending("disk full while the scene is played"))
    assert "messages.mcap: cannot be written: File too large" in outcome.text
    assert (out / "metrics.parquet").is_file()


@pytest.mark.parametrize(
    ("stage", "case"),
    [
        ("starting", "disk full while the run folder is made"),
        ("building", "disk full while nodes start"),
        ("playing", "disk full while the scene is played"),
        ("collecting", "disk full while results are collected"),
        ("reporting", "disk full while the report is drawn"),
    ],
)
def test_a_run_on_a_completely_full_disk(tiny_disk: Path, stage: str, case: str) -> None:
    out = tiny_disk / "run"
    outcome = FinishedCommand(out, at(stage, str(tiny_disk / "others.bin"), run=with_report()))
    outcome.assert_matches(ending(case))
    assert "error: DiskFull" in outcome.text
    truncated = [path for path in out.glob("*.parquet") if path.read_bytes()[-4:] != b"PAR1"]
    assert not truncated, "a table is complete or absent"


def test_a_run_folder_that_cannot_be_created_is_named_in_the_error(tmp_path: Path) -> None:
    (tmp_path / "runs").write_text("a file")
    process = subprocess.run([*MAST, *RUN[:-1]], cwd=tmp_path, capture_output=True, text=True)
    assert process.returncode == ending("run folder cannot be made").code
    assert "runs/baseline-" in process.stderr.replace("\n", "")
    assert "None" not in process.stderr


@pytest.mark.parametrize("name", ["../evil", "a*b", 7])
def test_a_scenario_name_cannot_escape_the_runs_folder(tmp_path: Path, name: object) -> None:
    (tmp_path / "named.py").write_text(
        "from mast_zenoh.config import loading\n"
        "_, baseline = loading.function('scenarios', 'baseline', 'scenario')\n"
        f"def scenario(): return baseline() | dict(name={name!r})\n"
    )
    command = [*MAST, "run", "named.py", *RUN[2:-1]]
    process = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert process.returncode == ending("scenario whose name leaves `runs/`").code, process.stderr
    assert "named.py: name: found" in process.stderr
    assert {path.name for path in tmp_path.iterdir()} - {"__pycache__"} == {"named.py"}


def test_an_internal_error_shows_its_traceback_and_fails_the_run(out: Path) -> None:
    script = (
        "from mast_zenoh.launch import conclusion\n"
        "conclusion.write = lambda *_: 1 / 0\n"
        "from mast_zenoh.__main__ import main\n"
        "main()"
    )
    outcome = FinishedCommand(out, (sys.executable, "-c", script, *RUN))
    assert (outcome.status, outcome.code) == ending("defect in the launcher")
    assert "ZeroDivisionError" in json.loads((out / "run.json").read_text())["message"]
    assert "Traceback" in outcome.text


def test_a_report_needs_no_display_and_no_valid_mplbackend(out: Path) -> None:
    outcome = FinishedCommand(out, (*MAST, *with_report()), env={**os.environ, "MPLBACKEND": "bogus"})
    outcome.assert_matches(Ending("ok", 0))
    assert (out / "report.html").is_file()


def test_a_path_that_the_locale_cannot_encode(tmp_path: Path) -> None:
    file = tmp_path / "Kreuzung_größer.py"
    file.write_text(
        "from mast_zenoh.config import loading\n_, scenario = loading.function('scenarios', 'baseline', 'scenario')\n"
    )
    ascii_only = {**os.environ, "LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    outcome = FinishedCommand(tmp_path / "Ergebnis_ä", (*MAST, "run", str(file), *with_report()[2:]), env=ascii_only)
    outcome.assert_matches(Ending("ok", 0))
    assert (outcome.out / "report.html").is_file()


def test_runs_that_end_at_random_times_match_the_table(fuzzing: Fuzzing) -> None:
    tool = Path(__file__).parents[2] / "tools" / "endings.py"
    command = [sys.executable, str(tool), "--runs", str(fuzzing.draws(2, 100)), "--seed", "12", "--runtime", "inproc"]
    process = subprocess.run(command, capture_output=True, text=True)
    assert process.returncode == 0, process.stdout + process.stderr


def test_every_row_of_the_table_has_a_test() -> None:
    folder = Path(__file__).parents[1]
    files = (Path(__file__), folder / "mesh" / "test_endings.py", folder / "simulation" / "test_random_schedules.py")
    tests = "".join(file.read_text() for file in files)
    rows = ENDINGS
    assert len(rows) > 15
    assert not [case for case in rows if f'"{case}"' not in tests]


def test_a_stopped_study_is_marked_as_interrupted(tmp_path: Path) -> None:
    command = (*STAGED, "collecting", "SIGTERM", "--", "study", "case_study", "--runtime", "inproc", "--frames", "4")
    outcome = FinishedCommand(tmp_path / "study", (*command, "--out"))
    assert outcome.code == 130, outcome.text
    assert "Traceback" not in outcome.text
    assert json.loads((tmp_path / "study" / "study.json").read_text())["status"] == "interrupted"
