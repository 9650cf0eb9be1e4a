"""The shell completes names, parameters and run folders, quickly, and never fails."""

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from mast_zenoh.api import catalogue

SLOW = ("numpy", "scipy", "zenoh", "msgpack", "pyarrow", "mast_zenoh.scenario", "mast_zenoh.launch.run")


@pytest.fixture
def completed(mast, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], list[str]]:
    """What bash offers for the last word of a command line."""

    def complete(line: str) -> list[str]:
        monkeypatch.setenv("_MAST_COMPLETE", "complete_bash")
        monkeypatch.setenv("COMP_WORDS", line)
        monkeypatch.setenv("COMP_CWORD", str(line.count(" ")))
        code, out, err = mast()
        assert (code, err) == (0, "")
        return out.split()

    return complete


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("mast run unco", {"uncoordinated"}),
        ("mast wiring coord", {"coordinated"}),
        ("mast study case", {"case_study"}),
        ("mast run uncoordinated --set n_", {"n_adversaries=", "n_infrastructure=", "n_mobile="}),
        ("mast run --frames 9 uncoordinated --set n_a", {"n_adversaries="}),
        ("mast run uncoordinated --set=n_a", {"n_adversaries="}),
        ("mast run mine.py --set sp", {"speed_mps="}),
        ("mast run broken.py --set sp", set()),
        ("mast run nosuch --set n_", set()),
        ("mast study breakdown --set sc", {"scenes="}),
        ("mast run mi", {"mine.py"}),
        ("mast run no/such/fo", set()),
        ("mast run baseline --runtime ", {"mesh", "inproc"}),
        ("mast export a_run --to p", {"parquet", "pcap"}),
        ("mast report ", {"runs/old", "a_run", "runs/"}),
        ("mast logs runs/", {"runs/old"}),
        ("mast logs a_run ", {"ego", "broker"}),
        ("mast logs nowhere ", set()),
        ("mast run baseline --against ", {"twin", "runs/old", "a_run", "runs/"}),
        ("mast list sc", {"scenes", "scenarios"}),
    ],
)
def test_the_last_word_is_completed(
    completed: Callable[[str], list[str]], tmp_path: Path, line: str, expected: set[str]
) -> None:
    for folder in ("a_run", "runs/old"):
        (tmp_path / folder / "logs").mkdir(parents=True)
        (tmp_path / folder / "run.json").touch()
    for node in ("ego", "broker"):
        (tmp_path / "a_run" / "logs" / f"{node}.log").touch()
    (tmp_path / "mine.py").write_text(
        "raise SystemExit('a file is read, not run')\ndef scenario(*, speed_mps=3.0): ..."
    )
    (tmp_path / "broken.py").write_text("def scenario(speed_mps=")
    offered = completed(line)
    assert set(offered) >= expected if line == "mast run mi" else set(offered) == expected


def test_every_shipped_scenario_and_study_has_its_parameters_completed(completed: Callable[[str], list[str]]) -> None:
    for kind, command in (("scenarios", "run"), ("studies", "study")):
        for entry in catalogue.list_kind(kind):
            names = [f"{parameter.name}=" for parameter in entry.parameters]
            assert completed(f"mast {command} {entry.name} --set ") == names


def test_commands_are_read_without_slow_imports() -> None:
    code = f"import sys, mast_zenoh.cli.app; sys.exit(str([m for m in {SLOW} if m in sys.modules]))"
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert ended.stderr.strip() == "[]"


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_each_shell_has_a_script(mast, monkeypatch: pytest.MonkeyPatch, shell: str) -> None:
    monkeypatch.setenv("_MAST_COMPLETE", f"source_{shell}")
    code, out, _ = mast()
    assert code == 0
    assert f"_MAST_COMPLETE=complete_{shell}" in out
