"""The summary table on the terminal. Draws nothing, so it costs no time."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape

from mast_zenoh.report.faulted import blame_table, check_lines, with_faults
from mast_zenoh.report.table import as_rich, score_table


def show(console: Console, runs: Mapping[str, Path]) -> None:
    """Print the summary of runs, given as run folders by label; the first or `baseline` is what others are held to.

    A run without a readable metrics.json gets a row of dashes. Runs with links or faults also tell who is to blame, and
    what their checks have found.
    """
    metrics = {label: _read(folder / "metrics.json") for label, folder in runs.items()}
    agents = next((list(each["agents"]) for each in metrics.values() if each.get("agents")), ["ego"])
    agent = "ego" if "ego" in agents else agents[0]
    console.print(as_rich(score_table(metrics, agent=agent)))
    checks = {label: _read(folder / "checks.json") for label, folder in runs.items()}
    faulted = {
        label: metrics[label]
        for label, folder in runs.items()
        if with_faults(_read(folder / "scenario.json"), checks[label])
    }
    blame = blame_table(faulted, agent)
    if blame is not None:
        console.print(blame)
    for label, found in checks.items():
        for line in check_lines(found):
            console.print(escape(f"{label}: {line}" if len(runs) > 1 else line))


def _read(path: Path) -> dict[str, Any]:
    """The content of a JSON file; {}: there is none that can be read."""
    try:
        content = json.loads(path.read_text("utf-8"))
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}
