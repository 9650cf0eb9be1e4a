"""The nodes of a run: how each ended, what it rejected, and which handlers failed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from mast_zenoh.control import failures
from mast_zenoh.report.runfolder import RunFolder
from mast_zenoh.report.tables.interposers import exit_expected, failures_of


def node_row(run: RunFolder, name: str) -> dict[str, Any]:
    """What run.json says about a node, for a row of the table."""
    record = run.run["nodes"][name]
    return {key: record.get(key) for key in ("pid", "exit", "restarts")} | {
        "role": run.role(name),
        "ended": record.get("ended") or "not known",
        "bad": record.get("ended") != "ok" and not exit_expected(record),
        "last_frame": record.get("last_frame"),
        "troubles": _troubles(record),
    }


def failure_lines(run: RunFolder) -> list[str]:
    """A line for each handler that failed."""
    nodes = run.run.get("nodes", {})
    failed = {name: failures_of(node) for name, node in nodes.items() if node.get("failures")}
    located = {name: [entry for entry in entries if "where" in entry] for name, entries in failed.items()}
    lines = failures.lines(located, {name: nodes[name].get("log") or "not written" for name in located})
    unlocated = [(name, entry) for name, entries in failed.items() for entry in entries if "where" not in entry]
    return lines + [
        f"{name}.{entry['handler']} failed {failures.how_often(entry)}: {entry['exception']}"
        for name, entry in unlocated
    ]


def _troubles(record: Mapping[str, Any]) -> str:
    """Rejected messages and handler failures of a node; empty: none."""
    refused, foreign = (_total(record.get(key)) for key in ("rejected", "foreign"))
    counts = (
        (refused, "messages rejected"),
        (foreign, "messages from outside the run"),
        (sum(entry["count"] for entry in failures_of(record)), "handler failures"),
    )
    return ", ".join(f"{number} {label}" for number, label in counts if number)


def _total(counts: object) -> int:
    """The sum of counts by key; older runs hold the sum itself."""
    return sum(counts.values()) if isinstance(counts, Mapping) else int(str(counts or 0))
