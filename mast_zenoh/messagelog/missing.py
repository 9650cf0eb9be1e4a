"""Explains why a run folder has no recording, and how to get one."""

from __future__ import annotations

import shlex
from contextlib import suppress
from pathlib import Path
from typing import Any

from mast_zenoh.errors import RunFolderError
from mast_zenoh.run_files import read_object


def without_recording(folder: Path) -> str:
    """Why a folder has no recording, as text."""
    if not (folder / "run.json").exists():
        return f"{folder} is not the folder of a run"
    run: dict[str, Any] = {}
    with suppress(RunFolderError):
        run = read_object(folder / "run.json")
    if messages := (run.get("recorded") or {}).get("messages"):
        return f"the run was recorded, and run.json counts {messages} messages: expected the recording in {folder}"
    return f"{folder} is a run that was not recorded: {_how_to_record(run)}"


def _how_to_record(run: dict[str, Any]) -> str:
    """The command that repeats a run with a recording; in general words if run.json does not say what started it."""
    command = run.get("command")
    if isinstance(command, str) and command.startswith("mast_zenoh.run(") and command.isprintable():
        return f"repeat it with record=True: {command:.500}"
    if isinstance(command, list) and all(isinstance(word, str) and word.isprintable() for word in command):
        program, *words = command or [""]
        if program.rpartition("/")[2] == "mast" and len(words) > 1 and words[0] in ("run", "replay"):
            recorded = [word for word in words if word != "--no-record"]
            # Without that option it was the scenario that asked for no recording.
            recorded += ["--set", "run.record=true"] if recorded == words and words[0] == "run" else []
            return f"repeat it in a new folder with a recording: {shlex.join(['mast', *_without_out(recorded)])}"
    return "repeat it without --no-record, or its study with --record"


def _without_out(words: list[str]) -> list[str]:
    """The words of a command without its output folder, which is in use."""
    named = {index for index, word in enumerate(words) if word in ("--out", "-o")}
    return [
        word
        for index, word in enumerate(words)
        if index not in named and index - 1 not in named and not word.startswith("--out=")
    ]
