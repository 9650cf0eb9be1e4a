"""Notices at the end of a run: uncounted messages, overconfident estimates, and parts that took part in nothing.

Idle parts are measured: from the wiring, the effects on the wires, the scene and the recorded scores. What a node
counts itself is given as a reason only, as its own words.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from mast_zenoh.config import registry
from mast_zenoh.config.resolved import NodeSpec, Resolved
from mast_zenoh.control.results import EVALUATOR, counts_of
from mast_zenoh.errors import nearest
from mast_zenoh.integrity import Integrity
from mast_zenoh.messagelog import churn
from mast_zenoh.metrics import Metric
from mast_zenoh.metrics.estimates import LOCAL, subject_of
from mast_zenoh.metrics.measures import label_of
from mast_zenoh.ros2.outside import MOST_PUBLISHERS
from mast_zenoh.scenario.driving import driver_of_car
from mast_zenoh.scenario.timeline import DIRECTED, attack_starts
from mast_zenoh.scenes.recording import SEEN_RETURNS, Recording
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


def of_run(
    resolved: Resolved,
    record: Mapping[str, Any],
    collations: Sequence[Mapping[str, Any]],
    measured: Mapping[str, Any],
    refused: Sequence[str],
    left_out: Mapping[str, int],
) -> list[dict[str, Any]]:
    """The notices of a run, each as {"kind", "count", "text"}.

    record:     run.json, with its nodes and timings
    collations: the brokers' counters
    measured:   late messages by agent, and in real time the latencies
    refused:    a sentence for each result that was refused
    left_out:   number of tracks by agent that input limits left out
    """
    nodes = record["nodes"]
    parts: list[tuple[str, int, str]] = [
        *(("replay", 1, text) for text in record.get("replay", {}).get("notices", ())),
        ("late", *_late(measured["late"])),
        *((name, *_dropped(name, collations)) for name in _DROPPED),
        ("left_out", *_left_out(left_out)),
        ("rejected", *_rejected(nodes)),
        ("foreign", *_foreign(list(nodes.values()))),
        ("control", *_control(record)),
        ("behind", *_behind(resolved, record, measured)),
        ("churn", *_churned(record)),
        ("recording", *_first(of_recording(record))),
        ("disconnected", *_first(record.get("disconnected", ()))),
        *(("outside", *_outside(name, counts)) for name, counts in record.get("outside", {}).items()),
        ("results", len(refused), f"{len(refused)} refused: {'; '.join(refused)}"),
    ]
    return [{"kind": kind, "count": count, "text": text} for kind, count, text in parts if count]


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


def _outside(name: str, counts: Mapping[str, Any]) -> tuple[int, str]:
    """(count, text) of what a node received from outside the run, by its own count."""
    text = f"{name} uses a program outside the run, on which the results depend: "
    if not counts:
        return 1, f"{text}it was lost, and nobody counted its answers"
    asked, unanswered, late = counts["asked"], counts["unanswered"], counts["late"]
    if not asked and counts["interrupted"]:
        text += f"{number(counts['interrupted'], 'message')} had no answer yet when the run was stopped"
    elif not asked:
        text += "it was sent no message"
    elif not (unanswered or late):
        text += f"it answered each of {number(asked, 'message')}"
    else:
        text += f"{unanswered + late} of {number(asked, 'message')} had no answer in time"
        text += f", {late} had one later" if late else ""
    for topic, absence in counts["absent"].items():
        text += f"; nothing came on {topic} {absence}"
    for word, what in (("refused", "received message"), ("left_out", "object")):
        reasons = Counter(counts[word])
        if reasons:
            reason, most = min(reasons.items(), key=lambda item: (-item[1], item[0]))
            text += f"; it {word.replace('_', ' ')} {number(reasons.total(), what)} (most: {most}, {reason})"
    for topic, publishers in counts["publishers"].items():
        if publishers > 1:
            many = f"{publishers} or more" if publishers >= MOST_PUBLISHERS else str(publishers)
            text += f"; {many} publishers sent on {topic}, expected one: any of them may have answered"
    return max(1, unanswered + late), text


def of_commands(cars: object, wiring: Wiring, rejected: Mapping[str, int]) -> list[dict[str, Any]]:
    """Notices of cars that had no new command in some frames.

    cars: what the simulator counted, by car; rejected: messages that it rejected, by key and reason. Among these are
    commands that cannot be read, which never reach a car.
    """
    notices = []
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
        text = f"the car of {car} had no new command in {number(held + braked, 'frame')}"
        text += f": it went on in {held} and braked in {braked}; {number(by_car[car], 'command')} refused"
        notices.append({"kind": "commands", "count": held + braked, "text": text})
    return notices


def of_estimates(driven: object, frames: object) -> list[dict[str, Any]]:
    """Notices of drivers that had no estimate in some frames.

    driven: of metrics.json, by car; frames: number of frames that were measured
    """
    notices = []
    for car, happened in driven.items() if isinstance(driven, Mapping) else ():
        if blind := counts_of(happened).get("blind_frames", 0):
            text = f"{driver_of_car(str(car))} drove {blind} of {frames} frames without an estimate that is new enough "
            notices.append({"kind": "estimates", "count": blind, "text": f"{text}(estimate_age_s): it only braked"})
    return notices


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


def _left_out(left_out: Mapping[str, int]) -> tuple[int, str]:
    """(count, text) of the tracks that input limits left out."""
    agents = [f"{agent}: {count}" for agent, count in left_out.items() if count]
    more = f" and {len(agents) - _MAX_KEYS} more" if len(agents) > _MAX_KEYS else ""
    text = f"tracks not fused, as their agents sent too many ({', '.join(agents[:_MAX_KEYS])}{more}): see input_limit"
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


def of_confidence(metrics: Mapping[str, Any], trackers: Mapping[str, Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Notices of estimates that are more confident than accurate, and of trackers too uncertain to report anything.

    Each is {"kind", "count", "text"}.

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
    return [{"kind": "confidence", "count": 1, "text": text} for text in texts]


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


#: An attack that changes nothing on purpose.
_INERT_ATTACK = "PassThrough"
#: What adversaries publish besides the messages that they forward.
_OWN_MESSAGES = ("attack_report", "observation")
#: s before a fault; messages of that time may still be on their way when it begins.
_UNDER_WAY_S = 1.0


def idle_parts(resolved: Resolved, frames: int, handed_in: Mapping[str, Mapping[str, Any]]) -> list[dict[str, Any]]:
    """A notice {"kind": "idle", "count": 1, "text"} for each part of a run that took part in nothing.

    frames: number of frames played;  handed_in: what each node returned from `finish`
    """
    if not frames:
        return []
    run = _Played(resolved, frames, handed_in)
    sentences = [*resolved.idle, *_adversaries(run), *_coordinators(run), *_defences(run)]
    sentences += [*_vetoes(run), *_links(run), *_faults(run), *_sensors(run), *_agents(run), *_metrics(run)]
    return [{"kind": "idle", "count": 1, "text": text} for text in dict.fromkeys(sentences)]


def idle_metrics(resolved: Resolved, frames: int, handed_in: Mapping[str, Mapping[str, Any]]) -> list[dict[str, Any]]:
    """The notices of a replay: of its metrics alone, as all else was played."""
    return [{"kind": "idle", "count": 1, "text": text} for text in _metrics(_Played(resolved, frames, handed_in))]


@dataclass(frozen=True)
class _Played:
    """A run that is over."""

    resolved: Resolved
    frames: int
    handed_in: Mapping[str, Mapping[str, Any]]

    @cached_property
    def wiring(self) -> Wiring:
        return Wiring.from_json(self.resolved.wiring)

    @cached_property
    def metrics(self) -> Mapping[str, Any]:
        """Of metrics.json; {} with a user's evaluator that returns something else."""
        metrics = self.handed_in.get(EVALUATOR, {}).get("metrics")
        return metrics if isinstance(metrics, Mapping) and isinstance(metrics.get("interposers"), Mapping) else {}

    @property
    def duration_s(self) -> float:
        """s of scene time from the first frame to the last."""
        return (self.frames - 1) * self.resolved.period_ns * 1e-9

    def of_role(self, role: str) -> dict[str, NodeSpec]:
        """The nodes of a role, by name."""
        return {name: spec for name, spec in self.resolved.nodes.items() if spec.role == role}

    def leads(self, sources: Collection[str], ends: Collection[str], message: str = "") -> bool:
        """Whether a wire leads from one of some nodes to one of others. message: its type; empty: any"""
        return any(
            wire.legs[0].publisher.node in sources and any(end.node in ends for end in wire.subscribers)
            for wire in self.wiring.wires
            if message in ("", wire.message)
        )

    def table(self, name: str) -> Mapping[str, np.ndarray]:
        """A table of the evaluator, by column; {} without it."""
        tables = self.handed_in.get(EVALUATOR, {}).get("tables")
        table = tables.get(name) if isinstance(tables, Mapping) else None
        return {key: np.asarray(column) for key, column in table.items()} if isinstance(table, Mapping) else {}


def _adversaries(run: _Played) -> Iterator[str]:
    """Adversaries on no wire, and those that changed no message."""
    starts = {name: start for (_, start), names in attack_starts(run.resolved.nodes).items() for name in names}
    for name, spec in run.of_role("adversary").items():
        wires = [wire.key for wire in run.wiring.wires if name in wire.interposers]
        attack = spec.config.get("attack")
        kind = attack.get("type") if isinstance(attack, Mapping) else None
        if not wires:
            published = [wire for wire in run.wiring.wires if wire.legs[0].publisher.node == name]
            if all(wire.message in _OWN_MESSAGES for wire in published):
                yield f"{name} is on no wire: keyexpr.rewrites names no wire of its agent, as on_tracks.toml does"
            continue
        measured = run.metrics.get("interposers", {}).get(name)
        if kind == _INERT_ATTACK or not isinstance(measured, Mapping):
            continue
        where = f"{name} on {', '.join(wires)}"
        if not measured.get("messages"):
            yield f"{where} received no message"
        elif not set(measured.get("effects", ())) - {"unsettled"}:
            reason = _why_unchanged(run, name, str(kind), starts.get(name))
            yield f"{where} changed no message{f': {reason}' if reason else ''}"


def _why_unchanged(run: _Played, name: str, kind: str, start_s: float | None) -> str:
    """Why an adversary changed nothing, as far as that is known."""
    begins = [] if start_s is None else [start_s]
    if kind == DIRECTED:
        directing = [other for other in run.of_role("coordinator") if run.leads([other], [name], "directive")]
        if not directing:
            return "no coordinator directs it"
        plan = run.resolved.nodes[directing[0]].config.get("coordination")
        if isinstance(plan, Mapping) and isinstance(plan.get("start_s"), (int, float)):
            begins.append(float(plan["start_s"]))
    if begins and max(begins) > run.duration_s:
        return f"its attack begins at {max(begins):g} s, after the last frame ({run.duration_s:.1f} s)"
    counts = run.handed_in.get(name, {})
    chosen = [count for count in counts.values() if type(count) is int]
    return "by its own count it found no target" if chosen and not any(chosen) else ""


def _coordinators(run: _Played) -> Iterator[str]:
    """Coordinators to which no adversary reports, or that direct none."""
    adversaries = run.of_role("adversary")
    for name in run.of_role("coordinator"):
        if not adversaries:
            yield f"{name} directs no adversary: the scenario has no adversaries"
        elif not run.leads(adversaries, [name]) or not run.leads([name], adversaries):
            yield f"{name} directs no adversary: no wire joins it to an adversary, as coordination.toml does"


def _defences(run: _Played) -> Iterator[str]:
    """Integrity stages that no view reaches, or that never had two agents to compare."""
    for name, spec in run.of_role("command_center").items():
        pipeline = spec.config.get("pipeline")
        stage = pipeline.get("integrity") if isinstance(pipeline, Mapping) else None
        kind = stage.get("type") if isinstance(stage, Mapping) else None
        cls = registry.known_types(Integrity).get(str(kind))
        yield from _trusted_strangers(run, stage)
        if cls is None or not getattr(cls, "needs_views", True):
            continue
        if not any(
            wire.message == "views" and any(end.node == name for end in wire.subscribers) for wire in run.wiring.wires
        ):
            yield (
                f"the defence {kind} judges without views, and its trust is not measured: no wire leads views to "
                f"{name}, as views.toml does in keyexpr.rewrites"
            )
        elif run.resolved.recording is not None and not _seen_by_two(run.resolved.recording, run.frames):
            yield f"the defence {kind} had nothing to compare: no two agents saw the same object"


def _trusted_strangers(run: _Played, stage: Any) -> Iterator[str]:
    """Agents that an integrity stage, or the one in it, compares all others with, and that do not exist."""
    if not isinstance(stage, Mapping):
        return
    kind, agents = str(stage.get("type")), run.of_role("agent")
    ego = stage.get("ego", getattr(registry.known_types(Integrity).get(kind), "ego", None))
    if isinstance(ego, str) and ego not in agents:
        yield f"the defence {kind} checked nothing: it trusts {ego!r}, which is no agent{nearest(ego, agents)}"
    yield from _trusted_strangers(run, stage.get("stage"))


def _vetoes(run: _Played) -> Iterator[str]:
    """Drivers whose own sensors can refute nothing."""
    recording = run.resolved.recording
    if recording is not None and not len(recording.buildings):
        for name, spec in run.of_role("driver").items():
            if spec.config.get("veto"):
                yield f"the veto of {name} refuted nothing: in a scene without buildings nobody knows what is free"


def _seen_by_two(recording: Recording, frames: int) -> bool:
    """Whether an object was seen by two agents in one of the first frames."""
    rows = recording.truth_start[min(frames, len(recording))]
    return bool(((recording.points[:rows] >= SEEN_RETURNS).sum(axis=1) >= 2).any())


def _links(run: _Played) -> Iterator[str]:
    """Links that received no message. One that changed none is a good link."""
    for name in run.of_role("link"):
        measured = run.metrics.get("interposers", {}).get(name)
        if isinstance(measured, Mapping) and not measured.get("messages"):
            yield f"{name} received no message"


def _faults(run: _Played) -> Iterator[str]:
    """Faults on links that changed no message in their time.

    In lock-step alone: in real time, delays of less than a frame are not measured as effects.
    """
    effects = run.table("attacks")
    if run.resolved.mode != "lockstep" or not run.metrics or not {"interposer", "frame", "effect"} <= effects.keys():
        return
    settled = effects["effect"] != "unsettled"
    time_s = effects["frame"] * run.resolved.period_ns * 1e-9
    for band in run.resolved.timeline:
        if (band["kind"], band["backend"]) != ("fault", "links") or band["at_s"] > run.duration_s:
            continue
        until_s = np.inf if band["until_s"] is None else band["until_s"]
        nodes = {name for name, spec in run.of_role("link").items() if spec.config.get("agent") in band["nodes"]}
        in_time = (time_s >= band["at_s"] - _UNDER_WAY_S) & (time_s <= until_s)
        if nodes and not (settled & in_time & np.isin(effects["interposer"].astype(str), sorted(nodes))).any():
            end = "" if band["until_s"] is None else f" to {band['until_s']:g}"
            yield f"fault {band['label']} changed no message from {band['at_s']:g}{end} s"


def _sensors(run: _Played) -> Iterator[str]:
    """Sensors whose detections are empty in all frames."""
    recording = run.resolved.recording
    if recording is None:
        return
    names = recording.sensor_names
    end = min(run.frames, len(recording)) * len(names)
    counts = np.diff(recording.detection_start[: end + 1]).reshape(-1, len(names)).sum(axis=0)
    lone = {agent.name for agent in recording.agents if len(agent.sensors) == 1}
    for name, count in zip(names, counts, strict=True):
        agent = name.partition("/")[0]
        if not count and agent in run.resolved.nodes:
            yield f"the sensor {agent if agent in lone else name} detected nothing"


def _agents(run: _Played) -> Iterator[str]:
    """Agents without a track of their own, in runs that last long enough for tracks to begin."""
    table = run.table("metrics")
    if run.metrics.get("settled") is not True or not {"agent", "estimator", "tp", "fp"} <= table.keys():
        return
    own = table["estimator"].astype(str) == LOCAL
    for agent in dict.fromkeys(table["agent"][own].tolist()):
        rows = own & (table["agent"].astype(str) == agent)
        if not (table["tp"][rows] + table["fp"][rows]).any():
            yield f"{agent} had no track within the range of the metrics"


def _metrics(run: _Played) -> Iterator[str]:
    """The user's metrics that have no value."""
    config = run.resolved.nodes[EVALUATOR].config.get("metrics", ()) if EVALUATOR in run.resolved.nodes else ()
    types = registry.known_types(Metric)
    summaries = run.metrics.get("agents", {})
    for spec in config if isinstance(config, (list, tuple)) else ():
        cls = types.get(str(spec.get("type"))) if isinstance(spec, Mapping) else None
        label = None if cls is None else label_of(cls)
        values = [each[label] for agent in summaries.values() for each in agent.values() if label in each]
        if values and all((value.get("mean") if isinstance(value, Mapping) else value) is None for value in values):
            yield f"the metric {label} has no value for any estimate"
