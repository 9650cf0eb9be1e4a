"""What a terminal shows of runs: every status that is drawn, and the scores of the evaluator."""

from io import StringIO
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from rich.console import Console

from mast_zenoh.launch import display, observation
from mast_zenoh.launch.display import Display
from mast_zenoh.launch.observation import Status


def console(width: int, height: int = 24) -> Console:
    """A terminal of this size."""
    return Console(force_terminal=True, width=width, height=height, file=StringIO())


def drawn_statuses(monkeypatch: pytest.MonkeyPatch) -> list[Status]:
    """The list to which each status is added; from now on they are drawn and scored as often as possible."""
    for module, prefix in ((display, ""), (observation, "_SCORE")):
        monkeypatch.setattr(module, f"{prefix}_PERIOD_S", 0.0)
        monkeypatch.setattr(module, f"{prefix}_SHARE", 1e9)
    drawn: list[Status] = []
    lines = Display.lines
    monkeypatch.setattr(Display, "lines", lambda self, *words: drawn.append(words[0]) or lines(self, *words))
    return drawn


def evaluated(folder: Path) -> dict[int, tuple[int, int, int]]:
    """Missed, false and matched objects of the picture as the ego received it, by frame."""
    table = pq.read_table(folder / "metrics.parquet").to_pylist()
    rows = [row for row in table if (row["agent"], row["estimator"]) == ("ego", "picture_received")]
    return {row["frame"]: (row["fn"], row["fp"], row["tp"]) for row in rows}
