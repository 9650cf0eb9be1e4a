"""Notices at the end of a run: uncounted messages and overconfident estimates; see `idle` for what did nothing."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from mast_zenoh.config.resolved import NodeSpec, Resolved
from mast_zenoh.mesh.control.results import counts_of
from mast_zenoh.metrics.estimates import subject_of
from mast_zenoh.metrics.study_results import plural
from mast_zenoh.outside import MOST_PUBLISHERS
from mast_zenoh.run_folder.recording import churn
from mast_zenoh.scenario.driving import driver_of_car
from mast_zenoh.tracking.base import OVERCONFIDENT, Innovations
from mast_zenoh.wiring.model import Wiring

#: Other counters of a broker, and what they count.
_DROPPED = {
    "overflowed": "messages dropped by a broker whose buffers were full (capacity)",
    "duplicates": "duplicate messages of an agent for the same frame, left out by a broker",
    "absurd": "tracks that are not physical, left out by a broker",
}
_MAX_KEYS = 3  # that a notice names
_MAX_EVENTS = 10
_MIN_PACE = 0.95  # of the requested frame rate

#: A line at the end of a run, as in run.json: `kind`, `count` and `text`.
Notice = dict[str, Any]


def notice(kind: str, text: str, count: int = 1) -> Notice:
    """A notice; count: of what it is about."""
    return {"kind": kind, "count": count, "text": text}


def of_run(
    resolved: Resolved,
    record: Mapping[str, Any],
    collations: Sequence[Mapping[str, Any]],
    measured: Mapping[str, Any],
    refused: Sequence[str],
    left_out: Mapping[str, int],
) -> Iterator[Notice]:
    """The notices of a run.

    record:     run.json, with its nodes and timings
    collations: the brokers' counters
    measured:   late messages by agent, and in real time the latencies
    refused:    a sentence for each result that was refused
    left_out:   number of tracks by agent that input limits left out
    """
    nodes = record["nodes"]
    parts: list[tuple[str, int, str]] = [
        ("scene", *_first([record["suspicious"]] if "suspicious" in record else [])),
        *(("replay", 1, text) for text in record.get("replay", {}).get("notices", ())),
        ("late", *_late(measured["late"])),
        *((name, *_dropped(name, collations)) for name in _DROPPED),
        ("left_out", *_left_out(left_out)),
        ("rejected", *_rejected(nodes)),
        ("undelivered", *_undelivered(Wiring.from_json(resolved.wiring), nodes)),
        ("foreign", *_foreign(list(nodes.values()))),
        ("control", *_control(record)),
        ("behind", *_behind(resolved, record, measured)),
        ("churn", *_churned(record)),
        ("recording", *_first(of_recording(record))),
        ("disconnected", *_first(record.get("disconnected", ()))),
        *(("outside", *_outside(name, counts)) for name, counts in record.get("outside", {}).items()),
        ("results", len(refused), f"{len(refused)} refused: {'; '.join(refused)}"),
    ]
    return (notice(kind, text, count) for kind, count, text in parts if count)


def of_scores(metrics: Mapping[str, Any], played: int | None = None) -> Iterator[Notice]:
    """Notices of frames that were not measured, and of a run too short to settle.

    metrics: of metrics.json;  played: number of frames, None if unknown
    """
    count = metrics.get("frames")
    if not isinstance(count, int) or not count:
        return
    if played is not None and count < played:
        text = f"{plural(played - count, 'frame')} of {played} were played and not measured: the evaluator missed them"
        yield notice("unmeasured", text, played - count)
    if metrics.get("settled") is False:
        frames = "the only frame is" if count == 1 else f"all {count} frames are"
        text = f"too short to score settled frames alone: {frames} scored, including frames in which tracks begin"
        yield notice("unsettled", text, count)


def _outside(name: str, counts: Mapping[str, Any]) -> tuple[int, str]:
    """(count, text) of what a node received from outside the run, by its own count."""
    text = f"{name} uses a program outside the run, on which the results depend: "
    if not counts:
        return 1, f"{text}it was lost, and nobody counted its answers"
    asked, unanswered, late = counts["asked"], counts["unanswered"], counts["late"]
    if not asked and counts["interrupted"]:
        text += f"{plural(counts['interrupted'], 'message')} had no answer yet when the run was stopped"
    elif not asked:
        text += "it was sent no message"
    elif not (unanswered or late):
        text += f"it answered each of {plural(asked, 'message')}"
    else:
        text += f"{unanswered + late} of {plural(asked, 'message')} had no answer in time"
        text += f", {late} had one later" if late else ""
    for topic, absence in counts["absent"].items():
        text += f"; nothing came on {topic} {absence}"
    for word, what in (("refused", "received message"), ("left_out", "object")):
        reasons = Counter(counts[word])
        if reasons:
            reason, most = min(reasons.items(), key=lambda item: (-item[1], item[0]))
            text += f"; it {word.replace('_', ' ')} {plural(reasons.total(), what)} (most: {most}, {reason})"
    for topic, publishers in counts["publishers"].items():
        if publishers > 1:
            many = f"{publishers} or more" if publishers >= MOST_PUBLISHERS else str(publishers)
            text += f"; {many} publishers sent on {topic}, expected one: any of them may have answered"
    return max(1, unanswered + late), text


def of_commands(cars: object, wiring: Wiring, rejected: Mapping[str, int]) -> Iterator[Notice]:
    """Notices of cars that had no new command in some frames.

    cars: what the simulator counted, by car; rejected: messages that it rejected, by key and reason. Among these are
    commands that cannot be read, which never reach a car.
    """
    by_key: Counter[str] = Counter()
    for key_and_reason, count in rejected.items():
        by_key[key_and_reason.rpartition(": ")[0]] += count
    by_car: Counter[str] = Counter()
    for wire in wiring.wires:
        if wire.message == "command":
            by_car[wire.subject] += sum(by_key[leg.key] for leg in wire.last_legs)
    for car, counts in cars.items() if isinstance(cars, Mapping) else ():
        frames = counts_of(counts)
        held, braked = (frames.get(name, 0) for name in ("held", "braked"))
        if held + braked == 0:
            continue
        text = f"the car of {car} had no new command in {plural(held + braked, 'frame')}"
        text += f": it went on in {held} and braked in {braked}; {plural(by_car[car], 'command')} refused"
        yield notice("commands", text, held + braked)


def of_estimates(driven: object, frames: object) -> Iterator[Notice]:
    """Notices of drivers that had no estimate in some frames.

    driven: of metrics.json, by car; frames: number of frames that were measured
    """
    for car, happened in driven.items() if isinstance(driven, Mapping) else ():
        if blind := counts_of(happened).get("blind_frames", 0):
            text = f"{driver_of_car(str(car))} drove {blind} of {frames} frames without an estimate that is new enough "
            yield notice("estimates", f"{text}(estimate_age_s): it only braked", blind)


def of_brakes(driven: object) -> Iterator[Notice]:
    """Notices of brakes of which it is not known what the driver does on the truth. driven: of metrics.json, by car"""
    for car, happened in driven.items() if isinstance(driven, Mapping) else ():
        brakes = happened.get("brakes") if isinstance(happened, Mapping) else None
        of_model = [
            brake
            for brake in (brakes if isinstance(brakes, list) else ())
            if isinstance(brake, Mapping) and brake.get("on_truth_mps2", 0.0) is None
        ]
        if of_model:
            text = f"{plural(len(of_model), 'brake')} of {car} judged by the intelligent driver model, not by what its "
            text += f"driver does on the truth: {happened.get('on_truth_problem') or 'the truth or its route was lost'}"
            yield notice("brakes", text, len(of_model))


def _late(late: Mapping[str, int]) -> tuple[int, str]:
    count, agents = sum(late.values()), [agent for agent in late if late[agent]]
    if not count:
        return 0, ""
    worst = max(agents, key=lambda agent: late[agent])
    source = worst if len(agents) == 1 else f"{len(agents)} agents"
    detail = "" if len(agents) == 1 else f" (most: {worst}, {late[worst]})"
    return count, f"{plural(count, 'message')} of {source} came too late for their batch{detail}"


def _dropped(name: str, collations: Sequence[Mapping[str, Any]]) -> tuple[int, str]:
    count = sum(collation.get(name, 0) for collation in collations)
    return count, f"{count} {_DROPPED[name]}"


def _left_out(left_out: Mapping[str, int]) -> tuple[int, str]:
    """(count, text) of the tracks that input limits left out."""
    agents = [f"{agent}: {count}" for agent, count in left_out.items() if count]
    text = f"tracks not fused, as too many were sent by {first_three(agents)}: see input_limit"
    return sum(left_out.values()), text


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
    text = f"{plural(by_key.total(), 'message')} on {plural(len(by_key), 'key')}"
    if first:
        _, key, name, reason = min(first)
        text = f"{text} (first, by {name}: {key}: {reason})"
    return by_key.total(), text


def _undelivered(wiring: Wiring, nodes: Mapping[str, Mapping[str, Any]]) -> tuple[int, str]:
    """(count, text) of wires on which a publisher sent nothing but messages that all subscribers rejected."""
    parts = []
    for wire, leg in wiring.legs():
        ends = [end.node for end in leg.subscribers]
        if not ends or not all(leg.key in (nodes.get(name, {}).get("unaccepted") or ()) for name in ends):
            continue
        # The publisher knows why its message cannot be sent, the subscribers what came instead.
        firsts = [nodes.get(name, {}).get("first_rejected") or {} for name in (leg.publisher.node, *ends)]
        _, reason = next((first[leg.key] for first in firsts if leg.key in first), (0, "no reason is known"))
        parts.append(f"{wire.key} ({leg.publisher.node} to {', '.join(ends)}: {reason})")
    more = f"; and {len(parts) - _MAX_KEYS} more" if len(parts) > _MAX_KEYS else ""
    text = f"all messages were rejected on {plural(len(parts), 'wire')}: {'; '.join(parts[:_MAX_KEYS])}{more}"
    return len(parts), text


def _foreign(nodes: Sequence[Mapping[str, Any]]) -> tuple[int, str]:
    """(count, text) of foreign messages: per key, the largest count of a subscriber."""
    by_key: Counter[str] = Counter()
    for node in nodes:
        by_key |= Counter(node.get("foreign") or {})
    found = plural(by_key.total(), "message")
    return by_key.total(), f"{found} without the mark of this run's nodes, on {first_three(sorted(by_key))}"


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
        parts.append(f"{plural(_total(by_launcher), 'invalid control message')} refused on {_largest(by_launcher)}")
    if by_nodes:
        parts.append(f"nodes report {_total(by_nodes)} invalid control messages on {_largest(by_nodes)}")
    return _total(by_launcher) + _total(by_nodes), "; ".join(parts)


def _total(refusals: Mapping[str, tuple[int, str, str]]) -> int:
    return sum(count for count, _, _ in refusals.values())


def _largest(refusals: Mapping[str, tuple[int, str, str]]) -> str:
    """The number of keys, and the details of the one with the largest count."""
    key = max(sorted(refusals), key=lambda key: refusals[key][0])
    count, reporter, reason = refusals[key]
    return f"{plural(len(refusals), 'key')} (most: {key}, {count}{reporter}, the first: {reason})"


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
        reasons.append(f"{plural(late, 'message')} came too late for their batch")
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


def first_three(names: Sequence[str]) -> str:
    """The first three names, and how many more there are."""
    return ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")


#: Roles of nodes with a tracker.
_TRACKING = ("agent", "command_center")
_MAX_LINES = 20
#: Report a tracker that was silent for at least this many steps.
_SILENT = 10
_QUANTITIES = {"position": "", "velocity": " in velocity"}


def tracker_innovations(
    handed_in: Mapping[str, Mapping[str, Any]], nodes: Mapping[str, NodeSpec]
) -> dict[str, dict[str, Any]]:
    """The summaries that nodes with a tracker returned as `innovations`, by node.

    They are made anew from the counts: a node may return anything.
    """
    returned = {
        name: Innovations.from_summary(result.get("innovations"))
        for name, result in handed_in.items()
        if name in nodes and nodes[name].role in _TRACKING
    }
    return {name: sums.summary() for name, sums in returned.items() if sums is not None}


def of_confidence(metrics: Mapping[str, Any], trackers: Mapping[str, Mapping[str, Any]]) -> Iterator[Notice]:
    """Notices of estimates that are more confident than accurate, and of trackers too uncertain to report anything.

    metrics:  of metrics.json
    trackers: summaries by node, as from `tracker_innovations`; their confidence counts only where nothing could be
              compared with the truth
    """
    estimates = [*_estimates(metrics.get("consistency"))]
    own_pictures = "pictures" in metrics
    texts = [
        text
        for agent, estimate, summaries in estimates
        if (text := _estimate_text(subject_of(agent, estimate, own_pictures), summaries))
    ]
    if not any(summary.get("pairs") for _, _, summaries in estimates for summary in summaries.values()):
        texts += [_tracker_text(name, each) for name, each in trackers.items() if each["verdict"] == OVERCONFIDENT]
    if len(texts) > _MAX_LINES:
        texts = [*texts[:_MAX_LINES], f"{len(texts) - _MAX_LINES} more estimates are more confident than accurate"]
    texts += [_silent_text(name, each["silent"]) for name, each in trackers.items() if each["silent"] >= _SILENT]
    return (notice("confidence", text) for text in texts)


def _estimates(consistency: object) -> Iterator[tuple[str, str, dict[str, Mapping[str, Any]]]]:
    """Agent, estimate and summaries by quantity; a user's evaluator may return anything."""
    for agent, by_estimate in _items(consistency):
        for estimate, by_quantity in _items(by_estimate):
            yield agent, estimate, {name: each for name, each in _items(by_quantity) if isinstance(each, Mapping)}


def _items(value: object) -> list[tuple[str, Any]]:
    items = value.items() if isinstance(value, Mapping) else ()
    return [(name, item) for name, item in items if isinstance(name, str) and name.isprintable()]


def _estimate_text(subject: str, summaries: Mapping[str, Mapping[str, Any]]) -> str:
    """What to say of an estimate; empty: nothing. subject: of the sentence"""
    parts: list[str] = []
    for quantity, words in _QUANTITIES.items():
        summary = summaries.get(quantity, {})
        factor, nees = summary.get("factor"), summary.get("nees")
        if summary.get("verdict") == OVERCONFIDENT and isinstance(factor, float) and isinstance(nees, float):
            more = "" if parts else "more confident than accurate"
            parts.append(f"{_number(factor)} times {more}{words} (NEES {_number(nees)}, expected 2)".replace("  ", " "))
    return f"{subject} is {', and '.join(parts)}" if parts else ""


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
