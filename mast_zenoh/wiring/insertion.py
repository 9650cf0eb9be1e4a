"""Inserts nodes into a resolved wiring, or removes them, to rewire a running mesh.

Pure functions.

Inserting works as in a key-expression map: the publisher of the wire's key gets a tap key, to which only the new node
subscribes, and the new node publishes the wire's key. Subscribers keep theirs. The new node comes at the end of the
trunk: after all nodes on it, before the subscribers and their branches; or at the end of the branch of one subscriber.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace

from mast_zenoh.errors import WiringError, nearest
from mast_zenoh.wiring.model import TAP, Branch, Endpoint, Leg, Wire, Wiring

_NAME = re.compile(r"[A-Za-z0-9_.\-]+")


@dataclass(frozen=True, slots=True)
class InsertionPoint:
    """Where a node is inserted into a running mesh.

    wire:  key of the wire that it interposes;  input, output: its ports on that wire
    before: the only subscriber before which it comes, a node with a branch; "": all
    other_inputs:    its other inputs, port by key of the wire
    published_wires: wires that it publishes, each with one leg
    """

    wire: str
    input: str
    output: str
    other_inputs: Mapping[str, str] = field(default_factory=dict)
    published_wires: tuple[Wire, ...] = ()
    before: str = ""


def insert(wiring: Wiring, node: str, place: InsertionPoint) -> Wiring:
    """The wiring with `node` inserted into a wire.

    Raises WiringError for an unknown wire, a node that is on it already, a subscriber or a listener at the source that
    would need another key, a key that already has a publisher, and a name that cannot be part of a key.
    """
    if not _NAME.fullmatch(node):
        raise WiringError(f"node {node!r}: a node's name is one chunk of a key expression: letters, digits, _ . -")
    wires = {wire.key: wire for wire in wiring.wires}
    for key in (place.wire, *place.other_inputs):
        if key not in wires:
            raise WiringError(f"no wire {key!r}{nearest(key, wires)}")
    target = wires[place.wire]
    if node in parties(target):
        raise WiringError(f"{node} is already on the wire {target.key!r}: that would be a loop")
    ends = Endpoint(node, place.input), Endpoint(node, place.output)
    if place.before:
        branch = _branch_of(target, place.before)
        taps = f"{target.key}/{TAP}/{place.before}"
        longer = replace(branch, legs=extended(target, branch.legs, taps, *ends))
        branches = tuple(longer if known == branch else known for known in target.branches)
        wires[target.key] = replace(target, branches=branches)
    else:
        if len(target.legs) == 1:
            _check_source(target)
        wires[target.key] = replace(target, legs=extended(target, target.legs, f"{target.key}/{TAP}", *ends))
    for key, port in place.other_inputs.items():
        *before, last = wires[key].legs
        heard = replace(last, subscribers=(*last.subscribers, Endpoint(node, port)))
        wires[key] = replace(wires[key], legs=(*before, heard))
    for wire in place.published_wires:
        if wire.key in wires:
            raise WiringError(f"the key {wire.key!r} already has a publisher")
        wires[wire.key] = wire
    return replace(wiring, wires=tuple(wires.values()))


def remove(wiring: Wiring, node: str) -> Wiring:
    """The wiring without `node`.

    The publisher before the node then publishes on the key that the node used.

    Raises WiringError for a node on no wire, for the first one before a single subscriber, and if a listener at the
    source would need another key.
    """
    interposers_of = {wire.key: wire.interposers for wire in wiring.wires if wire.interposers}
    if not any(node in interposers for interposers in interposers_of.values()):
        known = {name for interposers in interposers_of.values() for name in interposers}
        raise WiringError(f"no node {node!r} is on a wire{nearest(node, known) if known else ''}")
    for wire in wiring.wires:
        if any(node == branch.legs[0].publisher.node for branch in wire.branches):
            raise WiringError(f"{node} begins the branch of one subscriber of {wire.key!r}: it cannot be released")
        if len(wire.legs) > 1 and wire.legs[1].publisher.node == node:
            _check_source(wire)
    return never_inserted(wiring, (node,))


def never_inserted(wiring: Wiring, nodes: Collection[str]) -> Wiring:
    """The wiring without some nodes: interposers, publishers or listeners."""
    return replace(
        wiring,
        wires=tuple(_without(wire, nodes) for wire in wiring.wires if wire.legs[0].publisher.node not in nodes),
        overhearers=tuple(end for end in wiring.overhearers if end.node not in nodes),
    )


def interposer_of(wiring: Wiring, wire: str) -> str:
    """The only interposer of a wire; raises WiringError unless there is exactly one."""
    wires = {known.key: known for known in wiring.wires}
    if wire not in wires:
        raise WiringError(f"no wire {wire!r}{nearest(wire, wires)}")
    interposers = wires[wire].interposers
    if len(interposers) != 1:
        names = ", ".join(interposers) or "no node"
        raise WiringError(f"the wire {wire!r}: found {names} on it, expected one: name the node instead")
    return interposers[0]


def taps_into(wiring: Wiring, nodes: Collection[str]) -> dict[str, str]:
    """The keys on which these nodes receive messages to forward; values: nodes."""
    return {
        leg.key: end.node
        for wire in wiring.wires
        for leg, onward in wire.hops
        for end in leg.subscribers
        if end.node in nodes and end.node == onward.publisher.node
    }


def parties(wire: Wire) -> set[str]:
    """The nodes that publish or subscribe to any leg of a wire."""
    legs = wire.every_leg
    return {leg.publisher.node for leg in legs} | {end.node for leg in legs for end in wire.receivers(leg)}


def extended(wire: Wire, legs: tuple[Leg, ...], taps: str, entrance: Endpoint, exit_: Endpoint) -> tuple[Leg, ...]:
    """A trunk or a branch with a node at its end. taps: the keys of its tap legs, without their numbers"""
    *before, last = legs
    taken = {leg.key for leg in wire.every_leg}
    tap = next(key for i in range(len(taken) + 1) if (key := f"{taps}/{i}") not in taken)
    return (*before, Leg(tap, last.publisher, (entrance,)), replace(last, publisher=exit_))


def _branch_of(wire: Wire, subscriber: str) -> Branch:
    """The branch of a subscriber; raises WiringError if it has none, as a subscriber keeps its key during a run."""
    for branch in wire.branches:
        if branch.subscriber.node == subscriber:
            return branch
    names = {end.node for end in wire.subscribers}
    if subscriber not in names:
        raise WiringError(f"{subscriber!r} does not subscribe to {wire.key!r}{nearest(subscriber, names)}")
    raise WiringError(
        f"no node is before {subscriber} alone on {wire.key!r}, and a subscriber keeps its key during a run: insert "
        "the first one at launch (PassThrough), and leave it there"
    )


def _without(wire: Wire, nodes: Collection[str]) -> Wire:
    branches, entrances = [], {}
    for branch in wire.branches:
        ends = [branch.entrance, *(leg.subscribers[0] for leg in branch.legs)]
        first = next((i for i, leg in enumerate(branch.legs) if leg.publisher.node not in nodes), len(branch.legs))
        entrances[branch.entrance] = ends[first]
        if first < len(branch.legs):
            branches.append(Branch(ends[first], branch.subscriber, _shortened(branch.legs[first:], nodes)))
    *before, last = _shortened(wire.legs, nodes)
    subscribers = (entrances.get(end, end) for end in last.subscribers)
    last = replace(last, subscribers=tuple(end for end in subscribers if end.node not in nodes))
    listeners = tuple(listener for listener in wire.listeners if listener.end.node not in nodes)
    return replace(wire, legs=(*before, last), branches=tuple(branches), listeners=listeners)


def _shortened(chain: tuple[Leg, ...], nodes: Collection[str]) -> tuple[Leg, ...]:
    """A trunk or a branch without some of its interposers, of which the first leg's publisher is none."""
    legs: list[Leg] = []
    for leg in chain:
        if leg.publisher.node in nodes:  # the leg before leads only to it
            leg = replace(leg, publisher=legs.pop().publisher)
        legs.append(leg)
    return tuple(legs)


def _check_source(wire: Wire) -> None:
    """Raise WiringError for listeners at the source, as their key cannot change."""
    names = ", ".join(listener.end.node for listener in wire.listeners if listener.source)
    if names:
        raise WiringError(
            f"{names} listens at the source of {wire.key!r} and would need another key, but a subscriber keeps its key "
            "during a run: insert the first interposer at launch (PassThrough), and leave it there"
        )
