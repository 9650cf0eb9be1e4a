"""The error for a run without a recording names the command that gives one."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from mast_zenoh.errors import RunFolderError
from mast_zenoh.messagelog.reader import file_of

GENERAL = "repeat it without --no-record, or its study with --record"


def message(folder: Path, command: object) -> str:
    (folder / "run.json").write_text(json.dumps({"command": command}))
    with pytest.raises(RunFolderError) as caught:
        file_of(folder)
    return str(caught.value)


def test_a_run_without_recording_is_repeated_without_the_option_and_into_a_new_folder(tmp_path: Path) -> None:
    command = "/x/bin/mast run coordinated --set n_adversaries=3 --seed 7 --no-record --out taken -o taken --out=taken"
    assert message(tmp_path, command.split()).endswith(
        "was not recorded: repeat it in a new folder with a recording: "
        "mast run coordinated --set n_adversaries=3 --seed 7"
    )


def test_a_scenario_that_records_nothing_is_overruled(tmp_path: Path) -> None:
    assert message(tmp_path, ["mast", "run", "mine.py"]).endswith("mast run mine.py --set run.record=true")


def test_words_of_the_command_are_quoted(tmp_path: Path) -> None:
    text = message(tmp_path, ["mast", "run", "a b.py", "--set", "x=[1, 2]; rm *", "--no-record"])
    assert text.endswith("mast run 'a b.py' --set 'x=[1, 2]; rm *'")


def test_a_python_call_is_repeated_with_its_argument(tmp_path: Path) -> None:
    text = message(tmp_path, "mast_zenoh.run('baseline', frames=20)")
    assert text.endswith("repeat it with record=True: mast_zenoh.run('baseline', frames=20)")


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
