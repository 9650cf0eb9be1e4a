"""Tables of runs with links, faults or a wall clock: causes, checks, latency."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from rich.box import SIMPLE_HEAD
from rich.table import Table

from mast_zenoh.report.tables.scores import DASH

#: Groups of causes, as in `fn_split` and `fp_split` of metrics.json.
CAUSE_GROUPS = ("fault", "attack", "natural")
_WITH_DEFENCE = ("fault", "attack", "withheld", "natural")
_PERCENTILES = ("p50", "p95", "p99")
_MAIN_WIRES = ("tracks", "collated", "picture")
_SPLITS = (("fn_split", "missed"), ("fp_split", "false"))


class CauseRow(NamedTuple):
    """Missed and false objects per frame of one agent's picture, by group of causes."""

    agent: str
    missed: tuple[str, ...]
    false: tuple[str, ...]


class CheckRow(NamedTuple):
    """A check; `outcome` is "ok", "failed" or "not checked"."""

    name: str
    outcome: str
    detail: str


class LatencyRow(NamedTuple):
    """Latency of a wire in ms, from the simulator's frame to the frame's message.

    n: frames
    main: whether the wire is between the agents and the picture
    """

    wire: str
    p50: str
    p95: str
    p99: str
    n: str
    main: bool


def with_faults(scenario: Mapping[str, Any]) -> bool:
    """Whether a run has links or faults, according to scenario.json."""
    return any(each.get("kind") != "attack" for each in scenario.get("timeline", ()))


def cause_groups(*summaries: Mapping[str, Any]) -> tuple[str, ...]:
    """The groups of causes in the tables of some runs: with "withheld" if objects were withheld in any."""
    pictures = [each.get("picture", {}) for metrics in summaries for each in metrics.get("agents", {}).values()]
    withheld = any((picture.get(name) or {}).get("withheld") for picture in pictures for name, _ in _SPLITS)
    return _WITH_DEFENCE if withheld else CAUSE_GROUPS


def cause_rows(metrics: Mapping[str, Any], groups: tuple[str, ...] = CAUSE_GROUPS) -> list[CauseRow]:
    """A row per agent whose picture has causes of errors; groups: of its causes."""
    rows = []
    for agent, estimators in metrics.get("agents", {}).items():
        splits = [estimators.get("picture", {}).get(name) for name, _ in _SPLITS]
        if all(splits):
            missed, false = (tuple(_two_decimals(each.get(group)) for group in groups) for each in splits if each)
            rows.append(CauseRow(agent, missed, false))
    return rows


def check_rows(checks: Mapping[str, Any]) -> list[CheckRow]:
    """The checks, failed ones first."""
    rows = []
    for each in checks.get("checks", ()):
        skipped = not each.get("values", {}).get("checked", True)
        outcome = "failed" if not each["ok"] else "not checked" if skipped else "ok"
        detail = each.get("detail", "").removeprefix("not checked: ")
        rows.append(CheckRow(str(each["name"]), outcome, detail))
    return sorted(rows, key=lambda row: ("failed", "ok", "not checked").index(row.outcome))


def latency_rows(metrics: Mapping[str, Any]) -> list[LatencyRow]:
    """A row per wire whose latency was measured, in the order of metrics.json."""
    wires = metrics.get("latency_ms", {}).get("by_wire") or {}
    rows = []
    for wire, summary in wires.items():
        p50, p95, p99 = (summary.get(p) for p in _PERCENTILES)
        if p50 is not None:
            main = wire.rpartition("/")[2] in _MAIN_WIRES
            rows.append(
                LatencyRow(
                    wire, _two_decimals(p50), _two_decimals(p95), _two_decimals(p99), str(summary.get("n", DASH)), main
                )
            )
    return rows


def late_rows(metrics: Mapping[str, Any]) -> list[tuple[str, int]]:
    """(agent, number of its messages after the broker's latency budget)."""
    return [(str(agent), int(number)) for agent, number in (metrics.get("late") or {}).items()]


def cause_table(metrics: Mapping[str, Mapping[str, Any]], agent: str) -> Table | None:
    """Terminal table of the causes of an agent's errors; None: not known.

    A row per run.

    metrics: by the run's label
    """
    groups = cause_groups(*metrics.values())
    rows = {label: row for label, each in metrics.items() for row in cause_rows(each, groups) if row.agent == agent}
    if not rows:
        return None
    title = "Causes of missed and false objects, per frame in the picture"
    table = Table(title=title, title_justify="left", title_style="dim", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    table.add_column("", justify="left", no_wrap=True)
    for _, error in _SPLITS:
        for index, group in enumerate(groups):
            table.add_column(f"{error if index == 0 else ''}\n{group}", justify="right")
    for label, row in rows.items():
        table.add_row(label, *row.missed, *row.false)
    return table


def check_lines(checks: Mapping[str, Any]) -> list[str]:
    """Terminal lines of the checks, failed ones first."""
    return [f"check {row.name}: {row.outcome}{f' ({row.detail})' if row.detail else ''}" for row in check_rows(checks)]


def _two_decimals(value: float | None) -> str:
    return DASH if value is None else f"{value:.2f}"
