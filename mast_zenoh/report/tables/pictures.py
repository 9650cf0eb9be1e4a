"""Runs without a centre: a table of the agents' own pictures, and sentences about these and the radio channel."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from mast_zenoh.metrics.estimates import PICTURE
from mast_zenoh.report.tables.text_table import DASH, Head, Line, PageTable, whole_percent
from mast_zenoh.runs.run import Run

_HEADS = [
    Head("agent", kind="text"),
    Head("missed", "objects per frame"),
    Head("false", "objects per frame"),
    Head("RMSE (m)"),
    Head("deceived (% of the frames\nfrom the first lie on)"),
    Head("NEES of positions"),
]


def picture_table(run: Run) -> PageTable:
    """A line for each agent's picture; none where all agents get the same one."""
    pictures = run.files.summary.get("pictures", {})
    deceived = pictures.get("deceived", {}).get("agents", {})
    return PageTable(_HEADS, [_line(run.files.summary, agent, share) for agent, share in deceived.items()])


def _line(metrics: Mapping[str, Any], agent: str, deceived: float) -> Line:
    scores = metrics["agents"][agent][PICTURE]
    position = metrics["consistency"].get(agent, {}).get(PICTURE, {}).get("position", {})
    cells = [_number(each) for each in (scores["fn"]["mean"], scores["fp"]["mean"], scores["rmse_m"])]
    nees = _number(position.get("nees"))
    nees += f" (bound {_number(position['high'])})" if exceeds(position) else ""
    return Line((agent, *cells, whole_percent(deceived), nees), "bad" if exceeds(position) else "")


def exceeds(summary: Mapping[str, Any]) -> bool:
    """Whether the mean NEES of a summary is above its 95 % bounds, whatever its median is."""
    return summary.get("nees") is not None and summary.get("high") is not None and summary["nees"] > summary["high"]


def _number(value: float | None, digits: int = 2) -> str:
    return DASH if value is None else f"{value:.{digits}f}"
