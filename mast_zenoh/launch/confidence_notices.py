"""Notices of estimates that are more confident than accurate."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from mast_zenoh.config.resolved import NodeSpec
from mast_zenoh.tracking.innovations import OVERCONFIDENT, Innovations

#: Roles of nodes with a tracker.
_TRACKING = ("agent", "command_center")
#: The notices name agents; "as received" and so on tell which of their estimates is meant.
_SUBJECTS = {
    "local": "{}",
    "received": "{} as received",
    "picture": "the picture",
    "mission": "the mission estimate of {}",
}
_MAX_LINES = 20
#: Report a tracker that was silent for at least this many steps.
_SILENT = 10
_QUANTITIES = {"position": "", "velocity": " in velocity"}


def subject(agent: str, estimate: str) -> str:
    """An estimate of an agent, in words."""
    return _SUBJECTS.get(estimate, f"{{}} ({estimate})").format(agent)


def innovations(handed_in: Mapping[str, Mapping[str, Any]], nodes: Mapping[str, NodeSpec]) -> dict[str, dict[str, Any]]:
    """The summaries that nodes with a tracker returned as `innovations`, by node.

    They are made anew from the counts: a node may return anything.
    """
    returned = {
        name: Innovations.from_summary(result.get("innovations"))
        for name, result in handed_in.items()
        if name in nodes and nodes[name].role in _TRACKING
    }
    return {name: sums.summary() for name, sums in returned.items() if sums is not None}


def of_metrics(metrics: Mapping[str, Any], trackers: Mapping[str, Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Notices of estimates that are more confident than accurate, and of trackers too uncertain to report anything.

    Each is {"kind", "count", "text"}.

    metrics:  of metrics.json
    trackers: summaries by node, as from `innovations`; their confidence counts only where nothing could be compared
              with the truth
    """
    estimates = [*_estimates(metrics.get("consistency"))]
    texts = [text for text in (_estimate_text(*estimate) for estimate in estimates) if text]
    if not any(summary.get("pairs") for _, _, summaries in estimates for summary in summaries.values()):
        texts += [_tracker_text(name, each) for name, each in trackers.items() if each["verdict"] == OVERCONFIDENT]
    if len(texts) > _MAX_LINES:
        texts = [*texts[:_MAX_LINES], f"{len(texts) - _MAX_LINES} more estimates are more confident than accurate"]
    texts += [_silent_text(name, each["silent"]) for name, each in trackers.items() if each["silent"] >= _SILENT]
    return [{"kind": "confidence", "count": 1, "text": text} for text in texts]


def _estimates(consistency: object) -> Iterator[tuple[str, str, dict[str, Mapping[str, Any]]]]:
    """Agent, estimate and summaries by quantity; a user's evaluator may return anything."""
    for agent, by_estimate in _items(consistency):
        for estimate, by_quantity in _items(by_estimate):
            yield agent, estimate, {name: each for name, each in _items(by_quantity) if isinstance(each, Mapping)}


def _items(value: object) -> list[tuple[str, Any]]:
    items = value.items() if isinstance(value, Mapping) else ()
    return [(name, item) for name, item in items if isinstance(name, str) and name.isprintable()]


def _estimate_text(agent: str, estimate: str, summaries: Mapping[str, Mapping[str, Any]]) -> str:
    """What to say of an estimate; empty: nothing."""
    parts: list[str] = []
    for quantity, words in _QUANTITIES.items():
        summary = summaries.get(quantity, {})
        factor, nees = summary.get("factor"), summary.get("nees")
        if summary.get("verdict") == OVERCONFIDENT and isinstance(factor, float) and isinstance(nees, float):
            more = "" if parts else "more confident than accurate"
            parts.append(f"{_number(factor)} times {more}{words} (NEES {_number(nees)}, expected 2)".replace("  ", " "))
    return f"{subject(agent, estimate)} is {', and '.join(parts)}" if parts else ""


def _tracker_text(node: str, summary: Mapping[str, Any]) -> str:
    return (
        f"the tracker of {node} is {_number(summary['factor'])} times more confident than its measurements bear out "
        f"(NIS {_number(summary['nis'])}, expected {summary['expected']})"
    )


def _silent_text(node: str, steps: int) -> str:
    return (
        f"the tracker of {node} reported none of its tracks in {steps} steps, as the standard deviation of each was "
        "above max_std_m: raise it if the detections are that noisy"
    )


def _number(value: float) -> str:
    return f"{value:.1f}" if value < 100.0 else f"{value:.3g}"
