"""Fits the recorded wiring to the ports of changed nodes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

from mast_zenoh.errors import WiringError, nearest
from mast_zenoh.node import Node
from mast_zenoh.wiring.model import ANY, Endpoint, Leg, Wire, Wiring


def fitted(wiring: Wiring, classes: Mapping[str, type[Node]]) -> Wiring:
    """The wiring with the ports that live nodes have.

    An input port that a class lacks is left out, and so is an output port that no node receives.

    classes: of the live nodes. Raises WiringError for any other output port that a class lacks, and for a port with
    another message type than the recorded wire.
    """
    overhearing = {end.node: end for end in wiring.overhearers}
    for name, cls in classes.items():
        ports = [port for port, message in cls.inputs.items() if message == ANY]
        if name in overhearing and ports:
            overhearing[name] = Endpoint(name, ports[0])
    return Wiring(tuple(_wires(wiring, classes)), tuple(overhearing.values()))


def _wires(wiring: Wiring, classes: Mapping[str, type[Node]]) -> Iterator[Wire]:
    for wire in wiring.wires:
        publisher = wire.legs[0].publisher
        outputs = classes[publisher.node].outputs if publisher.node in classes else {publisher.port: wire.message}
        if outputs.get(publisher.port) != wire.message:
            if wire.subscribers or wire.listeners:
                raise WiringError(
                    f"{publisher.node}: has no output port {publisher.port!r} for {wire.message!r} messages, expected "
                    f"one, as the recorded node has it{nearest(publisher.port, outputs)}"
                )
            continue
        for branch in wire.branches:
            if not _is_input(branch.subscriber, wire, classes):
                raise WiringError(
                    f"{branch.subscriber.node}: has no input port {branch.subscriber.port!r}, expected one: in the "
                    f"recorded run, {branch.entrance.node} is before it on {wire.key!r}"
                )
        legs = tuple(_with_known_ports(leg, wire, classes) for leg in wire.legs)
        listeners = tuple(listener for listener in wire.listeners if _is_input(listener.end, wire, classes))
        yield replace(wire, legs=legs, listeners=listeners)


def _with_known_ports(leg: Leg, wire: Wire, classes: Mapping[str, type[Node]]) -> Leg:
    return replace(leg, subscribers=tuple(end for end in leg.subscribers if _is_input(end, wire, classes)))


def _is_input(end: Endpoint, wire: Wire, classes: Mapping[str, type[Node]]) -> bool:
    """Whether a node has an input port; True for played nodes."""
    if end.node not in classes:
        return True
    known = classes[end.node].inputs.get(end.port)
    if known not in (None, wire.message):
        raise WiringError(
            f"{end.node}.{end.port} is for {known!r} messages, expected {wire.message!r}, as the wire {wire.key!r}"
        )
    return known is not None
