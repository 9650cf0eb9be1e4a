"""Findings at the end of a run: uncounted messages and overconfident estimates; see `idle` for what did nothing."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

from mast_zenoh.config.resolved import NodeSpec, Resolved
from mast_zenoh.errors import plural
from mast_zenoh.mesh.control.results import counts_of
from mast_zenoh.metrics.estimates import subject_of
from mast_zenoh.outside import MOST_PUBLISHERS
from mast_zenoh.run_folder.finding import Finding
from mast_zenoh.run_folder.recording import churn
from mast_zenoh.scenario.driving import driver_of_car
from mast_zenoh.tracking.base import OVERCONFIDENT, Innovations
from mast_zenoh.wiring.model import Wiring

#: Counters of a broker, besides late messages.
_DROPPED = ("overflowed", "duplicates", "absurd")
_MIN_PACE = 0.95  # of the requested frame rate


def of_run(
    resolved: Resolved,
    record: Mapping[str, Any],
    collations: Sequence[Mapping[str, Any]],
    measured: Mapping[str, Any],
    refused: Sequence[str],
    left_out: Mapping[str, int],
) -> Iterator[Finding]:
    """What was lost, refused or late in a run, and what else its record says.

    record:     run.json, with its nodes and timings
    collations: the brokers' counters
    measured:   late messages by agent, and in real time the latencies
    refused:    a sentence for each result that was refused
    left_out:   number of tracks by agent that input limits left out
    """
    nodes = record["nodes"]
    if "suspicious" in record:
        yield Finding("scene", cause=(record["suspicious"],))
    yield from (Finding("replay", cause=(text,)) for text in record.get("replay", {}).get("notices", ()))
    yield from _late(measured["late"])
    for kind in _DROPPED:
        if count := sum(collation.get(kind, 0) for collation in collations):
            yield Finding(kind, value=count)
    if shortened := {agent: count for agent, count in left_out.items() if count}:
        by_agent = tuple(f"{agent}: {count}" for agent, count in shortened.items())
        yield Finding("left_out", tuple(shortened), value=sum(shortened.values()), unit="tracks", cause=by_agent)
    yield from of_rejected(nodes)
    yield from _undelivered(Wiring.from_json(resolved.wiring), nodes)
    yield from _foreign(list(nodes.values()))
    yield from _control(record)
    yield from _behind(resolved, record, measured)
    if events := record.get("churn", ()):
        gone = tuple(dict.fromkeys(event["node"] for event in events))
        yield Finding("churn", gone, value=len(events), cause=tuple(churn.sentence([event]) for event in events))
    yield from of_recording(record)
    yield from (Finding("disconnected", cause=(text,)) for text in record.get("disconnected", ()))
    yield from (_outside(name, counts) for name, counts in record.get("outside", {}).items())
    if refused:
        yield Finding("results", value=len(refused), cause=tuple(refused))


def of_scores(metrics: Mapping[str, Any], played: int | None = None) -> Iterator[Finding]:
    """Frames that were not measured, and a run too short to settle.

    metrics: of metrics.json;  played: number of frames, None if unknown
    """
    count = metrics.get("frames")
    if not isinstance(count, int) or not count:
        return
    if played is not None and count < played:
        yield Finding("unmeasured", value=played - count, other=played, unit="frames")
    if metrics.get("settled") is False:
        yield Finding("unsettled", value=count, unit="frames")


def _outside(name: str, counts: Mapping[str, Any]) -> Finding:
    """What a node received from outside the run, by its own count."""
    if not counts:
        return Finding("outside", (name,), "lost")
    asked, missing, late = counts["asked"], counts["unanswered"] + counts["late"], counts["late"]
    details = [f"{late} had one later"] * bool(asked and late)
    details += [f"nothing came on {topic} {absence}" for topic, absence in counts["absent"].items()]
    for word, what in (("refused", "received message"), ("left_out", "object")):
        reasons = Counter(counts[word])
        if reasons:
            reason, most = min(reasons.items(), key=lambda item: (-item[1], item[0]))
            number = plural(reasons.total(), what)
            details.append(f"it {word.replace('_', ' ')} {number} (most: {most}, {reason})")
    for topic, publishers in counts["publishers"].items():
        if publishers > 1:
            many = f"{publishers} or more" if publishers >= MOST_PUBLISHERS else str(publishers)
            details.append(f"{many} publishers sent on {topic}, expected one: any of them may have answered")
    if not asked and counts["interrupted"]:
        return Finding("outside", (name,), "interrupted", counts["interrupted"], cause=tuple(details))
    return Finding("outside", (name,), "", missing, asked, "messages", cause=tuple(details))


def of_commands(cars: object, wiring: Wiring, rejected: Mapping[str, int]) -> Iterator[Finding]:
    """Cars that had no new command in some frames.

    cars: what the simulator counted, by car; rejected: messages that it rejected, by key and reason. Among these are
    commands that cannot be read, which never reach a car.
    """
    by_key = _by_key(rejected)
    by_car: Counter[str] = Counter()
    for wire in wiring.wires:
        if wire.message == "command":
            by_car[wire.subject] += sum(by_key[leg.key] for leg in wire.last_legs)
    for car, counts in cars.items() if isinstance(cars, Mapping) else ():
        frames = counts_of(counts)
        held, braked = (frames.get(name, 0) for name in ("held", "braked"))
        if held + braked:
            refused = f"{plural(by_car[car], 'command')} refused"
            yield Finding("commands", (str(car),), "", held + braked, braked, "frames", cause=(refused,))


def of_estimates(driven: object, frames: object) -> Iterator[Finding]:
    """Drivers that had no estimate in some frames.

    driven: of metrics.json, by car; frames: number of frames that were measured
    """
    for car, happened in driven.items() if isinstance(driven, Mapping) else ():
        if (blind := counts_of(happened).get("blind_frames", 0)) and isinstance(frames, int):
            yield Finding("estimates", (driver_of_car(str(car)),), "", blind, frames, "frames")


def of_brakes(driven: object) -> Iterator[Finding]:
    """Brakes of which it is not known what the driver does on the truth. driven: of metrics.json, by car"""
    for car, happened in driven.items() if isinstance(driven, Mapping) else ():
        brakes = happened.get("brakes") if isinstance(happened, Mapping) else None
        of_model = [
            brake
            for brake in (brakes if isinstance(brakes, list) else ())
            if isinstance(brake, Mapping) and brake.get("on_truth_mps2", 0.0) is None
        ]
        if of_model:
            why = str(happened.get("on_truth_problem") or "the truth or its route was lost")
            yield Finding("brakes", (str(car),), value=len(of_model), unit="brakes", cause=(why,))


def _late(late: Mapping[str, int]) -> Iterator[Finding]:
    """Late messages, the agent with most of them first, whose number is `other`."""
    agents = sorted((agent for agent in late if late[agent]), key=lambda agent: -late[agent])
    if agents:
        yield Finding("late", tuple(agents), "", sum(late.values()), late[agents[0]], "messages")


def _by_key(rejected: Mapping[str, int]) -> Counter[str]:
    """Messages by key, from those by key and reason."""
    counts: Counter[str] = Counter()
    for key_and_reason, count in rejected.items():
        counts[key_and_reason.rpartition(": ")[0]] += count
    return counts


def of_rejected(nodes: Mapping[str, Mapping[str, Any]]) -> Iterator[Finding]:
    """Rejected messages and, as `other`, their keys: per key, the largest count of a subscriber.

    All subscribers of a key get the same messages. Only one node reports which came first: `who`.
    """
    by_key: Counter[str] = Counter()
    first: list[tuple[int, str, str, str]] = []
    for name, node in nodes.items():
        by_key |= _by_key(node.get("rejected") or {})
        first += [(frame, key, name, reason) for key, (frame, reason) in (node.get("first_rejected") or {}).items()]
    if not by_key:
        return
    found = Finding("rejected", value=by_key.total(), other=len(by_key), unit="messages")
    if first:
        _, key, name, reason = min(first)
        found = replace(found, who=(name,), where=key, cause=(reason,))
    yield found


def _undelivered(wiring: Wiring, nodes: Mapping[str, Mapping[str, Any]]) -> Iterator[Finding]:
    """Wires on which a publisher, of `who`, sent nothing but messages that all subscribers rejected."""
    parts, publishers = [], []
    for wire, leg in wiring.legs():
        ends = [end.node for end in leg.subscribers]
        if not ends or not all(leg.key in (nodes.get(name, {}).get("unaccepted") or ()) for name in ends):
            continue
        # The publisher knows why its message cannot be sent, the subscribers what came instead.
        firsts = [nodes.get(name, {}).get("first_rejected") or {} for name in (leg.publisher.node, *ends)]
        _, reason = next((first[leg.key] for first in firsts if leg.key in first), (0, "no reason is known"))
        parts.append(f"{wire.key} ({leg.publisher.node} to {', '.join(ends)}: {reason})")
        publishers.append(leg.publisher.node)
    if parts:
        who = tuple(dict.fromkeys(publishers))
        yield Finding("undelivered", who, value=len(parts), unit="wires", cause=tuple(parts))


def _foreign(nodes: Sequence[Mapping[str, Any]]) -> Iterator[Finding]:
    """Foreign messages: per key, of `cause`, the largest count of a subscriber."""
    by_key: Counter[str] = Counter()
    for node in nodes:
        by_key |= Counter(node.get("foreign") or {})
    if by_key:
        yield Finding("foreign", value=by_key.total(), unit="messages", cause=tuple(sorted(by_key)))


def _control(record: Mapping[str, Any]) -> Iterator[Finding]:
    """Control messages that the launcher, or else nodes, refused; where most of them came, and by whose count.

    Every node refuses a message to all: per key, the largest count of a node counts.
    """
    of_launcher = record.get("invalid_control", {})
    by_launcher = {key: (count, "the launcher", reason) for key, (count, reason) in of_launcher.items()}
    by_nodes: dict[str, tuple[int, str, str]] = {}
    for name, node in record["nodes"].items():
        for key, (count, reason) in (node.get("invalid_control") or {}).items():
            by_nodes[key] = max(by_nodes.get(key, (0, "", "")), (count, name, reason), key=lambda refusal: refusal[0])
    for refusals in (by_launcher, by_nodes):
        if refusals:
            key = max(sorted(refusals), key=lambda key: refusals[key][0])
            _, reporter, reason = refusals[key]
            total = sum(count for count, _, _ in refusals.values())
            yield Finding("control", (reporter,), "", total, len(refusals), "messages", key, None, (reason,))


def of_recording(record: Mapping[str, Any]) -> list[Finding]:
    """From which frame on the recording is incomplete, if it is; record: run.json."""
    recording = record.get("recording", {})
    complete = recording.get("complete", True)
    return [] if complete else [Finding("recording", value=recording["from_frame"], unit="frame")]


def _behind(resolved: Resolved, record: Mapping[str, Any], measured: Mapping[str, Any]) -> Iterator[Finding]:
    """The signs that a real-time run did not keep up with its clock: late messages alone only without a link."""
    if "latency_ms" not in measured:
        return
    period_ms = resolved.period_ns * 1e-6 / resolved.rate
    p99, slow = measured["latency_ms"]["sim_to_picture"]["p99"], False
    if p99 is not None and p99 > _longest_wait_ms(resolved):
        slow = True
        yield Finding("behind", what="pictures", value=p99, other=period_ms, unit="ms")
    speed = record["timings"].get("frames_per_second")
    if speed is not None and speed < _MIN_PACE * 1e3 / period_ms:
        slow = True
        yield Finding("behind", what="frames", value=speed, other=1e3 / period_ms, unit="frames/s")
    late = sum(measured["late"].values())
    if late and not slow and not any(entry["kind"] != "attack" for entry in resolved.timeline):
        yield Finding("behind", what="messages", value=late, unit="messages")


def _longest_wait_ms(resolved: Resolved) -> float:
    """ms on the wall clock that a picture may take in a run that keeps up.

    The broker waits for a silent agent, by its configuration `patience` frames and one more, or `latency_s`; then it
    takes up to a frame to compute the picture.
    """
    config = next((spec.config for spec in resolved.nodes.values() if spec.role == "broker"), {})
    wait_frames = max(config.get("patience", 0) + 1, config.get("latency_s", 0.0) * 1e9 / resolved.period_ns + 1)
    return float(wait_frames + 1) * resolved.period_ns * 1e-6 / resolved.rate


#: Roles of nodes with a tracker.
_TRACKING = ("agent", "command_center")
_MOST_ESTIMATES = 20
#: Report a tracker that was silent for at least this many steps.
_SILENT = 10


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


def of_confidence(metrics: Mapping[str, Any], trackers: Mapping[str, Mapping[str, Any]]) -> Iterator[Finding]:
    """Estimates that are more confident than accurate, and trackers too uncertain to report anything.

    metrics:  of metrics.json
    trackers: summaries by node, as from `tracker_innovations`; their confidence counts only where nothing could be
              compared with the truth
    """
    summaries = [*_summaries(metrics.get("consistency"))]
    found = []
    for agent, estimate, quantity, summary in summaries:
        factor, nees = summary.get("factor"), summary.get("nees")
        if summary.get("verdict") == OVERCONFIDENT and isinstance(factor, float) and isinstance(nees, float):
            of = subject_of(agent, estimate, "pictures" in metrics)
            found.append(Finding("confidence", (agent,), quantity, factor, nees, "times", of))
    if not any(summary.get("pairs") for *_, summary in summaries):
        for name, each in trackers.items():
            if each["verdict"] == OVERCONFIDENT:
                expected = (str(each["expected"]),)
                found.append(Finding("confidence", (name,), "tracker", each["factor"], each["nis"], cause=expected))
    if len(found) > _MOST_ESTIMATES:
        found = [*found[:_MOST_ESTIMATES], Finding("confidence", what="more", value=len(found) - _MOST_ESTIMATES)]
    yield from found
    for name, each in trackers.items():
        if each["silent"] >= _SILENT:
            yield Finding("confidence", (name,), "silent", each["silent"], unit="steps")


def _summaries(consistency: object) -> Iterator[tuple[str, str, str, Mapping[str, Any]]]:
    """Agent, estimate, quantity and summary; a user's evaluator may return anything."""
    for agent, by_estimate in _items(consistency):
        for estimate, by_quantity in _items(by_estimate):
            known = dict(_items(by_quantity))
            for quantity in ("position", "velocity"):
                if isinstance(known.get(quantity), Mapping):
                    yield agent, estimate, quantity, known[quantity]


def _items(value: object) -> list[tuple[str, Any]]:
    items = value.items() if isinstance(value, Mapping) else ()
    return [(name, item) for name, item in items if isinstance(name, str) and name.isprintable()]
