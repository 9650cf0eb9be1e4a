"""Every track message that the links delivered in time is in the collation, with all its rows."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

from mast_zenoh.checks.base import Check
from mast_zenoh.checks.evidence import Evidence, Said

NAME = "collation"
_SHOWN = 5
#: Beyond it the broker takes a track for none of this world; in the agent's own frame of reference, so with room.
_MOST = 1e7
#: In real time the broker may hear an agent before it hears of it; messages.
_JUST_COME = 5
_BATCH = ("collated", "")  # the broker's output
#: Roles of nodes on a wire of which it is known when they pass a message on.
_KNOWN = ("adversary", "link")


def check_collation(evidence: Evidence) -> Check:
    """What reached the broker before it closed a frame is in that frame's batch: the agent by name, all its rows.

    Left out are messages whose time was changed, those of a frame of which there are several, those that came late
    (in real time: as many as the broker itself counts), and those of the time at which the agent or the broker was
    down.
    """
    brokers = evidence.role("broker")
    if len(brokers) != 1:
        return Check.skipped(NAME, f"{len(brokers)} brokers")
    (broker,) = brokers
    ports = evidence.wiring.ports(broker)
    batches = {message.frame: message.content for message in evidence.said.get(ports.outputs.get(_BATCH, ""), ())}
    if not batches:
        return Check.skipped(NAME, "not one collation was recorded")
    excepted: Counter[str] = Counter()
    missing: list[str] = []
    missing_of: Counter[str] = Counter()
    judged = 0
    for key, heard in ports.inputs.items():
        if heard.message != "tracks":
            continue
        chain = _chain(evidence, key)
        if any(evidence.resolved.nodes[name].role not in _KNOWN for name in chain):
            excepted["behind a node of the user's"] += len(evidence.said.get(key, ()))
            continue
        ids = Counter(frame for frame, _ in {(message.frame, message.seq) for message in evidence.said.get(key, ())})
        for message in evidence.said.get(key, ()):
            reason = _excepted(message, heard.subject, broker, bool(chain), batches, evidence)
            if ids[message.frame] > 1:
                reason = "beside another one of its frame"
            if reason:
                excepted[reason] += 1
                continue
            judged += 1
            found, sent = batches.get(message.frame, {}).get(heard.subject), message.content.rows
            if found != sent:
                what = "no batch" if message.frame not in batches else "not in it" if found is None else f"{found} rows"
                missing.append(f"frame {message.frame}: {heard.subject} delivered {sent} rows, {what}")
                missing_of[heard.subject] += 1
    late = _late(evidence, broker)
    values = {
        "checked": True,
        "messages": judged,
        "missing": dict(sorted(missing_of.items())),
        "late": late,
        "excepted": dict(sorted(excepted.items())),
    }
    if not evidence.lockstep and missing:
        if late is None:
            return Check.skipped(NAME, "the broker, which counts what is late in real time, left no count")
        if all(count <= late.get(agent, 0) for agent, count in missing_of.items()):
            return Check(NAME, True, f"{judged} messages delivered; late, as the broker says: {len(missing)}", values)
    if missing:
        more = f" and {len(missing) - _SHOWN} more" if len(missing) > _SHOWN else ""
        return Check(NAME, False, "; ".join(missing[:_SHOWN]) + more, values)
    return Check(NAME, True, f"all {judged} messages that were delivered in time are in the collation", values)


def _chain(evidence: Evidence, key: str) -> list[str]:
    """The interposers through which a message comes to a key, from the first on."""
    for wire in evidence.wiring.wires:
        trunk = [leg.publisher.node for leg in wire.legs[1:]]
        if key == wire.key:
            return trunk
        for branch in wire.branches:
            keys = [leg.key for leg in branch.legs]
            if key in keys:
                return [*trunk, *(leg.publisher.node for leg in branch.legs[: keys.index(key) + 1])]
    return []


def _excepted(
    message: Said,
    agent: str,
    broker: str,
    interposed: bool,
    batches: Mapping[int, Mapping[str, int]],
    evidence: Evidence,
) -> str | None:
    """Why a message need not be in a collation; None: it must be."""
    frame = message.frame
    if evidence.times_ns.get(frame) != message.time_ns:
        return "of another time than its frame's"
    step = max(frame, message.step)
    closed = _closed(frame, broker, evidence)
    if closed is None:
        return "of a frame that was open at the end"
    if evidence.down(broker, frame, closed):
        return "while the broker was down"
    if evidence.lockstep and step >= closed:
        return "late"
    if not evidence.lockstep and (step > frame or frame not in batches):
        return "late" if step > frame else "of a frame without a batch"
    if evidence.down(agent, step, step):
        return "after the agent had gone"
    if interposed and frame >= evidence.last - evidence.slack:
        return "in the last frame"
    if not evidence.lockstep and message.seq < _JUST_COME:
        return "when the agent had just come"
    return "of no world" if message.content.most > _MOST else None


def _closed(frame: int, broker: str, evidence: Evidence) -> int | None:
    """The first frame whose clock makes the broker emit a frame's batch at the latest; None: there was none."""
    config = evidence.resolved.nodes[broker].config
    latency_ns, patience = round(float(config.get("latency_s", 0.0)) * 1e9), int(config.get("patience", 0))
    time_ns = evidence.times_ns[frame]
    for clock in range(frame + patience + 1, evidence.last + 1):
        if clock in evidence.times_ns and time_ns < evidence.times_ns[clock] - latency_ns:
            return clock
    return None


def _late(evidence: Evidence, broker: str) -> dict[str, int] | None:
    """How many messages of each agent came too late, as the broker itself says; None: not all of its lives say so."""
    if any(step.node == broker for step in evidence.resolved.steps) or "late" not in evidence.metrics:
        return None
    return {str(agent): int(count) for agent, count in evidence.metrics["late"].items()}
