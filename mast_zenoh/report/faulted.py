"""What the report of a run with links, faults or a wall clock has more: causes of errors, checks, lateness."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from rich.box import SIMPLE_HEAD
from rich.table import Table

from mast_zenoh.report.tables.scores import DASH

#: Who can be to blame, as in `fn_split` and `fp_split` of metrics.json.
BLAMED = ("fault", "attack", "natural")
_PERCENTILES = ("p50", "p95", "p99")
_MAIN = ("tracks", "collated", "picture")
_WHAT = (("fn_split", "missed"), ("fp_split", "false"))


class BlameRow(NamedTuple):
    """Objects per frame of one agent's picture: missed and false ones because of faults, of attacks, and anyway."""

    agent: str
    missed: tuple[str, ...]
    false: tuple[str, ...]


class CheckRow(NamedTuple):
    """A check; `outcome` is "ok", "failed" or "not checked"."""

    name: str
    outcome: str
    detail: str


class LatencyRow(NamedTuple):
    """Milliseconds from when the simulator sent a frame to when the frame's message on a wire came; `n` frames.

    main: on the way from the agents to the picture
    """

    wire: str
    p50: str
    p95: str
    p99: str
    n: str
    main: bool


def with_faults(scenario: Mapping[str, Any], checks: Mapping[str, Any]) -> bool:
    """Whether links or faults are part of a run, by its scenario.json and its checks.json."""
    return bool(checks) or any(each.get("kind") != "attack" for each in scenario.get("timeline", ()))


def blame_rows(metrics: Mapping[str, Any]) -> list[BlameRow]:
    """A row per agent whose picture tells who is to blame."""
    rows = []
    for agent, estimators in metrics.get("agents", {}).items():
        told = [estimators.get("picture", {}).get(name) for name, _ in _WHAT]
        if all(told):
            missed, false = (tuple(_two(each.get(who)) for who in BLAMED) for each in told if each)
            rows.append(BlameRow(agent, missed, false))
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
    for wire, told in wires.items():
        p50, p95, p99 = (told.get(p) for p in _PERCENTILES)
        if p50 is not None:
            main = wire.rpartition("/")[2] in _MAIN
            rows.append(LatencyRow(wire, _two(p50), _two(p95), _two(p99), str(told.get("n", DASH)), main))
    return rows


def late_rows(metrics: Mapping[str, Any]) -> list[tuple[str, int]]:
    """Agent and how many of its messages came after the broker's latency budget."""
    return [(str(agent), int(number)) for agent, number in (metrics.get("late") or {}).items()]


def blame_table(metrics: Mapping[str, Mapping[str, Any]], agent: str) -> Table | None:
    """For the terminal, a row per run: by whom the objects are missed and false that `agent` misses and has too many.

    metrics: by the run's label; None: no run tells
    """
    rows = {label: row for label, told in metrics.items() for row in blame_rows(told) if row.agent == agent}
    if not rows:
        return None
    title = "Causes of missed and false objects, per frame in the picture"
    table = Table(title=title, title_justify="left", title_style="dim", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    table.add_column("", justify="left", no_wrap=True)
    for _, what in _WHAT:
        for index, who in enumerate(BLAMED):
            table.add_column(f"{what if index == 0 else ''}\n{who}", justify="right")
    for label, row in rows.items():
        table.add_row(label, *row.missed, *row.false)
    return table


def check_lines(checks: Mapping[str, Any]) -> list[str]:
    """For the terminal: each check by name in a line, failed ones first."""
    return [f"check {row.name}: {row.outcome}{f' ({row.detail})' if row.detail else ''}" for row in check_rows(checks)]


def _two(value: float | None) -> str:
    return DASH if value is None else f"{value:.2f}"
