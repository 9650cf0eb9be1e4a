"""A resolved wiring with one node more or less on a wire. Pure functions: what a running mesh is rewired to.

Inserting works as in a key-expression map: who published the wire's key gets a tap key, on which only the new node
listens, and the new node publishes the wire's key. Subscribers keep theirs. The new node stands at the end of the
trunk: behind all that are on it, before the subscribers and their branches.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace

from mast_zenoh.errors import WiringError, nearest
from mast_zenoh.wiring.model import TAP, Branch, Endpoint, Leg, Wire, Wiring

_NAME = re.compile(r"[A-Za-z0-9_.\-]+")


@dataclass(frozen=True, slots=True)
class Place:
    """Where a node is put into a running mesh.

    wire:  key of the wire that it sits on;  input, output: the ports by which it does
    hears: what else it hears, port by key of the wire
    says:  wires of its own, each with one leg
    """

    wire: str
    input: str
    output: str
    hears: Mapping[str, str] = field(default_factory=dict)
    says: tuple[Wire, ...] = ()


def insert(wiring: Wiring, node: str, place: Place) -> Wiring:
    """The wiring with `node` on a wire.

    Raises WiringError for an unknown wire, a node that has a part in it already, a listener at the source that would
    have to hear another key, a key that has a publisher already, and a name that cannot be part of a key.
    """
    if not _NAME.fullmatch(node):
        raise WiringError(f"node {node!r}: a node's name is one chunk of a key expression: letters, digits, _ . -")
    wires = {wire.key: wire for wire in wiring.wires}
    for key in (place.wire, *place.hears):
        if key not in wires:
            raise WiringError(f"no wire {key!r}{nearest(key, wires)}")
    target = wires[place.wire]
    if node in parties(target):
        raise WiringError(f"{node} is on the wire {target.key!r} already: that would be a loop")
    *before, last = target.legs
    if not before:
        _check_source(target)
    taken = {leg.key for leg in target.every_leg}
    tap = next(key for i in range(len(taken) + 1) if (key := f"{target.key}/{TAP}/{i}") not in taken)
    into = Leg(tap, last.publisher, (Endpoint(node, place.input),))
    out = replace(last, publisher=Endpoint(node, place.output))
    wires[target.key] = replace(target, legs=(*before, into, out))
    for key, port in place.hears.items():
        *before, last = wires[key].legs
        heard = replace(last, subscribers=(*last.subscribers, Endpoint(node, port)))
        wires[key] = replace(wires[key], legs=(*before, heard))
    for wire in place.says:
        if wire.key in wires:
            raise WiringError(f"the key {wire.key!r} has a publisher already")
        wires[wire.key] = wire
    return replace(wiring, wires=tuple(wires.values()))


def remove(wiring: Wiring, node: str) -> Wiring:
    """The wiring without `node`: whoever spoke to it on a wire speaks to those that it spoke to, on their key.

    Raises WiringError for a node that sits on no wire, for one that stands before a single subscriber, and where a
    listener at the source would have to hear another key.
    """
    sitting = {wire.key: wire.interposers for wire in wiring.wires if wire.interposers}
    if not any(node in interposers for interposers in sitting.values()):
        known = {name for interposers in sitting.values() for name in interposers}
        raise WiringError(f"no node {node!r} sits on a wire{nearest(node, known) if known else ''}")
    return replace(
        wiring, wires=tuple(_without(wire, node) for wire in wiring.wires if wire.legs[0].publisher.node != node)
    )


def never_inserted(wiring: Wiring, nodes: Collection[str]) -> Wiring:
    """The wiring of a run in which some nodes have no part at all: neither on wires, nor as publishers or listeners."""
    return Wiring(
        tuple(_without_all(wire, nodes) for wire in wiring.wires if wire.legs[0].publisher.node not in nodes),
        tuple(end for end in wiring.overhearers if end.node not in nodes),
    )


def interposer_of(wiring: Wiring, wire: str) -> str:
    """The one node that sits on a wire; raises WiringError where there is none, or more than one."""
    wires = {found.key: found for found in wiring.wires}
    if wire not in wires:
        raise WiringError(f"no wire {wire!r}{nearest(wire, wires)}")
    found = wires[wire].interposers
    if len(found) != 1:
        raise WiringError(f"{', '.join(found) or 'nobody'} on the wire {wire!r}: say whom by name")
    return found[0]


def taps_into(wiring: Wiring, nodes: Collection[str]) -> dict[str, str]:
    """The keys on which these nodes get what they pass on, each with the node."""
    return {
        leg.key: end.node
        for wire in wiring.wires
        for leg, onward in zip(wire.legs, wire.legs[1:], strict=False)
        for end in leg.subscribers
        if end.node in nodes and end.node == onward.publisher.node
    }


def parties(wire: Wire) -> set[str]:
    """The nodes that publish or hear any leg of a wire."""
    legs = wire.every_leg
    return {leg.publisher.node for leg in legs} | {end.node for leg in legs for end in wire.hearers(leg)}


def _without_all(wire: Wire, nodes: Collection[str]) -> Wire:
    trunk = _shortened(wire.legs, nodes)
    branches, entrances = [], {}
    for branch in wire.branches:
        ways = [branch.entrance, *(leg.subscribers[0] for leg in branch.legs)]
        kept = [i for i, leg in enumerate(branch.legs) if leg.publisher.node not in nodes]
        entrances[branch.entrance] = ways[kept[0]] if kept else branch.subscriber
        if kept:  # each node that stays publishes on the key that the next one hears
            before = [i - 1 for i in (*kept[1:], len(branch.legs))]
            legs = [
                replace(branch.legs[j], publisher=branch.legs[i].publisher) for i, j in zip(kept, before, strict=True)
            ]
            branches.append(Branch(ways[kept[0]], branch.subscriber, tuple(legs)))
    heard_by = tuple(entrances.get(end, end) for end in trunk[-1].subscribers)
    last = replace(trunk[-1], subscribers=tuple(end for end in heard_by if end.node not in nodes))
    listeners = tuple(listener for listener in wire.listeners if listener.end.node not in nodes)
    return replace(wire, legs=(*trunk[:-1], last), branches=tuple(branches), listeners=listeners)


def _shortened(trunk: tuple[Leg, ...], nodes: Collection[str]) -> list[Leg]:
    """A trunk without some of its interposers."""
    legs: list[Leg] = []
    for leg in trunk:
        if leg.publisher.node in nodes:  # the leg before leads to it, and to nobody else
            leg = replace(leg, publisher=legs.pop().publisher)
        legs.append(leg)
    return legs


def _check_source(wire: Wire) -> None:
    """Raise WiringError where nodes listen at the source: those that hear a wire keep their key while a run goes on."""
    names = ", ".join(listener.end.node for listener in wire.listeners if listener.source)
    if names:
        raise WiringError(
            f"{names} would hear the source of {wire.key!r} on another key, but a node that listens there keeps "
            "its key during a run: put the first interposer there at launch (PassThrough), and leave it there"
        )


def _without(wire: Wire, node: str) -> Wire:
    if any(node == leg.publisher.node for branch in wire.branches for leg in branch.legs):
        raise WiringError(f"{node} stands before one subscriber of {wire.key!r} alone: it cannot be released")
    wire = replace(wire, listeners=tuple(ear for ear in wire.listeners if ear.end.node != node))
    if len(wire.legs) > 1 and wire.legs[1].publisher.node == node:
        _check_source(wire)
    return replace(
        wire,
        legs=tuple(
            replace(leg, subscribers=tuple(end for end in leg.subscribers if end.node != node))
            for leg in _shortened(wire.legs, {node})
        ),
    )
