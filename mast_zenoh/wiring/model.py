"""A resolved key-expression map: wires, legs, ports; as JSON, text and diagram."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from itertools import pairwise
from typing import Any

from mast_zenoh.wiring.plain_shapes import ANY as ANY_KEY
from mast_zenoh.wiring.plain_shapes import NAMED, Name, check_shape

#: The message type of an input port that receives every key. A node with such a port publishes nothing.
ANY = "*"

#: The verbatim chunk of hidden legs, which wildcard subscribers do not match.
TAP = "@tap"

#: What a wire's messages are for an agent: from its sensors, from it to others, or from others to it.
DIRECTIONS = SENSOR, UP, DOWN = "sensor", "up", "down"


@dataclass(frozen=True, slots=True)
class Traits:
    """What a wire is for, as its entry in a key-expression map says. All nodes and measurements go by it.

    direction: for the agent in its key, or for all agents: "up" (it sends), "down" (it receives), "sensor"
    estimate: name of the estimate that its messages are, which is scored as it is sent; empty: none
    of:       key of another wire of the same sender, whose messages have the same errors of the sender's pose
    fuse:     whether a node that has no port of its own for it (`Node.takes`) fuses its objects
    itself:   whether its only object is its sender
    """

    direction: str = UP
    estimate: str = ""
    of: str = ""
    fuse: bool = False
    itself: bool = False

    def to_json(self) -> dict[str, Any]:
        """Those that are not the default."""
        return {name: value for name, value in asdict(self).items() if value != getattr(_PLAIN, name)}

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Traits:
        """Those in a wire that `to_json` wrote, or in a map's entry; other keys are left out."""
        return cls(**{each.name: data[each.name] for each in fields(cls) if data.get(each.name) is not None})


_PLAIN = Traits()
#: Delays of received wirings, frames: time goes on, and sums of them stay small.
_MOST_FRAMES = 1 << 31


@dataclass(frozen=True, slots=True)
class NodeFlow:
    """Which outputs of a node its inputs affect.

    role:    of the node
    affects: by input port, the output ports whose messages it can affect, each with the number of frames after which;
             an absent port affects all in the same frame, "" is for further ports
    fuses:   output ports of messages that combine what several agents say
    """

    role: str = ""
    affects: Mapping[str, Mapping[str, int]] = field(default_factory=dict)
    fuses: tuple[str, ...] = ()

    def delays(self, port: str, traits: Traits) -> Mapping[str, int] | None:
        """By output port, the number of frames after which messages on an input affect it; None: all in the same frame.

        traits: of their wire
        """
        if port in self.affects or "" not in self.affects:
            return self.affects.get(port)
        return self.affects[""] if traits.fuse else {}

    def to_json(self) -> dict[str, Any]:
        """Those of its fields that are not empty."""
        parts = {"role": self.role, "affects": {**self.affects}, "fuses": list(self.fuses)}
        return {name: part for name, part in parts.items() if part}

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> NodeFlow:
        """The flow that `to_json` wrote."""
        affects = {
            port: {output: min(max(0, frames or 0), _MOST_FRAMES) for output, frames in (outputs or {}).items()}
            for port, outputs in (data.get("affects") or {}).items()
        }
        return cls(data.get("role") or "", affects, tuple(data.get("fuses") or ()))


_LEG = {"key": str, "from": Name, "from_port": str, "to": [Name], "to_ports": [str], "before": str}
_WIRE: dict[str, Any] = {
    **dict.fromkeys(("key", "subject", "message", "publisher"), str),
    "subscribers": [str],
    "interposers": [str],
    "listeners": [{"node": Name, "port": str, "source": bool, "key": str}],
    "legs": [_LEG],
    **{each.name: type(each.default) for each in fields(Traits)},
}
_FLOW = {"role": str, "affects": {ANY_KEY: {ANY_KEY: int}}, "fuses": [str]}
#: The types of a wiring as JSON.
SHAPE: dict[str, Any] = {
    "wires": [_WIRE],
    "overhearers": [{"node": Name, "port": str}],
    "nodes": {NAMED: _FLOW},
    "recorded": {},
}


@dataclass(frozen=True, slots=True)
class Endpoint:
    """A port of a node."""

    node: str
    port: str


@dataclass(frozen=True, slots=True)
class Leg:
    """One key of a wire: its one publisher and its subscribers."""

    key: str
    publisher: Endpoint
    subscribers: tuple[Endpoint, ...]


@dataclass(frozen=True, slots=True)
class Branch:
    """The interposers of one subscriber, from the trunk at `entrance` onwards."""

    entrance: Endpoint
    subscriber: Endpoint
    legs: tuple[Leg, ...]


@dataclass(frozen=True, slots=True)
class Listener:
    """A subscriber that a rewrite adds to a wire.

    source: it receives what the publisher sends, before any interposer; else what is sent on the wire's key, after
            the interposers of the trunk and before the branches
    """

    end: Endpoint
    source: bool = False


@dataclass(frozen=True, slots=True)
class Wire:
    """A logical connection.

    subject: the names in its key (the agent of agent/{agent}/pose), see `agent_of`, or empty
    legs:      the trunk, common to all subscribers; its last leg has the wire's key, and leads to the subscribers
               without a branch and to the entrances of the branches
    listeners: other subscribers, which are not subscribers of its legs
    codec: in which its messages travel, see `messages.packed`; empty: as columns
    traits: what it is for
    """

    key: str
    subject: str
    message: str
    legs: tuple[Leg, ...]
    branches: tuple[Branch, ...] = ()
    listeners: tuple[Listener, ...] = ()
    codec: str = ""
    traits: Traits = Traits()

    @property
    def every_leg(self) -> tuple[Leg, ...]:
        """The legs of the trunk, then those of the branches."""
        return (*self.legs, *(leg for branch in self.branches for leg in branch.legs))

    @property
    def hops(self) -> tuple[tuple[Leg, Leg], ...]:
        """The leg into each interposer and the leg out of it; without those at the entrance of a branch."""
        return tuple(
            pair for legs in (self.legs, *(branch.legs for branch in self.branches)) for pair in pairwise(legs)
        )

    @property
    def interposers(self) -> tuple[str, ...]:
        """The nodes inserted into the wire: trunk first, then each branch."""
        return tuple(leg.publisher.node for leg in self.every_leg[1:])

    @property
    def subscribers(self) -> tuple[Endpoint, ...]:
        """The endpoints of the wire, with or without a branch."""
        branch_ends = {branch.entrance: branch.subscriber for branch in self.branches}
        return tuple(branch_ends.get(end, end) for end in self.legs[-1].subscribers)

    @property
    def last_legs(self) -> tuple[Leg, ...]:
        """The legs into its subscribers, after all interposers."""
        ends = set(self.subscribers)
        return tuple(leg for leg in self.every_leg if ends & set(leg.subscribers))

    def key_of(self, listener: Listener) -> str:
        """The key on which a listener receives the wire's messages."""
        return self.legs[0 if listener.source else -1].key

    def listeners_of(self, leg: Leg) -> tuple[Endpoint, ...]:
        """The listeners on one of the wire's legs."""
        return tuple(listener.end for listener in self.listeners if self.key_of(listener) == leg.key)

    def receivers(self, leg: Leg) -> tuple[Endpoint, ...]:
        """The subscribers and the listeners of one of the wire's legs."""
        return (*leg.subscribers, *self.listeners_of(leg))


@dataclass(frozen=True, slots=True)
class Input:
    """A node's input on one key; source: the wire's publisher, output: the port on which it publishes.

    traits: of the wire
    """

    port: str
    subject: str
    message: str
    source: str
    output: str = field(default="", compare=False)
    traits: Traits = field(default=Traits(), compare=False)


@dataclass(frozen=True, slots=True)
class Ports:
    """All keys of one node: inputs by key, outputs by (port, subject).

    codecs: by the key of a wire, the codec of all its legs, see `Wire`; types: of messages, by output port
    """

    inputs: Mapping[str, Input]
    outputs: Mapping[tuple[str, str], str]
    codecs: Mapping[str, str] = field(default_factory=dict)
    types: Mapping[str, str] = field(default_factory=dict)

    def codec(self, key: str) -> str:
        """The codec of a wire, by the key of one of its legs; empty: none."""
        return self.codecs.get(wire_key(key), "") if self.codecs else ""


@dataclass(frozen=True, slots=True)
class InterposedWire:
    """An interposer's two keys on one wire: for received and for forwarded messages.

    wire, subject, message: of the wire, see `Wire`; port: the output port of the wire's publisher
    before: the only subscriber that it serves; empty: it serves all of them
    """

    node: str
    wire: str
    subject: str
    message: str
    port: str
    received: str
    sent: str
    before: str = ""


@dataclass(frozen=True, slots=True)
class Wiring:
    """The key of every port of every node.

    overhearers: ports that receive every key, tap legs included, besides the subscribers of each
    nodes: what goes through the nodes of the scenario; those that are inserted later only forward
    recorded: of a replay, the wiring of the recorded run: what its messages depended on; else None
    """

    wires: tuple[Wire, ...]
    overhearers: tuple[Endpoint, ...] = ()
    nodes: Mapping[str, NodeFlow] = field(default_factory=dict, compare=False)
    recorded: Wiring | None = field(default=None, compare=False)

    def find(self, subject: str = "", *, estimate: str = "", message: str = "") -> Wire | None:
        """The wire of a subject with an estimate, or with messages of a type; None: there is none."""
        of_subject = (wire for wire in self.wires if wire.subject == subject)
        return next(
            (w for w in of_subject if (w.traits.estimate == estimate if estimate else w.message == message)), None
        )

    def legs(self) -> Iterator[tuple[Wire, Leg]]:
        """Every leg, of trunks and branches, with its wire."""
        for wire in self.wires:
            for leg in wire.every_leg:
                yield wire, leg

    def passages(self) -> Iterator[InterposedWire]:
        """Yield each interposer's passage through each of its wires, in order."""
        for wire in self.wires:
            ends = [("", leg) for leg in wire.legs]
            yield from _passages(wire, ends)
            for branch in wire.branches:
                before = branch.subscriber.node
                yield from _passages(wire, [ends[-1], *((before, leg) for leg in branch.legs)])

    def flows(self) -> Iterator[tuple[str, str, str]]:
        """Yield (key, publisher, subscriber) of every leg; listeners are subscribers too."""
        for wire, leg in self.legs():
            for end in (*wire.receivers(leg), *self.overhearers):
                yield leg.key, leg.publisher.node, end.node

    def keys(self) -> tuple[str, ...]:
        """Every key, tap legs included, in one fixed order."""
        return tuple(leg.key for _, leg in self.legs())

    @property
    def codecs(self) -> dict[str, str]:
        """The codecs of the wires that have one, by key."""
        return {wire.key: wire.codec for wire in self.wires if wire.codec}

    def ports(self, node: str) -> Ports:
        """The keys of one node."""
        own = [(wire, leg) for wire, leg in self.legs() if leg.publisher.node == node]
        outputs = {(leg.publisher.port, wire.subject): leg.key for wire, leg in own}
        inputs: dict[str, Input] = {}
        for wire, leg in self.legs():
            source = wire.legs[0].publisher
            for port in [end.port for end in (*wire.receivers(leg), *self.overhearers) if end.node == node]:
                inputs[leg.key] = Input(port, wire.subject, wire.message, source.node, source.port, wire.traits)
        return Ports(inputs, outputs, self.codecs, {leg.publisher.port: wire.message for wire, leg in own})

    def to_json(self) -> dict[str, Any]:
        """The content of wiring.json; `from_json` reads it back.

        Keys:
        wires: each with `key`, `subject`, `message`, `codec`, properties, `publisher`, `subscribers`, `interposers`,
            `listeners`, and `legs`: `key`, `from`, `to` with their ports, and `before` on a branch to one subscriber
        overhearers: `node` and `port` that receive every key
        nodes: by name, `role`, and what its inputs affect
        """

        def leg_json(leg: Leg, before: str = "") -> dict[str, Any]:
            return {
                "key": leg.key,
                "from": leg.publisher.node,
                "from_port": leg.publisher.port,
                "to": [end.node for end in leg.subscribers],
                "to_ports": [end.port for end in leg.subscribers],
                **({"before": before} if before else {}),
            }

        return {
            "wires": [
                {
                    "key": wire.key,
                    "subject": wire.subject,
                    "message": wire.message,
                    **({"codec": wire.codec} if wire.codec else {}),
                    **wire.traits.to_json(),
                    "publisher": wire.legs[0].publisher.node,
                    "subscribers": [end.node for end in wire.subscribers],
                    "interposers": list(wire.interposers),
                    "listeners": [
                        {
                            "node": listener.end.node,
                            "port": listener.end.port,
                            "source": listener.source,
                            "key": wire.key_of(listener),
                        }
                        for listener in wire.listeners
                    ],
                    "legs": [
                        *(leg_json(leg) for leg in wire.legs),
                        *(leg_json(leg, branch.subscriber.node) for branch in wire.branches for leg in branch.legs),
                    ],
                }
                for wire in self.wires
            ],
            "overhearers": [{"node": end.node, "port": end.port} for end in self.overhearers],
            "nodes": {name: flow.to_json() for name, flow in self.nodes.items()},
            **({"recorded": self.recorded.to_json()} if self.recorded else {}),
        }

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Wiring:
        """The wiring that `to_json` wrote; raises ValueError, TypeError or LookupError for another."""
        check_shape(data, SHAPE)
        overhearers = tuple(Endpoint(**end) for end in data.get("overhearers") or ())
        nodes = {name: NodeFlow.from_json(flow or {}) for name, flow in (data.get("nodes") or {}).items()}
        recorded = cls.from_json({**data["recorded"], "recorded": None}) if data.get("recorded") else None
        return cls(tuple(map(_wire_of, data["wires"])), overhearers, nodes, recorded)


#: A wiring without wires.
NO_WIRING = Wiring(())


def _passages(wire: Wire, legs: Sequence[tuple[str, Leg]]) -> Iterator[InterposedWire]:
    """The passages between consecutive legs, each with its only subscriber or ""."""
    for (_, into), (before, out) in pairwise(legs):
        of_wire = wire.key, wire.subject, wire.message, wire.legs[0].publisher.port
        yield InterposedWire(out.publisher.node, *of_wire, into.key, out.key, before)


def _wire_of(data: Mapping[str, Any]) -> Wire:
    trunk: list[Leg] = []
    branches: dict[str, list[Leg]] = {}
    for leg_data in data["legs"]:
        ends = tuple(map(Endpoint, leg_data["to"], leg_data["to_ports"]))
        leg = Leg(leg_data["key"], Endpoint(leg_data["from"], leg_data["from_port"]), ends)
        (branches.setdefault(leg_data["before"], []) if leg_data.get("before") else trunk).append(leg)
    entries = {end.node: end for end in trunk[-1].subscribers}
    return Wire(
        data["key"],
        data["subject"],
        data["message"],
        tuple(trunk),
        tuple(
            Branch(entries[legs[0].publisher.node], legs[-1].subscribers[0], tuple(legs)) for legs in branches.values()
        ),
        tuple(Listener(Endpoint(item["node"], item["port"]), item["source"]) for item in data.get("listeners", ())),
        str(data.get("codec", "")),
        Traits.from_json(data),
    )


def to_text(wiring: Wiring) -> str:
    """The wiring as lines: each wire, its chain, rewrites marked."""
    lines = []
    for wire in wiring.wires:
        marker = "*" if wire.interposers else " "
        first, *remaining = wire.legs
        chain = f"{first.publisher.node} ─▶ " + "".join(f"[{leg.publisher.node}] ─▶ " for leg in remaining)
        chains = {
            branch.subscriber: "".join(f"[{leg.publisher.node}] ─▶ " for leg in branch.legs) for branch in wire.branches
        }
        ends = ", ".join(f"({chains[end]}{end.node})" if end in chains else end.node for end in wire.subscribers)
        codec = f"  as {wire.codec}" if wire.codec else ""
        lines.append(f"{marker} {wire.key:<34} {chain}{ends or '(no subscriber)'}{codec}")
        lines += [
            f"      {leg.publisher.node} ── {leg.key} ──▶ {end.node} (listens)"
            for leg in wire.legs
            for end in wire.listeners_of(leg)
        ]
        if wire.interposers:
            lines += [
                f"      {leg.publisher.node} ── {leg.key} ──▶ {', '.join(e.node for e in leg.subscribers)}"
                for leg in wire.every_leg
            ]
    lines += ["", f"{len(wiring.wires)} wires; * rewritten, [node] inserted"]
    return "\n".join([*lines, *(f"{end.node} subscribes to every key" for end in wiring.overhearers)])


def to_mermaid(wiring: Wiring) -> str:
    """A Mermaid flow chart with inserted nodes, tap legs and listeners marked."""
    lines = ["flowchart LR"]
    interposers = sorted({node for wire in wiring.wires for node in wire.interposers})
    lines += [f"    {node}{{{{{node}}}}}:::inserted" for node in interposers]
    for wire, leg in wiring.legs():
        arrow = "-.->" if leg.key != wire.key else "-->"
        lines += [f'    {leg.publisher.node} {arrow}|"{leg.key}"| {end.node}' for end in leg.subscribers]
        lines += [f'    {leg.publisher.node} --o|"{leg.key}"| {end.node}' for end in wire.listeners_of(leg)]
    return "\n".join([*lines, "    classDef inserted fill:#c0392b,color:#fff"])


# The subject of a wire is the names in its key: that of agent/infra_1/pose is "infra_1". A wire of one of several
# sensors, agent/infra_1/detections/radar, has two names in its key: its subject is "infra_1/radar".


def agent_of(subject: str) -> str:
    """The agent in a subject: its first name."""
    return subject.partition("/")[0]


def part_of(subject: str) -> str:
    """The part of the agent in a subject: its second name; empty without one."""
    return subject.partition("/")[2]


def subject_of(agent: str, part: str) -> str:
    """The subject of a part of an agent, or of the agent itself if `part` is empty."""
    return f"{agent}/{part}" if part else agent


def takes(types: Collection[str], message: str) -> bool:
    """Whether a message type is among those that a node takes on further ports (`Node.takes`)."""
    return message in types or ANY in types


def wire_key(key: str) -> str:
    """The key of a wire, from that of one of its legs."""
    return key.partition(f"/{TAP}/")[0]


def peer_of(agent: str) -> str:
    """The name of an agent's peer."""
    return f"peer_{agent}"


def link_of(place: str) -> str:
    """The name of the link of an agent, or of a wire that has one of its own. place: the agent, or the wire's key"""
    return f"link_{place.replace('/', '_')}"
