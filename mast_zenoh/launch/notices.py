"""Notices at the end of a run, such as late, rejected or foreign messages."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from mast_zenoh.config.resolved import Resolved
from mast_zenoh.messagelog import churn

#: Other counters of a broker, and what they count.
_DROPPED = {
    "overflowed": "messages dropped by a broker whose buffers were full (capacity)",
    "duplicates": "duplicate messages of an agent for the same frame, left out by a broker",
    "absurd": "tracks that are not physical, left out by a broker",
}
_MAX_KEYS = 3  # that a notice names
_MAX_EVENTS = 10
_MIN_PACE = 0.95  # of the requested frame rate


def of_run(
    resolved: Resolved,
    record: Mapping[str, Any],
    collations: Sequence[Mapping[str, Any]],
    measured: Mapping[str, Any],
    refused: Sequence[str],
) -> list[dict[str, Any]]:
    """The notices of a run, each as {"kind", "count", "text"}.

    record:     run.json, with its nodes and timings
    collations: the brokers' counters
    measured:   late messages by agent, and in real time the latencies
    refused:    a sentence for each result that was refused
    """
    nodes = record["nodes"]
    parts = [
        _late(measured["late"]),
        *(_dropped(name, collations) for name in _DROPPED),
        _rejected(nodes),
        _foreign(list(nodes.values())),
        _control(record),
        _behind(resolved, record, measured),
        _churned(record),
        _first(of_recording(record)),
        _first(record.get("disconnected", ())),
        (len(refused), f"{len(refused)} refused: {'; '.join(refused)}"),
    ]
    tail = ("rejected", "foreign", "control", "behind", "churn", "recording", "disconnected", "results")
    kinds = ("late", *_DROPPED, *tail)
    of_nodes = [
        {"kind": kind, "count": count, "text": text} for kind, (count, text) in zip(kinds, parts, strict=True) if count
    ]
    return [
        *({"kind": "replay", "count": 1, "text": text} for text in record.get("replay", {}).get("notices", ())),
        *of_nodes,
    ]


def of_scores(metrics: Mapping[str, Any], played: int | None = None) -> list[dict[str, Any]]:
    """Notices of frames that were not measured, and of a run too short to settle.

    metrics: of metrics.json;  played: number of frames, None if unknown
    """
    count = metrics.get("frames")
    if not isinstance(count, int) or not count:
        return []
    notices = []
    if played is not None and count < played:
        text = f"{number(played - count, 'frame')} of {played} were played and not measured: the evaluator missed them"
        notices.append({"kind": "unmeasured", "count": played - count, "text": text})
    if metrics.get("settled") is not False:
        return notices
    frames = "the only frame is" if count == 1 else f"all {count} frames are"
    text = f"too short to score settled frames alone: {frames} scored, including frames in which tracks begin"
    return [*notices, {"kind": "unsettled", "count": count, "text": text}]


def _late(late: Mapping[str, int]) -> tuple[int, str]:
    count, agents = sum(late.values()), [agent for agent in late if late[agent]]
    if not count:
        return 0, ""
    worst = max(agents, key=lambda agent: late[agent])
    source = worst if len(agents) == 1 else f"{len(agents)} agents"
    detail = "" if len(agents) == 1 else f" (most: {worst}, {late[worst]})"
    return count, f"{number(count, 'message')} of {source} came too late for their batch{detail}"


def _dropped(name: str, collations: Sequence[Mapping[str, Any]]) -> tuple[int, str]:
    count = sum(collation.get(name, 0) for collation in collations)
    return count, f"{count} {_DROPPED[name]}"


def _rejected(nodes: Mapping[str, Mapping[str, Any]]) -> tuple[int, str]:
    """(count, text) of rejected messages: per key, the largest count of a subscriber.

    All subscribers of a key get the same messages. Only one node reports which came first, so the text names it.
    """
    by_key: Counter[str] = Counter()
    first: list[tuple[int, str, str, str]] = []
    for name, node in nodes.items():
        counts: Counter[str] = Counter()
        for key_and_reason, count in (node.get("rejected") or {}).items():
            counts[key_and_reason.rpartition(": ")[0]] += count
        by_key |= counts
        first += [(frame, key, name, reason) for key, (frame, reason) in (node.get("first_rejected") or {}).items()]
    if not by_key:
        return 0, ""
    text = f"{number(by_key.total(), 'message')} on {number(len(by_key), 'key')}"
    if first:
        _, key, name, reason = min(first)
        text = f"{text} (first, by {name}: {key}: {reason})"
    return by_key.total(), text


def _foreign(nodes: Sequence[Mapping[str, Any]]) -> tuple[int, str]:
    """(count, text) of foreign messages: per key, the largest count of a subscriber."""
    by_key: Counter[str] = Counter()
    for node in nodes:
        by_key |= Counter(node.get("foreign") or {})
    keys = sorted(by_key)
    more = f" and {len(keys) - _MAX_KEYS} more" if len(keys) > _MAX_KEYS else ""
    where = f"{', '.join(keys[:_MAX_KEYS])}{more}"
    return by_key.total(), f"{number(by_key.total(), 'message')} without the mark of this run's nodes, on {where}"


def _control(record: Mapping[str, Any]) -> tuple[int, str]:
    """(count, text) of control messages that the launcher or nodes refused.

    Every node refuses a message to all: per key, the largest count of a node counts.
    """
    by_launcher = {key: (count, "", reason) for key, (count, reason) in record.get("invalid_control", {}).items()}
    by_nodes: dict[str, tuple[int, str, str]] = {}
    for name, node in record["nodes"].items():
        for key, (count, reason) in (node.get("invalid_control") or {}).items():
            by_nodes[key] = max(
                by_nodes.get(key, (0, "", "")), (count, f" by {name}", reason), key=lambda refusal: refusal[0]
            )
    parts = []
    if by_launcher:
        parts.append(f"{number(_total(by_launcher), 'invalid control message')} refused on {_largest(by_launcher)}")
    if by_nodes:
        parts.append(f"nodes report {_total(by_nodes)} invalid control messages on {_largest(by_nodes)}")
    return _total(by_launcher) + _total(by_nodes), "; ".join(parts)


def _total(refusals: Mapping[str, tuple[int, str, str]]) -> int:
    return sum(count for count, _, _ in refusals.values())


def _largest(refusals: Mapping[str, tuple[int, str, str]]) -> str:
    """The number of keys, and the details of the one with the largest count."""
    key = max(sorted(refusals), key=lambda key: refusals[key][0])
    count, reporter, reason = refusals[key]
    return f"{number(len(refusals), 'key')} (most: {key}, {count}{reporter}, the first: {reason})"


def _churned(record: Mapping[str, Any]) -> tuple[int, str]:
    """(count, text) of nodes that were lost or came back."""
    events = record.get("churn", ())
    more = f"; and {len(events) - _MAX_EVENTS} more times" if len(events) > _MAX_EVENTS else ""
    return len(events), churn.sentence(events[:_MAX_EVENTS]) + more


def of_recording(record: Mapping[str, Any]) -> list[str]:
    """A sentence if the recording is incomplete; record: run.json."""
    recording = record.get("recording", {})
    if recording.get("complete", True):
        return []
    return [f"the recording is incomplete from frame {recording['from_frame']} onwards"]


def _first(sentences: Sequence[str]) -> tuple[int, str]:
    return len(sentences), next(iter(sentences), "")


def _behind(resolved: Resolved, record: Mapping[str, Any], measured: Mapping[str, Any]) -> tuple[int, str]:
    """(count, text) of the signs that a real-time run did not keep up with its clock."""
    if "latency_ms" not in measured:
        return 0, ""
    period_ms = resolved.period_ns * 1e-6 / resolved.rate
    reasons = []
    p99 = measured["latency_ms"]["sim_to_picture"]["p99"]
    if p99 is not None and p99 > _longest_wait_ms(resolved):
        delay = f"1 % of the pictures came {p99:.0f} ms or more after their frame was sent"
        reasons.append(f"{delay}, and a frame lasts {period_ms:.0f} ms")
    speed = record["timings"].get("frames_per_second")
    if speed is not None and speed < _MIN_PACE * 1e3 / period_ms:
        reasons.append(f"it played {speed:.1f} frames/s instead of {1e3 / period_ms:.1f}")
    late = sum(measured["late"].values())
    if late and not any(entry["kind"] != "attack" for entry in resolved.timeline):
        reasons.append(f"{number(late, 'message')} came too late for their batch")
    advice = "lower --rate, use more cores, or raise latency_s or patience of the broker"
    return len(reasons), f"this run did not keep up with real time: {'; '.join(reasons)}: {advice}"


def _longest_wait_ms(resolved: Resolved) -> float:
    """ms on the wall clock that a picture may take in a run that keeps up.

    The broker waits for a silent agent, by its configuration `patience` frames and one more, or `latency_s`; then it
    takes up to a frame to compute the picture.
    """
    config = next((spec.config for spec in resolved.nodes.values() if spec.role == "broker"), {})
    wait_frames = max(config.get("patience", 0) + 1, config.get("latency_s", 0.0) * 1e9 / resolved.period_ns + 1)
    return float(wait_frames + 1) * resolved.period_ns * 1e-6 / resolved.rate


def number(count: int, noun: str) -> str:
    """A count with its noun: "1 message", "2 messages"."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"
