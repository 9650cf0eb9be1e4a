"""Sequence numbers on every leg: no hole that no rule and no process step explains, and none twice without a reason."""

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
_COPIES = 10  # of one corrupted message, each of which may be taken for another one


@dataclass
class _Account:
    """What was found on all legs."""

    messages: int = 0
    explained: Counter[str] = field(default_factory=Counter)
    problems: list[str] = field(default_factory=list)


def check_sequences(evidence: Evidence) -> Check:
    """On every leg: what its publisher numbered is all there; behind an interposer, all that went in.

    A message is missing with reason where a link reports that it dropped it, corrupted it, or held it until after the
    end; where its interposer was down; where its publisher was unplugged; and where the hosts' network was cut. What
    was done in the last frame no link reports any more: there nothing is asked.
    """
    account = _Account()
    for wire in evidence.wiring.wires:
        _published(wire, evidence, account)
        for before, leg in _hops(wire):
            _passed_on(wire, before, leg, evidence, account)
    values = {
        "checked": True,
        "messages": account.messages,
        "explained": dict(sorted(account.explained.items())),
        "problems": len(account.problems),
    }
    if account.problems:
        more = f" and {len(account.problems) - _SHOWN} more" if len(account.problems) > _SHOWN else ""
        return Check(NAME, False, "; ".join(account.problems[:_SHOWN]) + more, values)
    told = ", ".join(f"{n} {reason}" for reason, n in sorted(account.explained.items()))
    return Check(
        NAME, True, f"{account.messages} messages on all legs; explained: {told or 'nothing to explain'}", values
    )


def _hops(wire: Wire) -> Iterator[tuple[Leg, Leg]]:
    """(the leg before an interposer, the one behind it) of every interposer of a wire."""
    yield from pairwise(wire.legs)
    for branch in wire.branches:
        yield from pairwise((wire.legs[-1], *branch.legs))


def _published(wire: Wire, evidence: Evidence, account: _Account) -> None:
    """The first leg: every life of the publisher counts from 0."""
    leg = wire.legs[0]
    publisher = leg.publisher.node
    said = sorted(evidence.said.get(leg.key, ()), key=lambda message: (message.frame, message.seq))
    account.messages += len(said)
    early = evidence.slack + evidence.broker_lag + 1  # what a new life says may be about frames before it
    starts = [frame - early for frame in evidence.restarts(publisher)]
    unplanned = int(evidence.run.get("nodes", {}).get(publisher, {}).get("restarts") or 0) - len(starts)
    starts += [0] * unplanned  # it died by itself, and came again by its policy
    expected = [0]  # the next number of every life, the newest last
    for message in said:
        life = next((i for i in reversed(range(len(expected))) if expected[i] == message.seq), None)
        again = life is None and message.seq == 0 and len(expected) <= len(starts)
        if again and message.frame >= starts[len(expected) - 1]:
            expected.append(0)
            life = len(expected) - 1
        if life is None:
            life = len(expected) - 1
            if message.seq < expected[life]:
                account.problems.append(f"{leg.key}: sequence {message.seq} of frame {message.frame} comes again")
                continue
            missing = message.seq - expected[life]
            if evidence.by_network(message.frame):
                account.explained["cut off by the hosts' network"] += missing
            elif evidence.unplugged(publisher, message.frame):
                account.explained[f"{publisher} was unplugged"] += missing
            else:
                before = f"before sequence {message.seq} of frame {message.frame}"
                account.problems.append(f"{leg.key}: {missing} missing {before}")
        expected[life] = message.seq + 1


def _passed_on(wire: Wire, before: Leg, leg: Leg, evidence: Evidence, account: _Account) -> None:
    """A leg behind an interposer, compared with what went into it."""
    went_in = Counter((message.frame, message.seq) for message in evidence.said.get(before.key, ()))
    came_out = Counter((message.frame, message.seq) for message in evidence.said.get(leg.key, ()))
    account.messages += came_out.total()
    node = leg.publisher.node
    fates = evidence.fates.get((node, wire.message), {})
    unreported = evidence.last - evidence.slack
    if wire.message in ("collated", "picture"):
        unreported -= evidence.broker_lag + 1  # what is about a frame may be said some frames later
    for id_ in sorted(went_in.keys() - came_out.keys()):
        reason = _why_missing(id_, node, fates.get(id_, ()), unreported, evidence)
        if reason is None:
            frame, seq = id_
            account.problems.append(
                f"{leg.key}: {node} has not passed on sequence {seq} of frame {frame}, and says no why"
            )
        else:
            account.explained[reason] += went_in[id_]
    # A corrupted message that neither came out as itself nor as malformed is taken for another one; so may copies be.
    corrupted = {id_ for id_, told in fates.items() if any(fate.name == "corrupted" for fate in told)}
    astray = len(corrupted - came_out.keys()) - evidence.malformed.get(leg.key, 0)
    astray += sum(_COPIES for id_ in corrupted if any(fate.name == "duplicated" for fate in fates[id_]))
    mistaken = 0
    for id_ in sorted(came_out):
        surplus = came_out[id_] - went_in[id_]
        if surplus <= 0:
            continue
        if any(fate.name == "duplicated" for fate in fates.get(id_, ())):
            account.explained["duplicated by a link"] += surplus
        elif id_[0] >= unreported and went_in[id_]:
            account.explained["in the last frame"] += surplus
        elif mistaken + surplus <= astray:
            mistaken += surplus
            account.explained["corrupted by a link"] += surplus
        else:
            account.problems.append(f"{leg.key}: sequence {id_[1]} of frame {id_[0]} came {surplus} times too often")


def _why_missing(id_: Id, node: str, told: Iterable[Fate], unreported: int, evidence: Evidence) -> str | None:
    """Why a message did not come out of an interposer; None: nobody knows."""
    frame = id_[0]
    for fate in told:
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
    return "cut off by the hosts' network" if evidence.by_network(frame) else None
