"""Checks that every gap and duplicate in sequence numbers is explained."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from itertools import pairwise

from mast_zenoh.checks.base import Check
from mast_zenoh.checks.evidence import Evidence, Fate, Id
from mast_zenoh.wiring.model import Leg, Wire

NAME = "sequences"
_SHOWN = 5
_COPIES = 10  # of one corrupted message; each may look like another message


@dataclass
class _Account:
    """The findings on all legs."""

    messages: int = 0
    explained: Counter[str] = field(default_factory=Counter)
    problems: list[str] = field(default_factory=list)


def check_sequences(evidence: Evidence) -> Check:
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
        more = f" and {len(account.problems) - _SHOWN} more" if len(account.problems) > _SHOWN else ""
        return Check(NAME, False, "; ".join(account.problems[:_SHOWN]) + more, values)
    explanations = ", ".join(f"{n} {reason}" for reason, n in sorted(account.explained.items()))
    return Check(
        NAME,
        True,
        f"{account.messages} messages on all legs; explained: {explanations or 'nothing to explain'}",
        values,
    )


def _hops(wire: Wire) -> Iterator[tuple[Leg, Leg]]:
    """(the leg before, the leg after) of every interposer of a wire."""
    yield from pairwise(wire.legs)
    for branch in wire.branches:
        yield from pairwise((wire.legs[-1], *branch.legs))


def _check_publisher(wire: Wire, evidence: Evidence, account: _Account) -> None:
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


def _check_interposer(wire: Wire, before: Leg, leg: Leg, evidence: Evidence, account: _Account) -> None:
    """Compare the leg after an interposer with the leg before it."""
    received = Counter((message.frame, message.seq) for message in evidence.sent.get(before.key, ()))
    sent = Counter((message.frame, message.seq) for message in evidence.sent.get(leg.key, ()))
    account.messages += sent.total()
    node = leg.publisher.node
    fates = evidence.fates.get((node, wire.message), {})
    unreported = evidence.last - evidence.slack
    if wire.message in ("collated", "picture"):
        unreported -= evidence.broker_lag + 1  # messages about a frame may be sent some frames later
    for id_ in sorted(received.keys() - sent.keys()):
        reason = _why_missing(id_, node, fates.get(id_, ()), unreported, evidence)
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


def _why_missing(id_: Id, node: str, fates: Iterable[Fate], unreported: int, evidence: Evidence) -> str | None:
    """Why an interposer did not forward a message; None if unknown."""
    frame = id_[0]
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
