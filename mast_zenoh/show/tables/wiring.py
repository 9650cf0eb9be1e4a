"""The wires of a run: table rows, and the layout of the wiring diagram."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from mast_zenoh.runs.interposers import all_wires, interposers
from mast_zenoh.runs.run import Run

#: The receivers of what a peer sends to all others, drawn as one node.
_OTHER_PEERS = "all other peers"
#: Columns of roles along the flow of a frame, left to right; the agents stand one above the other, their peers beside.
_COLUMNS = {"simulator": 0, "agent": 1, "center": 2, "peer": 2, "broker": 3, "command_center": 4, _OTHER_PEERS: 4}
#: Listen-only roles, and messages for all nodes or for listeners only: in the table but not in the diagram.
_LISTENERS = ("evaluator", "recorder", "visualizer")
_UNDRAWN = ("clock", "truth", "attack_report")

#: Inches: a node's width and height, between columns, between the rows of two agents.
WIDE, HIGH, GAP, ROW = 1.5, 0.34, 0.75, 0.72


@dataclass(frozen=True, slots=True)
class WireRow:
    """One wire in the table.

    taps:     key expressions of the hidden legs
    links:    interposers that model the network
    when:     frames of live interposers, in words
    branches: subscribers with their own interposers
    before:   the subscribers after each interposer that serves only some of them
    """

    key: str
    message: str
    publisher: str
    interposers: tuple[str, ...]
    subscribers: tuple[str, ...]
    taps: tuple[str, ...]
    links: tuple[str, ...] = ()
    when: Mapping[str, str] = field(default_factory=dict)
    branches: tuple[str, ...] = ()
    before: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    @property
    def intercepted(self) -> bool:
        """Whether an interposer other than a link sits on the wire."""
        return len(self.links) < len(self.interposers)


def wire_rows(run: Run) -> list[WireRow]:
    """All wires: the intercepted ones first, then those with links, then by key."""
    when = live_frames(run)
    rows = [
        WireRow(
            wire["key"],
            wire.get("message", ""),
            wire.get("publisher", ""),
            tuple(wire.get("interposers", ())),
            (
                *wire.get("subscribers", ()),
                *(f"{listener['node']} (listens)" for listener in wire.get("listeners", ())),
            ),
            tuple(leg["key"] for leg in wire.get("legs", ()) if leg["key"] not in ("", wire["key"])),
            tuple(node for node in wire.get("interposers", ()) if run.role(node) == "link"),
            {node: when[node] for node in wire.get("interposers", ()) if node in when},
            tuple(dict.fromkeys(leg["before"] for leg in wire.get("legs", ()) if leg.get("before"))),
            _before(wire),
        )
        for wire in all_wires(run)
    ]
    return sorted(rows, key=lambda row: (not row.intercepted, not row.interposers, row.key))


def _before(wire: Mapping[str, Any]) -> dict[str, tuple[str, ...]]:
    """The subscribers after each interposer that serves only some of them."""
    subscribers: dict[str, tuple[str, ...]] = {}
    for leg in wire.get("legs", ()):
        if leg.get("before"):
            subscribers[leg["from"]] = (*subscribers.get(leg["from"], ()), leg["before"])
    return subscribers


def live_frames(run: Run) -> dict[str, str]:
    """The frames of live interposers on their wire, in words."""
    live_interposers = {each.name: each for each in interposers(run) if each.live is not None}
    return {
        name: f"from frame {each.live}" if each.released is None else f"frames {each.live} to {each.released - 1}"
        for name, each in live_interposers.items()
    }


def column_of(run: Run, node: str) -> int | None:
    """The column in which a node is drawn; None: it is outside the flow of a frame."""
    return _COLUMNS.get(node, _COLUMNS.get(run.role(node)))


class Spot(NamedTuple):
    """A node in the diagram; an interposer of two wires may have two spots.

    after: the column to the left of an interposer, -1 for all other nodes
    """

    node: str
    after: int = -1


@dataclass(slots=True)
class DiagramLine:
    """A line between two nodes.

    messages: types; intercepted: by an adversary; linked: with a link on the wire
    """

    messages: list[str] = field(default_factory=list)
    intercepted: bool = False
    linked: bool = False


@dataclass(frozen=True, slots=True)
class DiagramLayout:
    """The layout of the diagram, in inches, y downwards.

    places: (x, y) of the centre of every spot
    lines:  by (from, to)
    floor:  y of the line for messages against the flow
    """

    places: dict[Spot, tuple[float, float]]
    lines: dict[tuple[Spot, Spot], DiagramLine]
    floor: float


def layout(run: Run) -> DiagramLayout | None:
    """Place the nodes of a run in columns along the flow of a frame.

    None: there is nothing to draw.
    Interposers are placed between the ends of their wire, half a row above its agent. Nodes outside the flow (a
    coordinator) are placed above their neighbours.
    """
    wires = [_grouped(run, wire) for wire in all_wires(run) if wire.get("message") not in _UNDRAWN]
    lines = _lines(run, wires)
    spots = sorted({spot for pair in lines for spot in pair})
    if not spots:
        return None
    agents = sorted({s.node for s in spots if run.role(s.node) == "agent"}, key=lambda n: (n != run.ego, _natural(n)))
    row = {agent: float(index) for index, agent in enumerate(agents)}
    middle = max(len(agents) - 1, 0) / 2
    for wire in wires:
        if run.role(wire["publisher"]) == "peer" and wire.get("subject") in row:
            row[wire["publisher"]] = row[wire["subject"]]

    wire_positions: dict[Spot, tuple[int, float]] = {}  # of interposers: position in the chain, row
    slots_after: dict[int, int] = defaultdict(int)
    for wire in wires:
        after = _gap(run, wire)
        ends = (wire["publisher"], *wire["subscribers"][:1])
        for node, (order, before) in _orders(wire).items():
            row_of_wire = next((row[end] for end in (before, *ends) if end in row), middle)
            wire_positions.setdefault(Spot(node, after), (order, row_of_wire - 0.5))
            slots_after[after] = max(slots_after[after], order + 1)
    used = {column_of(run, spot.node) for spot in spots}
    column_x = [0.0]
    for index in range(max(_COLUMNS.values()) + 1):
        column_x.append(column_x[-1] + (WIDE + GAP) * ((index in used) + slots_after[index]))

    places: dict[Spot, tuple[float, float]] = {}
    stacked: dict[int, int] = defaultdict(int)
    for spot in spots:
        column = column_of(run, spot.node)
        if spot in wire_positions:
            order, level = wire_positions[spot]
            places[spot] = column_x[spot.after] + (WIDE + GAP) * (order + 1), level * ROW
        elif column is not None and spot.node in row:
            places[spot] = column_x[column], row[spot.node] * ROW
        elif column is not None:
            places[spot] = column_x[column], (middle + stacked[column]) * ROW
            stacked[column] += 1
    above = min((y for _, y in places.values()), default=0.0) - 1.4 * ROW
    for index, spot in enumerate([spot for spot in spots if spot not in places]):
        near = [
            places[other][0] for pair in lines if spot in pair for other in pair if other in places and other != spot
        ]
        places[spot] = (sum(near) / len(near) if near else column_x[1]) + index * (WIDE + 0.2), above
    return DiagramLayout(places, lines, max(y for _, y in places.values()) + 0.8)


def _orders(wire: Mapping[str, Any]) -> dict[str, tuple[int, str]]:
    """(number of interposers before it, its only subscriber or "") by interposer."""
    legs = wire.get("legs", ())
    if not any(leg.get("before") for leg in legs):
        return {node: (order, "") for order, node in enumerate(wire.get("interposers", ()))}
    trunk = [leg["from"] for leg in legs if not leg.get("before")][1:]
    orders = {node: (order, "") for order, node in enumerate(trunk)}
    passed: dict[str, int] = {}
    for leg in legs:
        before = leg.get("before")
        if before:
            order = passed.get(before, len(trunk))
            passed[before] = order + 1
            orders[leg["from"]] = order, before
    return orders


def _gap(run: Run, wire: Mapping[str, Any]) -> int:
    """The column to the left of a wire's interposers."""
    columns = [column_of(run, end) for end in (wire["publisher"], *wire["subscribers"][:1])]
    return min((column for column in columns if column is not None), default=max(_COLUMNS.values()))


def _grouped(run: Run, wire: dict[str, Any]) -> dict[str, Any]:
    """A wire with one node in place of all peers that hear it; one that an interposer serves alone stays."""
    if sum(run.role(node) == "peer" for node in wire.get("subscribers", ())) < 2:
        return wire

    def grouped(nodes: Sequence[str]) -> list[str]:
        return list(dict.fromkeys(_OTHER_PEERS if run.role(node) == "peer" else node for node in nodes))

    legs = [leg if leg.get("before") else {**leg, "to": grouped(leg["to"])} for leg in wire.get("legs", ())]
    return {**wire, "subscribers": grouped(wire["subscribers"]), "legs": legs}


def _lines(run: Run, wires: Sequence[Mapping[str, Any]]) -> dict[tuple[Spot, Spot], DiagramLine]:
    columns_by_node: dict[str, int] = {}
    for wire in wires:
        for node in wire.get("interposers", ()):
            columns_by_node[node] = min(columns_by_node.get(node, len(_COLUMNS)), _gap(run, wire))
    lines: dict[tuple[Spot, Spot], DiagramLine] = defaultdict(DiagramLine)
    for wire in wires:
        chain = wire.get("interposers", ())
        branched = any(leg.get("before") for leg in wire.get("legs", ()))

        def spot(node: str, wire: Mapping[str, Any] = wire, chain: Sequence[str] = chain) -> Spot:
            return Spot(node, _gap(run, wire) if node in chain else columns_by_node.get(node, -1))

        for leg in wire.get("legs") or [{"from": wire["publisher"], "to": wire["subscribers"]}]:
            listeners = [
                listener["node"] for listener in wire.get("listeners", ()) if listener["key"] == leg.get("key")
            ]
            for to in (*leg["to"], *listeners):
                if run.role(to) in _LISTENERS:
                    continue
                line = lines[spot(leg["from"]), spot(to)]
                touched = chain if not branched else [node for node in (leg["from"], to) if node in chain]
                line.intercepted |= any(run.role(node) != "link" for node in touched)
                line.linked |= any(run.role(node) == "link" for node in touched)
                if wire["message"] not in line.messages:
                    line.messages.append(wire["message"])
    return dict(lines)


def _natural(name: str) -> tuple[str, int]:
    """Sort key that puts infra_2 before infra_10."""
    stem = name.rstrip("0123456789")
    return stem, int(name[len(stem) :] or 0)
