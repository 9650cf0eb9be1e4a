"""Checks of messages: those delivered in time are in the collation, and every gap and duplicate is explained."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import pairwise

from mast_zenoh.gather import MAX_TRACK_VALUE
from mast_zenoh.launch.checks.evidence import Check, Fate, RunEvidence, SentMessage
from mast_zenoh.links import type_number
from mast_zenoh.wiring.model import Leg, Wire

_SHOWN = 5
#: Largest value that the broker surely accepts: it sees tracks in the world frame, these are in the agent's own.
_SURELY_ACCEPTED = MAX_TRACK_VALUE / 10
#: In real time, messages that may reach the broker before it knows of their agent.
_FIRST_MESSAGES = 5
_COPIES = 10  # of one corrupted message; each may look like another message
_BATCH = ("collated", "")  # the broker's output
#: Roles of interposers whose forwarding times are known.
_KNOWN_ROLES = ("adversary", "link")


def check_collation(evidence: RunEvidence) -> Check:
    """Check that each message that arrived in time is in the batch, with all its rows.

    Exempt are messages whose time was changed, several messages of one frame, late ones (in real time: as many as the
    broker itself counts), and those sent while the agent or the broker was down.
    """
    brokers = evidence.role("broker")
    if len(brokers) != 1:
        return Check.skipped("collation", f"{len(brokers)} brokers")
    (broker,) = brokers
    ports = evidence.wiring.ports(broker)
    batches = {message.frame: message.content for message in evidence.sent.get(ports.outputs.get(_BATCH, ""), ())}
    if not batches:
        return Check.skipped("collation", "no collation was recorded")
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
        sent = evidence.sent.get(key, ())
        n_in_frame = Counter(frame for frame, _ in {(message.frame, message.seq) for message in sent})
        for message in sent:
            reason = _exemption(message, input_.subject, broker, bool(chain), batches, evidence)
            if n_in_frame[message.frame] > 1:
                reason = "in addition to another message of its frame"
            if reason:
                excepted[reason] += 1
                continue
            n_checked += 1
            n_found, n_sent = batches.get(message.frame, {}).get(input_.subject), message.content.rows
            if n_found != n_sent:
                problem = "not in it" if n_found is None else f"{n_found} rows"
                problem = problem if message.frame in batches else "no batch"
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
    if not missing:
        detail = f"all {n_checked} messages that were delivered in time are in the collation"
    elif evidence.lockstep:
        return Check("collation", False, _first(missing), values)
    elif late is None:
        return Check.skipped("collation", "the broker, which counts late messages in real time, returned no count")
    elif any(count > late.get(agent, 0) for agent, count in missing_of.items()):
        return Check("collation", False, _first(missing), values)
    else:
        detail = f"{n_checked} messages delivered; late, by the broker's count: {len(missing)}"
    return Check("collation", True, detail, values)


def _chain(evidence: RunEvidence, key: str) -> list[str]:
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
    message: SentMessage,
    agent: str,
    broker: str,
    interposed: bool,
    batches: Mapping[int, Mapping[str, int]],
    evidence: RunEvidence,
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


def _closed(frame: int, broker: str, evidence: RunEvidence) -> int | None:
    """The frame whose clock makes the broker emit a frame's batch; None: none did."""
    config = evidence.resolved.nodes[broker].config
    latency_ns, patience = round(float(config.get("latency_s", 0.0)) * 1e9), int(config.get("patience", 0))
    time_ns = evidence.times_ns[frame]
    for clock in range(frame + patience + 1, evidence.last + 1):
        if clock in evidence.times_ns and time_ns < evidence.times_ns[clock] - latency_ns:
            return clock
    return None


def _late(evidence: RunEvidence, broker: str) -> dict[str, int] | None:
    """Late messages of each agent, as counted by the broker; None if one is missing."""
    if any(step.node == broker for step in evidence.resolved.steps) or "late" not in evidence.metrics:
        return None
    return {str(agent): int(count) for agent, count in evidence.metrics["late"].items()}


@dataclass
class _Account:
    """The findings on all legs."""

    messages: int = 0
    explained: Counter[str] = field(default_factory=Counter)
    problems: list[str] = field(default_factory=list)


def check_sequences(evidence: RunEvidence) -> Check:
    """Check that every leg has all messages of its publisher or interposer's input.

    A missing message is explained if a link reports that it dropped, corrupted or delayed it beyond the end, if its
    interposer was down, if its publisher was disconnected, or if the hosts' network was cut. Links do not report on
    the last frame, so it is not checked.
    """
    account = _Account()
    for wire in evidence.wiring.wires:
        _check_publisher(wire, evidence, account)
        for before, leg in _hops(wire):
            _check_interposer(wire, before, leg, evidence, account)
    values = {
        "checked": True,
        "messages": account.messages,
        "explained": dict(sorted(account.explained.items())),
        "problems": len(account.problems),
    }
    if account.problems:
        return Check("sequences", False, _first(account.problems), values)
    explanations = ", ".join(f"{n} {reason}" for reason, n in sorted(account.explained.items()))
    return Check(
        "sequences",
        True,
        f"{account.messages} messages on all legs; explained: {explanations or 'nothing to explain'}",
        values,
    )


def _hops(wire: Wire) -> Iterator[tuple[Leg, Leg]]:
    """(the leg before, the leg after) of every interposer of a wire."""
    yield from pairwise(wire.legs)
    for branch in wire.branches:
        yield from pairwise((wire.legs[-1], *branch.legs))


def _check_publisher(wire: Wire, evidence: RunEvidence, account: _Account) -> None:
    """Check the first leg, where every process of the publisher counts from 0."""
    leg = wire.legs[0]
    publisher = leg.publisher.node
    messages = sorted(evidence.sent.get(leg.key, ()), key=lambda message: (message.frame, message.seq))
    account.messages += len(messages)
    margin = evidence.slack + evidence.broker_lag + 1  # messages of a new process may be about earlier frames
    starts = [frame - margin for frame in evidence.restarts(publisher)]
    unplanned = int(evidence.run.get("nodes", {}).get(publisher, {}).get("restarts") or 0) - len(starts)
    starts += [0] * unplanned  # restarts after crashes
    expected = [0]  # the next number of every process, the newest last
    for message in messages:
        process = next((i for i in reversed(range(len(expected))) if expected[i] == message.seq), None)
        restarted = process is None and message.seq == 0 and len(expected) <= len(starts)
        if restarted and message.frame >= starts[len(expected) - 1]:
            expected.append(0)
            process = len(expected) - 1
        if process is None:
            process = len(expected) - 1
            if message.seq < expected[process]:
                account.problems.append(f"{leg.key}: sequence {message.seq} of frame {message.frame} is repeated")
                continue
            missing = message.seq - expected[process]
            if evidence.near_network_fault(message.frame):
                account.explained["cut off by the hosts' network"] += missing
            elif evidence.unplugged(publisher, message.frame):
                account.explained[f"{publisher} was unplugged"] += missing
            else:
                place = f"before sequence {message.seq} of frame {message.frame}"
                account.problems.append(f"{leg.key}: {missing} missing {place}")
        expected[process] = message.seq + 1


def _check_interposer(wire: Wire, before: Leg, leg: Leg, evidence: RunEvidence, account: _Account) -> None:
    """Compare the leg after an interposer with the leg before it."""
    incoming = evidence.sent.get(before.key, ())
    received = Counter((message.frame, message.seq) for message in incoming)
    came = {(message.frame, message.seq): max(message.frame, message.step) for message in incoming}
    sent = Counter((message.frame, message.seq) for message in evidence.sent.get(leg.key, ()))
    account.messages += sent.total()
    node = leg.publisher.node
    fates = evidence.fates.get((node, type_number(wire.message)), {})
    unreported = evidence.last - evidence.slack
    if wire.message in ("collated", "picture"):
        unreported -= evidence.broker_lag + 1  # messages about a frame may be sent some frames later
    for id_ in sorted(received.keys() - sent.keys()):
        reason = _why_missing(came[id_], node, fates.get(id_, ()), unreported, evidence)
        if reason is None:
            frame, seq = id_
            account.problems.append(
                f"{leg.key}: {node} did not forward sequence {seq} of frame {frame}, without a reason"
            )
        else:
            account.explained[reason] += received[id_]
    # A corrupted message that came out neither unchanged nor as malformed looks like another one; so may its copies.
    corrupted = {id_ for id_, fates_ in fates.items() if any(fate.name == "corrupted" for fate in fates_)}
    n_disguised = len(corrupted - sent.keys()) - evidence.malformed.get(leg.key, 0)
    n_disguised += sum(_COPIES for id_ in corrupted if any(fate.name == "duplicated" for fate in fates[id_]))
    n_explained = 0
    for id_ in sorted(sent):
        surplus = sent[id_] - received[id_]
        if surplus <= 0:
            continue
        if any(fate.name == "duplicated" for fate in fates.get(id_, ())):
            account.explained["duplicated by a link"] += surplus
        elif id_[0] >= unreported and received[id_]:
            account.explained["in the last frame"] += surplus
        elif n_explained + surplus <= n_disguised:
            n_explained += surplus
            account.explained["corrupted by a link"] += surplus
        else:
            account.problems.append(f"{leg.key}: sequence {id_[1]} of frame {id_[0]} has {surplus} copies too many")


def _why_missing(frame: int, node: str, fates: Iterable[Fate], unreported: int, evidence: RunEvidence) -> str | None:
    """Why an interposer did not forward a message that reached it in a frame; None if unknown."""
    for fate in fates:
        if fate.name == "dropped":
            return "dropped by a link"
        if fate.name == "corrupted":
            return "corrupted by a link"
        if fate.name == "delayed" and evidence.times_ns.get(frame, 0) * 1e-9 + fate.delay_s > evidence.end_s - 1e-9:
            return "late beyond the end"
    if evidence.down(node, frame, frame):
        return f"{node} was down"
    if frame >= unreported:
        return "in the last frame"
    return "cut off by the hosts' network" if evidence.near_network_fault(frame) else None


def _first(problems: list[str]) -> str:
    """The first problems, and how many more there are."""
    more = f" and {len(problems) - _SHOWN} more" if len(problems) > _SHOWN else ""
    return "; ".join(problems[:_SHOWN]) + more
