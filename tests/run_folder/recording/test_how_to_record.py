"""The error for a run without a recording names the command that gives one."""

import json
from pathlib import Path

import pytest

from mast_zenoh.errors import RunFolderError
from mast_zenoh.run_folder.recording.reader import file_of

GENERAL = "repeat it without --no-record, or its study with --record"
OUT = ["--out", "taken", "-o", "taken", "--out=taken"]


def message(folder: Path, command: object) -> str:
    (folder / "run.json").write_text(json.dumps({"command": command}))
    with pytest.raises(RunFolderError) as caught:
        file_of(folder)
    return str(caught.value)


@pytest.mark.parametrize(
    ("command", "advice"),
    [
        (
            ["/x/bin/mast", "run", "coordinated", "--set", "n=3", "--no-record", *OUT],
            "repeat it in a new folder with a recording: mast run coordinated --set n=3",
        ),
        (["mast", "run", "mine.py"], "mast run mine.py --set run.record=true"),
        (
            ["mast", "run", "a b.py", "--set", "x=[1, 2]; rm *", "--no-record"],
            "mast run 'a b.py' --set 'x=[1, 2]; rm *'",
        ),
        (
            "mast_zenoh.run('baseline', frames=20)",
            "repeat it with record=True: mast_zenoh.run('baseline', frames=20)",
        ),
    ],
    ids=["mast run", "a scenario that records nothing", "quoted words", "a call in Python"],
)
def test_a_run_without_recording_is_repeated_with_one(tmp_path: Path, command: object, advice: str) -> None:
    assert message(tmp_path, command).endswith(advice)


@pytest.mark.parametrize(
    "command",
    [
        None,
        "rm -rf /",
        [],
        ["rm", "run", "x"],
        ["mast", "study", "x"],
        ["mast", "run", "a\nb"],
        [1, 2],
        {"mast": "run"},
        "mast_zenoh.run('\x1b[2J')",
    ],
)
def test_other_commands_are_never_repeated(tmp_path: Path, command: object) -> None:
    assert message(tmp_path, command).endswith(GENERAL)


def test_a_run_in_progress_is_not_called_a_run_that_was_not_recorded(tmp_path: Path) -> None:
    (tmp_path / "run.json").write_text(json.dumps({"status": "running"}))
    with pytest.raises(RunFolderError, match="in progress"):
        file_of(tmp_path)
