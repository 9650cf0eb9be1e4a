"""What deserves attention at the end of a run though it failed nothing, such as late, rejected or foreign messages."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from mast_zenoh.config.resolved import Resolved
from mast_zenoh.messagelog import churn

#: Other counters of a broker, and what they count.
_LEFT_OUT = {
    "overflowed": "messages dropped by a broker whose buffers were full (capacity)",
    "duplicates": "messages that an agent had sent for the same frame before, left out by a broker",
    "absurd": "tracks that are not physical, left out by a broker",
}
_KEYS_NAMED = 3
_EVENTS_NAMED = 10
_KEEPS_PACE = 0.95  # of the frame rate that was asked for


def of_run(
    resolved: Resolved,
    record: Mapping[str, Any],
    collations: Sequence[Mapping[str, Any]],
    measured: Mapping[str, Any],
    refused: Sequence[str],
) -> list[dict[str, Any]]:
    """The notices of a run, each as {"kind", "count", "text"}; none for what did not happen.

    record:     run.json, with its nodes and timings
    collations: what brokers have counted
    measured:   late messages by agent, and in real time the latencies
    refused:    a sentence for each result that was refused
    """
    nodes = record["nodes"]
    parts = [
        _late(measured["late"]),
        *(_left_out(name, collations) for name in _LEFT_OUT),
        _rejected(nodes),
        _foreign(list(nodes.values())),
        _control(record),
        _behind(resolved, record, measured),
        _churned(record),
        _first(of_recording(record)),
        (len(refused), f"{len(refused)} refused: {'; '.join(refused)}"),
    ]
    kinds = ("late", *_LEFT_OUT, "rejected", "foreign", "control", "behind", "churn", "recording", "results")
    return [
        {"kind": kind, "count": count, "text": text} for kind, (count, text) in zip(kinds, parts, strict=True) if count
    ]


def of_scores(metrics: Mapping[str, Any], played: int | None = None) -> list[dict[str, Any]]:
    """The notices of a run that was not measured whole, or is too short to leave out the frames in which tracks begin.

    metrics: of metrics.json;  played: frames, None where that is not known
    """
    count = metrics.get("frames")
    if not isinstance(count, int) or not count:
        return []
    found = []
    if played is not None and count < played:
        text = f"{_number(played - count, 'frame')} of {played} were played and not measured: the evaluator missed them"
        found.append({"kind": "unmeasured", "count": played - count, "text": text})
    if metrics.get("settled") is not False:
        return found
    frames = "the only frame is" if count == 1 else f"all {count} frames are"
    text = f"too short to score settled frames alone: {frames} scored, those in which tracks begin included"
    return [*found, {"kind": "unsettled", "count": count, "text": text}]


def _late(late: Mapping[str, int]) -> tuple[int, str]:
    count, agents = sum(late.values()), [agent for agent in late if late[agent]]
    if not count:
        return 0, ""
    most = max(agents, key=lambda agent: late[agent])
    of = most if len(agents) == 1 else f"{len(agents)} agents"
    detail = "" if len(agents) == 1 else f" (most: {most}, {late[most]})"
    return count, f"{_number(count, 'message')} of {of} came too late for their batch{detail}"


def _left_out(name: str, collations: Sequence[Mapping[str, Any]]) -> tuple[int, str]:
    count = sum(collation.get(name, 0) for collation in collations)
    return count, f"{count} {_LEFT_OUT[name]}"


def _rejected(nodes: Mapping[str, Mapping[str, Any]]) -> tuple[int, str]:
    """Of each key the node that rejected most counts: its other subscribers rejected the same messages.

    Which messages came first is one node's word, so that node is named.
    """
    by_key: Counter[str] = Counter()
    first: list[tuple[int, str, str, str]] = []
    for name, node in nodes.items():
        own: Counter[str] = Counter()
        for place, count in (node.get("rejected") or {}).items():
            own[place.rpartition(": ")[0]] += count
        by_key |= own
        first += [(frame, key, name, reason) for key, (frame, reason) in (node.get("first_rejected") or {}).items()]
    if not by_key:
        return 0, ""
    what = f"{_number(by_key.total(), 'message')} on {_number(len(by_key), 'key')}"
    if first:
        _, key, name, reason = min(first)
        what = f"{what} (first, by {name}: {key}: {reason})"
    return by_key.total(), what


def _foreign(nodes: Sequence[Mapping[str, Any]]) -> tuple[int, str]:
    """Of each key the node that heard most counts."""
    by_key: Counter[str] = Counter()
    for node in nodes:
        by_key |= Counter(node.get("foreign") or {})
    keys = sorted(by_key)
    more = f" and {len(keys) - _KEYS_NAMED} more" if len(keys) > _KEYS_NAMED else ""
    where = f"{', '.join(keys[:_KEYS_NAMED])}{more}"
    return by_key.total(), f"{_number(by_key.total(), 'message')} without the mark of this run's nodes, on {where}"


def _control(record: Mapping[str, Any]) -> tuple[int, str]:
    """Control messages that were refused: by the launcher, and, in their own words, by the nodes.

    A message to all is refused by every node: of each key the node that says most counts.
    """
    own = {key: (count, "", reason) for key, (count, reason) in record.get("invalid_control", {}).items()}
    told: dict[str, tuple[int, str, str]] = {}
    for name, node in record["nodes"].items():
        for key, (count, reason) in (node.get("invalid_control") or {}).items():
            told[key] = max(told.get(key, (0, "", "")), (count, f" by {name}", reason), key=lambda found: found[0])
    parts = []
    if own:
        parts.append(f"{_number(_total(own), 'invalid control message')} refused on {_most(own)}")
    if told:
        parts.append(f"nodes report {_total(told)} invalid control messages on {_most(told)}")
    return _total(own) + _total(told), "; ".join(parts)


def _total(found: Mapping[str, tuple[int, str, str]]) -> int:
    return sum(count for count, _, _ in found.values())


def _most(found: Mapping[str, tuple[int, str, str]]) -> str:
    """On how many keys, and what of the one with most."""
    key = max(sorted(found), key=lambda key: found[key][0])
    count, by, reason = found[key]
    return f"{_number(len(found), 'key')} (most: {key}, {count}{by}, the first: {reason})"


def _churned(record: Mapping[str, Any]) -> tuple[int, str]:
    """Nodes that were lost, and came back."""
    found = record.get("churn", ())
    more = f"; and {len(found) - _EVENTS_NAMED} more times" if len(found) > _EVENTS_NAMED else ""
    return len(found), churn.sentence(found[:_EVENTS_NAMED]) + more


def of_recording(record: Mapping[str, Any]) -> list[str]:
    """A sentence if the recording lacks what its recorder did not hear; record: run.json."""
    found = record.get("recording", {})
    return [] if found.get("complete", True) else [f"the recording is incomplete from frame {found['from_frame']} on"]


def _first(sentences: Sequence[str]) -> tuple[int, str]:
    return len(sentences), next(iter(sentences), "")


def _behind(resolved: Resolved, record: Mapping[str, Any], measured: Mapping[str, Any]) -> tuple[int, str]:
    """A run in real time that did not keep up with its clock."""
    if "latency_ms" not in measured:
        return 0, ""
    period_ms = resolved.period_ns * 1e-6 / resolved.rate
    reasons = []
    p99 = measured["latency_ms"]["sim_to_picture"]["p99"]
    if p99 is not None and p99 > _longest_wait_ms(resolved):
        after = f"1 % of the pictures came {p99:.0f} ms or more after their frame was sent"
        reasons.append(f"{after}, and a frame lasts {period_ms:.0f} ms")
    speed = record["timings"].get("frames_per_second")
    if speed is not None and speed < _KEEPS_PACE * 1e3 / period_ms:
        reasons.append(f"it played {speed:.1f} frames/s instead of {1e3 / period_ms:.1f}")
    late = sum(measured["late"].values())
    if late and not any(entry["kind"] != "attack" for entry in resolved.timeline):
        reasons.append(f"{_number(late, 'message')} came too late for their batch")
    advice = "lower --rate, use more cores, or raise latency_s or patience of the broker"
    return len(reasons), f"this run did not keep up with real time: {'; '.join(reasons)}: {advice}"


def _longest_wait_ms(resolved: Resolved) -> float:
    """How long a picture may take on the wall clock though nothing is slow.

    The broker waits for a silent agent, by its configuration `patience` frames and one more, or `latency_s`; then it
    takes up to a frame to compute the picture.
    """
    config = next((spec.config for spec in resolved.nodes.values() if spec.role == "broker"), {})
    waits = max(config.get("patience", 0) + 1, config.get("latency_s", 0.0) * 1e9 / resolved.period_ns + 1)
    return float(waits + 1) * resolved.period_ns * 1e-6 / resolved.rate


def _number(count: int, noun: str) -> str:
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"
