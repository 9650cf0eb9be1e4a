"""Applies rewrites to a wire: `[[insert]]` nodes, `[[listen]]` adds subscribers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from mast_zenoh.errors import WiringError
from mast_zenoh.wiring.endpoints import NodeOptions, members, ports
from mast_zenoh.wiring.model import TAP, Branch, Endpoint, Leg, Listener, Wire


def insert(
    wire: Wire, entry: Mapping[str, Any], placeholder: str, nodes: Mapping[str, NodeOptions], place: str
) -> Wire:
    """The wire with the nodes of an `[[insert]]`.

    They come before all subscribers, or before the one of the role `to`. A node that subscribes to the wire on the same
    port receives it as an interposer instead.
    Raises WiringError for a node without the ports, a node that is on the wire already, an ambiguous `to`, and one to
    which the wire does not lead, unless the entry is `optional`.
    """
    inserted = members(
        entry["role"], nodes, place, placeholder=placeholder, subject=wire.subject, node=entry.get("node")
    )
    into = ports(inserted, entry["input"], wire.message, place)
    out = ports(inserted, entry["output"], wire.message, place, output=True)
    for entrance, exit_ in zip(into, out, strict=True):
        subscriber = _subscriber(wire, entrance.node, entry["to"], nodes, place) if "to" in entry else None
        if "to" in entry and subscriber is None:
            if entry.get("optional"):
                continue
            raise _not_a_subscriber(wire, entrance.node, entry["to"], nodes, place)
        wire = _without_subscriber(wire, entrance)
        on_wire = {wire.legs[0].publisher.node, *wire.interposers, *(end.node for end in wire.subscribers)}
        if entrance.node in on_wire:
            raise WiringError(f"{place}: {entrance.node} is already on the wire {wire.key!r}: that would be a loop")
        if subscriber is not None:
            wire = _on_branch(wire, entrance, exit_, subscriber)
        else:
            *before, last = wire.legs
            tap = f"{wire.key}/{TAP}/{len(before)}"
            legs = (*before, Leg(tap, last.publisher, (entrance,)), Leg(wire.key, exit_, last.subscribers))
            wire = replace(wire, legs=legs)
    return wire


def listen(wire: Wire, listeners: list[Listener], place: str, *, every: bool) -> Wire:
    """The wire with more listeners.

    A node receives a wire once, and never what it publishes or forwards itself.
    every: the entry refers to every wire of its kind: a node that cannot listen to this one is skipped. Otherwise
           WiringError is raised, unless the node already receives the wire as the entry asks.
    """
    for listener in listeners:
        node = listener.end.node
        received = {known.end.node: known for known in (*map(Listener, wire.subscribers), *wire.listeners)}
        if node in (wire.legs[0].publisher.node, *wire.interposers):
            if not every:
                raise WiringError(
                    f"{place}: {node} publishes or forwards {wire.key!r}: it would receive its own messages"
                )
        elif node not in received:
            wire = replace(wire, listeners=(*wire.listeners, listener))
        elif not every and received[node] != listener:
            where = f"its port {received[node].end.port!r}{' at the source' if received[node].source else ''}"
            raise WiringError(
                f"{place}: {node} already receives {wire.key!r} on {where}: a node can receive a wire only once"
            )
    return wire


def _without_subscriber(wire: Wire, end: Endpoint) -> Wire:
    """The wire without a subscriber that no branch leads to."""
    *before, last = wire.legs
    if end not in last.subscribers or any(end in (branch.entrance, branch.subscriber) for branch in wire.branches):
        return wire
    kept = tuple(other for other in last.subscribers if other != end)
    return replace(wire, legs=(*before, replace(last, subscribers=kept)))


def _subscriber(wire: Wire, node: str, role: str, nodes: Mapping[str, NodeOptions], place: str) -> Endpoint | None:
    """The subscriber of `role` before which a node is inserted; None if there is none.

    It is the one that the node's option with the role's name names, else the only one.
    """
    ends = [end for end in wire.subscribers if nodes[end.node].role == role]
    preferred = nodes[node].names(role)
    if preferred:
        ends = [end for end in ends if end.node in preferred]
    if len(ends) > 1:
        names = ", ".join(end.node for end in ends)
        raise WiringError(
            f"{place}: {wire.key!r} leads to {names}: the option `{role}` of {node} must name one of them"
        )
    return ends[0] if ends else None


def _not_a_subscriber(wire: Wire, node: str, role: str, nodes: Mapping[str, NodeOptions], place: str) -> WiringError:
    """The error about a wire that does not lead to the subscriber before which a node is to come."""
    wanted = ", ".join(nodes[node].names(role)) or f"any {role}"
    found = ", ".join(end.node for end in wire.subscribers) or "nobody"
    hint = f" (agents.{wanted}.acts=true gives it the picture)" if wire.message == "picture" else ""
    return WiringError(f"{place}: {node} is to come before {wanted}, but {wire.key!r} leads to {found}{hint}")


def _on_branch(wire: Wire, entrance: Endpoint, exit_: Endpoint, subscriber: Endpoint) -> Wire:
    """The wire with a node at the end of a branch, which is created if needed."""
    branches = {branch.subscriber: branch for branch in wire.branches}
    branch = branches.get(subscriber)
    legs = branch.legs if branch else ()
    last = Leg(f"{wire.key}/{TAP}/{subscriber.node}/{len(legs)}", exit_, (subscriber,))
    if branch:
        legs = (*legs[:-1], replace(legs[-1], subscribers=(entrance,)), last)
        branches[subscriber] = replace(branch, legs=legs)
        return replace(wire, branches=tuple(branches.values()))
    *before, end = wire.legs
    subscribers = tuple(entrance if other == subscriber else other for other in end.subscribers)
    branches[subscriber] = Branch(entrance, subscriber, (last,))
    return replace(wire, legs=(*before, replace(end, subscribers=subscribers)), branches=tuple(branches.values()))
