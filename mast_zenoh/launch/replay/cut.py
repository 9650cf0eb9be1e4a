"""Divides the nodes of a recorded run into played and live ones, and fits its wiring to them. Pure functions."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Literal

from mast_zenoh.config.resolved import DRIVER_ROLE
from mast_zenoh.errors import WiringError, nearest
from mast_zenoh.node import Node
from mast_zenoh.wiring import insertion
from mast_zenoh.wiring.model import ANY, Branch, Endpoint, Leg, Listener, Wire, Wiring, takes

#: The roles that are played, by the place of the cut; drivers, because a recorded truth follows from their commands.
PLAYED_ROLES: Mapping[str, tuple[str, ...]] = {
    "agents": (DRIVER_ROLE, "driver", "detector", "agent"),
    "simulator": (DRIVER_ROLE, "driver"),
}
Place = Literal["agents", "simulator"]

#: Roles that are on wires, or direct nodes that are.
_ON_WIRES = ("adversary", "coordinator", "link")
#: Ports of a player.
_CLOCK, _UNUSED = "clock", "unused"


@dataclass(frozen=True)
class ReplayedMesh:
    """The nodes and wires of a replay.

    played: names of the nodes that only send what was recorded
    live:   names of the nodes that run
    wiring: of the recorded run, without the wires that no live node receives from agents, and without the inputs of
            played nodes except for the clock
    """

    played: frozenset[str]
    live: frozenset[str]
    wiring: Wiring


def cut(wiring: Wiring, roles: Mapping[str, str], place: Place, fixed: Collection[str] = ()) -> ReplayedMesh:
    """Divide a run at its agents or at its simulator.

    Played are the nodes of the roles before the cut, and those that were inserted into their wires. Nodes on the wires
    between two live nodes are live, and so are coordinators of live adversaries.

    wiring: of the recorded run;  roles: by node;  fixed: nodes that are played, wherever they are
    """
    first = {name for name, role in roles.items() if role in PLAYED_ROLES[place]} | {*fixed}
    interposers = {name for wire in wiring.wires for name in wire.interposers}
    between = {name for name, role in roles.items() if name in interposers or role in _ON_WIRES} - first
    live = roles.keys() - first - between
    while more := between & _between_live(wiring, roles, live) - live:
        live |= more
    played = roles.keys() - live
    wires = _without_idle_reports(wiring, tuple(_wires(wiring, roles, played)))
    sending = {leg.publisher.node for wire in wires for leg in wire.every_leg}
    # An agent without outputs is still a member of the run: the broker knows it.
    played = {name for name in played if name in sending or roles[name] == "agent"}
    players = {name for name in played if roles[name] != DRIVER_ROLE}
    overhearers = tuple(end for end in wiring.overhearers if end.node in live)
    clocked = tuple(_clocked(wire, players, live) if wire.message == "clock" else wire for wire in wires)
    return ReplayedMesh(
        frozenset(played),
        frozenset(live),
        replace(wiring, wires=clocked, overhearers=overhearers, recorded=wiring.recorded or wiring),
    )


def _between_live(wiring: Wiring, roles: Mapping[str, str], live: Collection[str]) -> set[str]:
    """Interposers between two live nodes, and coordinators that direct live nodes."""
    nodes: set[str] = set()
    for wire in wiring.wires:
        publisher = wire.legs[0].publisher.node
        receivers = _receivers(wire) & set(live)
        if receivers and roles.get(publisher) == "coordinator":
            nodes.add(publisher)
        if receivers and publisher in live:
            nodes |= {leg.publisher.node for leg in wire.legs[1:]}
        for branch in wire.branches:
            if publisher in live and branch.subscriber.node in live:
                nodes |= {leg.publisher.node for leg in branch.legs}
    return nodes


def _receivers(wire: Wire) -> set[str]:
    return {end.node for end in (*wire.subscribers, *(listener.end for listener in wire.listeners))}


def _wires(wiring: Wiring, roles: Mapping[str, str], played: Collection[str]) -> Iterator[Wire]:
    """The wires of a replay."""
    for wire in wiring.wires:
        publisher = wire.legs[0].publisher.node
        if publisher not in played:
            yield _towards_live(wire, played)
        elif roles.get(publisher) != "agent" or _receivers(wire) - set(played):
            # What agents send to no live node, such as mission estimates, is left out: it follows from the recorded
            # picture, not from that of the replay.
            yield _without_inputs(wire, played)


def _without_idle_reports(recorded: Wiring, wires: tuple[Wire, ...]) -> tuple[Wire, ...]:
    """The wires without reports of interposers whose every wire is left out: nothing is there to compare them with."""
    passing = {name for wire in wires for name in wire.interposers}
    idle = {name for wire in recorded.wires for name in wire.interposers} - passing
    return tuple(wire for wire in wires if wire.legs[0].publisher.node not in idle)


def _towards_live(wire: Wire, played: Collection[str]) -> Wire:
    """A live node's wire without all that leads to played nodes."""
    *before, last = wire.legs
    ended = {branch.entrance for branch in wire.branches if branch.subscriber.node in played}
    kept = tuple(end for end in last.subscribers if end not in ended)
    branches = tuple(branch for branch in wire.branches if branch.entrance not in ended)
    wire = replace(wire, legs=(*before, replace(last, subscribers=kept)), branches=branches)
    (shortened,) = insertion.never_inserted(Wiring((wire,)), played).wires
    return shortened


def _without_inputs(wire: Wire, played: Collection[str]) -> Wire:
    """A played node's wire without played subscribers.

    The first nodes of branches stay, as branches begin at a subscriber, and so do all subscribers of the clock.
    """
    clock = wire.message == "clock"
    entrances = {branch.entrance for branch in wire.branches}

    def renamed(end: Endpoint) -> Endpoint:
        return Endpoint(end.node, _CLOCK if clock else _UNUSED) if end.node in played else end

    def kept(leg: Leg) -> Leg:
        ends = (end for end in leg.subscribers if clock or end.node not in played or end in entrances)
        return replace(leg, subscribers=tuple(map(renamed, ends)))

    branches = tuple(
        Branch(renamed(branch.entrance), renamed(branch.subscriber), _branch_legs(branch, kept, renamed))
        for branch in wire.branches
    )
    listeners = tuple(listener for listener in wire.listeners if listener.end.node not in played)
    return replace(wire, legs=tuple(map(kept, wire.legs)), branches=branches, listeners=listeners)


def _branch_legs(
    branch: Branch, kept: Callable[[Leg], Leg], renamed: Callable[[Endpoint], Endpoint]
) -> tuple[Leg, ...]:
    """The legs of a branch; the last one keeps its subscriber, which defines the branch."""
    *before, last = branch.legs
    return (*map(kept, before), replace(last, subscribers=tuple(map(renamed, last.subscribers))))


def _clocked(wire: Wire, players: Collection[str], live: Collection[str]) -> Wire:
    """The wire of the clock, with all players and live nodes that it has, and no others."""
    everyone = {*players, *live}

    def kept(leg: Leg) -> Leg:
        return replace(leg, subscribers=tuple(end for end in leg.subscribers if end.node in everyone))

    wire = replace(wire, legs=tuple(map(kept, wire.legs)))
    receiving = {end.node for leg in wire.every_leg for end in leg.subscribers}
    added = (Listener(Endpoint(name, _CLOCK)) for name in sorted({*players} - receiving))
    return replace(wire, listeners=(*wire.listeners, *added))


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
    return replace(wiring, wires=tuple(_fitted_wires(wiring, classes)), overhearers=tuple(overhearing.values()))


def _fitted_wires(wiring: Wiring, classes: Mapping[str, type[Node]]) -> Iterator[Wire]:
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
        known = [tuple(end for end in leg.subscribers if _is_input(end, wire, classes)) for leg in wire.legs]
        legs = tuple(replace(leg, subscribers=ends) for leg, ends in zip(wire.legs, known, strict=True))
        listeners = tuple(listener for listener in wire.listeners if _is_input(listener.end, wire, classes))
        yield replace(wire, legs=legs, listeners=listeners)


def _is_input(end: Endpoint, wire: Wire, classes: Mapping[str, type[Node]]) -> bool:
    """Whether a node has an input port; True for played nodes."""
    if end.node not in classes:
        return True
    cls = classes[end.node]
    if end.port not in cls.inputs and takes((*cls.takes, *cls.forwards), wire.message):
        return True
    known = cls.inputs.get(end.port)
    if known not in (None, wire.message):
        raise WiringError(
            f"{end.node}.{end.port} is for {known!r} messages, expected {wire.message!r}, as the wire {wire.key!r}"
        )
    return known is not None
