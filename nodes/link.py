"""A link: an agent's connection to the network, with all that is wrong with it.

It stands before the broker on what its agent says (tracks, status), and before its agent on what that hears (the
picture): the key-expression map decides (keyexpr_maps/network.toml). Rules act on every message in their order: they
let it pass, later, not at all, several times, or changed.
"""

from __future__ import annotations

from collections import Counter
from typing import NamedTuple

import numpy as np

from mast_zenoh.arrays.states import Floats
from mast_zenoh.errors import MessageError
from mast_zenoh.gather import LatestBefore
from mast_zenoh.links import FATES, WIRES, Chain, Outcome, Passage, Rule, displaced, flipped
from mast_zenoh.messages import codec
from mast_zenoh.messages.schemas import Body
from mast_zenoh.node import Context, Node, Received
from mast_zenoh.runtime.mesh.main import main


class Event(NamedTuple):
    """A row of the link report."""

    port: int
    frame: int
    seq: int
    fate: int
    rule: int
    delay_s: float


class Link(Node):
    """agent: whose link it is; rules_up, rules_down: what acts on what the agent says, and on what it hears.

    A wire's messages pass through the port of their type, `tracks` to `tracks_out`. A subclass can have more ports:
    handlers that call `carry`.
    """

    role = "link"
    inputs = {"clock": "clock", "pose": "pose", **{wire: wire for wire in WIRES}}
    outputs = {**{f"{wire}_out": wire for wire in WIRES}, "report": "link_report"}
    unopened = WIRES
    prompt = True
    down = ("picture",)  #: ports of what the agent hears; through all others goes what it says

    def __init__(self, agent: str = "", rules_up: tuple[Rule, ...] = (), rules_down: tuple[Rule, ...] = ()) -> None:
        self.agent = agent
        self.rules = {"up": rules_up, "down": rules_down}
        self.chains: dict[tuple[str, str], Chain] = {}
        self.places: LatestBefore[Floats] = LatestBefore()
        self.events: list[Event] = []
        self.clocks: tuple[tuple[int, int], tuple[int, int]] = ((-1, 0), (-1, 0))  # frame and time of the newest two
        self.carried: Counter[str] = Counter()
        self.fates: dict[str, Counter[str]] = {}

    def restamps_s(self, duration_s: float) -> float:
        """See `Node.restamps_s`."""
        return max(sum(rule.restamps_s(duration_s) for rule in rules) for rules in self.rules.values())

    def on_clock(self, received: Received, context: Context) -> None:
        """The step before is over: what was done in it is reported."""
        self.clocks = (self.clocks[1], (received.frame, received.time_ns))
        self.report(context)

    def on_pose(self, received: Received, context: Context) -> None:
        """Where the agent is: it counts from the frame after the one in which it comes."""
        self.places.add(context.frame, received.body["position"])

    def on_tracks(self, received: Received, context: Context) -> None:
        """What the agent sees."""
        self.carry("tracks", received, context)

    def on_status(self, received: Received, context: Context) -> None:
        """What the agent says of itself."""
        self.carry("status", received, context)

    def on_picture(self, received: Received, context: Context) -> None:
        """What the command centre tells the agent."""
        self.carry("picture", received, context)

    def on_detections(self, received: Received, context: Context) -> None:
        """What the agent's sensor detects, where a map puts the link there."""
        self.carry("detections", received, context)

    def on_collated(self, received: Received, context: Context) -> None:
        """What the broker collates, where a map puts the link there."""
        self.carry("collated", received, context)

    def carry(self, port: str, received: Received, context: Context) -> None:
        """Let a message pass as the rules of its wire have it."""
        self.carried[port] += 1
        chain = self.chains.get((port, received.subject)) or self.chain(port, received.subject, context)
        if not chain.rules:
            context.relay(f"{port}_out", received)
            return
        place = self.places.get(context.frame) if chain.needs_position else None
        outcome = chain.carry(
            Passage(
                time_ns=context.time_ns,
                now_ns=context.now_ns,
                size=len(received.encoded) if chain.needs_size else 0,
                position=place[1] if place else None,
                referenced=chain.needs_frame and "origin" in columns_of(received),
            )
        )
        for passage, after_s in outcome.leaving:
            self.send(f"{port}_out", received, passage, after_s, context)
        if outcome.fates:
            self.note(port, received, outcome)

    def chain(self, port: str, subject: str, context: Context) -> Chain:
        """The rules of one wire, which has draws and a memory of its own."""
        rules = self.rules["down" if port in self.down else "up"]
        chain = Chain(rules, lambda *purpose: context.rng("link", port, subject, *purpose))
        self.chains[port, subject] = chain
        return chain

    def send(self, port: str, received: Received, passage: Passage, after_s: float, context: Context) -> None:
        """Let one copy of a message go, with what the rules have changed in it."""
        body, time_ns = None, None
        if passage.skew_ns and columns_of(received):
            time_ns = max(0, received.time_ns + passage.skew_ns)
        if passage.turn or passage.shift != (0.0, 0.0):
            body = displaced(received.body, passage.shift, passage.turn)
        if passage.flips:
            encoded = received.encoded
            if body is not None or time_ns is not None:
                header = received.message.header
                header = header if time_ns is None else header._replace(time_ns=time_ns)
                encoded = codec.encode(codec.conform(header, received.body if body is None else body))
            context.relay(port, received, payload=flipped(encoded, passage.flips), after_s=after_s)
        else:
            context.relay(port, received, body, time_ns=time_ns, after_s=after_s)

    def note(self, port: str, received: Received, outcome: Outcome) -> None:
        """Remember for the report what became of a message; what is malformed is nobody's message."""
        try:
            header = received.message.header
        except MessageError:
            return
        for fate, rule in outcome.fates.items():
            wire = WIRES.index(port) if port in WIRES else WIRES.index(header.schema)
            self.events.append(Event(wire, header.frame, header.seq, FATES.index(fate), rule, outcome.delay_s))

    def report(self, context: Context) -> None:
        """Tell what was done in the step before, delays by less than a frame left out."""
        (before, then_ns), (now, now_ns) = self.clocks
        period_s = (now_ns - then_ns) * 1e-9 / (now - before) if before >= 0 else 0.0
        rows = sorted(
            event for event in self.events if FATES[event.fate] != "delayed" or event.delay_s > period_s - 1e-9
        )
        self.events.clear()
        for event in rows:
            self.fates.setdefault(WIRES[event.port], Counter())[FATES[event.fate]] += 1
        if rows:
            columns = zip(Event._fields, zip(*rows, strict=True), strict=True)
            context.publish("report", {name: np.array(column) for name, column in columns})

    def finish(self, context: Context) -> dict[str, object]:
        """How many messages came on each wire, and what became of them (of those of the last step, nobody knows)."""
        return {"link": {port: {"came": n, **self.fates.get(port, {})} for port, n in sorted(self.carried.items())}}


def columns_of(received: Received) -> Body:
    """The columns of a message; none where they are malformed, which is for its subscribers to find out."""
    try:
        len(received.body)
    except MessageError:
        return {}
    return received.body


if __name__ == "__main__":
    main(Link)
