"""Runs in one process as a user plays them, and access to the run folder."""

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from observed_run import ObservedRun

from mast_zenoh import scenario
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.launch import run
from mast_zenoh.messages import codec
from mast_zenoh.messages.schemas import Body
from mast_zenoh.run_folder.recording.reader import read
from mast_zenoh.run_folder.tables import read_table

DOCS = Path(__file__).parents[2] / "docs"
FRAMES = 36


@dataclass(frozen=True)
class Played:
    """The folder of a finished run."""

    folder: Path

    @property
    def metrics(self) -> dict[str, Any]:
        return json.loads((self.folder / "metrics.json").read_text())

    @property
    def agents(self) -> dict[str, dict[str, Any]]:
        """The summary, by agent and estimator."""
        return self.metrics["agents"]

    def table(self, name: str) -> dict[str, np.ndarray]:
        """A table of the folder, by column."""
        return read_table(self.folder / f"{name}.parquet")

    def bodies(self, key: str) -> Iterator[tuple[int, Body]]:
        """Frame and columns of every message sent on a key."""
        for message in read(self.folder):
            if message.key == key:
                yield message.frame, codec.decode(message.payload, message.message).body


def play(folder: Path, name: str, *settings: str, frames: int = FRAMES, seed: int = 0, **files: str) -> Played:
    """Play a shipped scenario, or one of `files` (by name without .py)."""
    for file, text in files.items():
        (folder / f"{file}.py").write_text(text)
    path, content = scenario.load(str(folder / f"{name}.py") if name in files else name, list(settings))
    resolved = scenario.resolve(path, content, frames=frames, seed=seed, record=True)
    outcome = run.run(resolved, folder / "run", runtime="inproc")
    assert outcome.error is None, outcome.error
    return Played(outcome.folder)


def files_of(page: str) -> dict[str, str]:
    """The Python files of a documentation page, by name without .py."""
    blocks = re.findall(r"^```python file=(\S+)\.py\n(.*?)^```$", (DOCS / page).read_text(), flags=re.S | re.M)
    return dict(blocks)


def play_observed(folder: Path, resolved: Resolved) -> tuple[Played, ObservedRun]:
    """Play a resolved scenario, and record inputs and outputs of interposers."""
    runs: list[ObservedRun] = []

    def process(*arguments: Any, **more: Any) -> ObservedRun:
        runs.append(ObservedRun(*arguments, **more))
        return runs[-1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run, "InProcess", process)
        outcome = run.run(resolved, folder / "run", runtime="inproc", allow_failures=True)
    assert outcome.error is None, outcome.error
    return Played(outcome.folder), runs[0]
