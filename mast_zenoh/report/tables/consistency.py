"""How confident estimates are compared with their accuracy: table rows."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from mast_zenoh.launch.notices import subject
from mast_zenoh.report.runfolder import RunFolder
from mast_zenoh.report.tables.scores import DASH


class EstimateRow(NamedTuple):
    """One estimate; the verdict of either quantity is in words, empty: none.

    nees, factor, typical: of position;  v_nees, v_factor, v_typical: of velocity; with their 95 % intervals
    """

    estimate: str
    nees: str
    factor: str
    typical: str
    v_nees: str
    v_factor: str
    v_typical: str
    pairs: int
    verdict: str


class TrackerRow(NamedTuple):
    """The tracker of one node; nis with its bounds."""

    node: str
    nis: str
    factor: str
    pairs: int
    sudden: int
    verdict: str


def estimate_rows(run: RunFolder) -> list[EstimateRow]:
    """A row for each estimate of each agent; empty for a run of an earlier version."""
    rows = []
    for agent, estimates in run.metrics.get("consistency", {}).items():
        for estimate, summaries in estimates.items():
            position, velocity = summaries["position"], summaries["velocity"]
            verdicts = [f"{name}: {each['verdict']}" for name, each in summaries.items() if each["verdict"]]
            rows.append(
                EstimateRow(
                    subject(agent, estimate),
                    *_numbers(position),
                    *_numbers(velocity),
                    position["pairs"],
                    "; ".join(verdicts),
                )
            )
    return rows


def tracker_rows(run: RunFolder) -> list[TrackerRow]:
    """A row for each node with a tracker that tells; empty for a run of an earlier version."""
    return [
        TrackerRow(
            name,
            _with_range(each, "nis", "low", "high"),
            _with_range(each, "factor", "factor_low", "factor_high"),
            each["pairs"],
            each["sudden"],
            each["verdict"] or "",
        )
        for name, each in run.run.get("innovations", {}).items()
    ]


def _numbers(summary: Mapping[str, Any]) -> tuple[str, str, str]:
    return (
        _with_range(summary, "nees", "low", "high"),
        _with_range(summary, "factor", "factor_low", "factor_high"),
        _with_range(summary, "typical_factor", "typical_low", "typical_high"),
    )


def _with_range(summary: Mapping[str, Any], name: str, low: str, high: str) -> str:
    if summary[name] is None:
        return DASH
    return f"{_number(summary[name])} ({_number(summary[low])} to {_number(summary[high])})"


def _number(value: float | None) -> str:
    if value is None:
        return "?"
    return f"{value:.2f}" if value < 100.0 else f"{value:.3g}"
