"""The summary table on the terminal. Draws nothing, so it costs no time."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

from rich.console import Console

from mast_zenoh.report.table import as_rich, summary_table


def show(console: Console, runs: Mapping[str, Path]) -> None:
    """Print the summary of runs, given as run folders by label; the first or `baseline` is what others are held to.

    A run without a readable metrics.json gets a row of dashes.
    """
    metrics = {}
    for label, folder in runs.items():
        try:
            metrics[label] = json.loads((folder / "metrics.json").read_text("utf-8"))
        except (OSError, ValueError):
            metrics[label] = {}
    agents = next((list(each["agents"]) for each in metrics.values() if each.get("agents")), ["ego"])
    console.print(as_rich(summary_table(metrics, agent="ego" if "ego" in agents else agents[0])))
