"""Checks that track messages delivered in time are in the collation."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

from mast_zenoh.checks.base import Check
from mast_zenoh.checks.evidence import Evidence, Sent
from mast_zenoh.gather import MAX_TRACK_VALUE

NAME = "collation"
_SHOWN = 5
#: Largest value that the broker surely accepts: it sees tracks in the world frame, these are in the agent's own.
_SURELY_ACCEPTED = MAX_TRACK_VALUE / 10
#: In real time, messages that may reach the broker before it knows of their agent.
_FIRST_MESSAGES = 5
_BATCH = ("collated", "")  # the broker's output
#: Roles of interposers whose forwarding times are known.
_KNOWN_ROLES = ("adversary", "link")


def check_collation(evidence: Evidence) -> Check:
    """Check that each message that arrived in time is in the batch, with all its rows.

    Exempt are messages whose time was changed, several messages of one frame, late ones (in real time: as many as the
    broker itself counts), and those sent while the agent or the broker was down.
    """
    brokers = evidence.role("broker")
    if len(brokers) != 1:
        return Check.skipped(NAME, f"{len(brokers)} brokers")
    (broker,) = brokers
    ports = evidence.wiring.ports(broker)
    batches = {message.frame: message.content for message in evidence.sent.get(ports.outputs.get(_BATCH, ""), ())}
    if not batches:
        return Check.skipped(NAME, "no collation was recorded")
    excepted: Counter[str] = Counter()
    missing: list[str] = []
    missing_of: Counter[str] = Counter()
    n_checked = 0
    for key, input_ in ports.inputs.items():
        if input_.message != "tracks":
            continue
        chain = _chain(evidence, key)
        if any(evidence.resolved.nodes[name].role not in _KNOWN_ROLES for name in chain):
            excepted["after a user-defined node"] += len(evidence.sent.get(key, ()))
            continue
        n_in_frame = Counter(
            frame for frame, _ in {(message.frame, message.seq) for message in evidence.sent.get(key, ())}
        )
        for message in evidence.sent.get(key, ()):
            reason = _exemption(message, input_.subject, broker, bool(chain), batches, evidence)
            if n_in_frame[message.frame] > 1:
                reason = "in addition to another message of its frame"
            if reason:
                excepted[reason] += 1
                continue
            n_checked += 1
            n_found, n_sent = batches.get(message.frame, {}).get(input_.subject), message.content.rows
            if n_found != n_sent:
                problem = (
                    "no batch"
                    if message.frame not in batches
                    else "not in it"
                    if n_found is None
                    else f"{n_found} rows"
                )
                missing.append(f"frame {message.frame}: {input_.subject} delivered {n_sent} rows, {problem}")
                missing_of[input_.subject] += 1
    late = _late(evidence, broker)
    values = {
        "checked": True,
        "messages": n_checked,
        "missing": dict(sorted(missing_of.items())),
        "late": late,
        "excepted": dict(sorted(excepted.items())),
    }
    if not evidence.lockstep and missing:
        if late is None:
            return Check.skipped(NAME, "the broker, which counts late messages in real time, returned no count")
        if all(count <= late.get(agent, 0) for agent, count in missing_of.items()):
            return Check(
                NAME, True, f"{n_checked} messages delivered; late, by the broker's count: {len(missing)}", values
            )
    if missing:
        more = f" and {len(missing) - _SHOWN} more" if len(missing) > _SHOWN else ""
        return Check(NAME, False, "; ".join(missing[:_SHOWN]) + more, values)
    return Check(NAME, True, f"all {n_checked} messages that were delivered in time are in the collation", values)


def _chain(evidence: Evidence, key: str) -> list[str]:
    """The interposers that a message passes before a key, in order."""
    for wire in evidence.wiring.wires:
        trunk = [leg.publisher.node for leg in wire.legs[1:]]
        if key == wire.key:
            return trunk
        for branch in wire.branches:
            keys = [leg.key for leg in branch.legs]
            if key in keys:
                return [*trunk, *(leg.publisher.node for leg in branch.legs[: keys.index(key) + 1])]
    return []


def _exemption(
    message: Sent,
    agent: str,
    broker: str,
    interposed: bool,
    batches: Mapping[int, Mapping[str, int]],
    evidence: Evidence,
) -> str | None:
    """Why a message may be missing from the collation; None: it must be there."""
    frame = message.frame
    if evidence.times_ns.get(frame) != message.time_ns:
        return "with a time that is not its frame's"
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
    if not evidence.lockstep and message.seq < _FIRST_MESSAGES:
        return "when the agent had just come"
    return "not physical" if message.content.magnitude > _SURELY_ACCEPTED else None


def _closed(frame: int, broker: str, evidence: Evidence) -> int | None:
    """The frame whose clock makes the broker emit a frame's batch; None: none did."""
    config = evidence.resolved.nodes[broker].config
    latency_ns, patience = round(float(config.get("latency_s", 0.0)) * 1e9), int(config.get("patience", 0))
    time_ns = evidence.times_ns[frame]
    for clock in range(frame + patience + 1, evidence.last + 1):
        if clock in evidence.times_ns and time_ns < evidence.times_ns[clock] - latency_ns:
            return clock
    return None


def _late(evidence: Evidence, broker: str) -> dict[str, int] | None:
    """Late messages of each agent, as counted by the broker; None if one is missing."""
    if any(step.node == broker for step in evidence.resolved.steps) or "late" not in evidence.metrics:
        return None
    return {str(agent): int(count) for agent, count in evidence.metrics["late"].items()}
