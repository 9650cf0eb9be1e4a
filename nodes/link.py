"""A link: an agent's imperfect connection to the network.

A map inserts it on wires, such as keyexpr_maps/network.toml, network_centers.toml and network_peers.toml. The rules
act on every message in order: they forward, delay, drop, duplicate or change it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from mast_zenoh.arrays.geometry import rotation_from_quaternion
from mast_zenoh.arrays.states import Detections
from mast_zenoh.errors import MessageError
from mast_zenoh.gather import LatestBefore
from mast_zenoh.links import (
    FATES,
    Chain,
    Passage,
    PassageOutcome,
    Rule,
    SenderPose,
    Sensed,
    displaced,
    flipped,
    has_frame,
    type_number,
)
from mast_zenoh.mesh.hosting import main
from mast_zenoh.messages import codec
from mast_zenoh.messages.schemas import Body
from mast_zenoh.node import Context, Node, Received
from mast_zenoh.wiring.model import ANY, DOWN, agent_of, part_of, wire_key


class ReportRow(NamedTuple):
    """A row of the link report."""

    port: int
    frame: int
    seq: int
    fate: int
    rule: int
    delay_s: float


class Link(Node):
    """Applies the rules of an agent's link.

    agent: the agent of the link; rules_up: rules for messages from the agent
    rules_down: rules for messages to the agent
    rules_sensor: rules for the agent's detections, where a map inserts the link there; None: `rules_up`
    rules_of_sensors: by name, those for the detections of further sensors; for the others, `rules_sensor`
    peer: the agent's peer, before which the link is on what it hears; empty: none

    It takes what a map leads to it, on any port, and sends it on by that port's name with `_out`.
    """

    role = "link"
    inputs = {"clock": "clock", "pose": "pose"}
    outputs = {"report": "link_report"}
    forwards = unopened = (ANY,)
    prompt = True

    def __init__(
        self,
        agent: str = "",
        rules_up: tuple[Rule, ...] = (),
        rules_down: tuple[Rule, ...] = (),
        rules_sensor: tuple[Rule, ...] | None = None,
        rules_of_sensors: Mapping[str, tuple[Rule, ...]] | None = None,
        peer: str = "",
    ) -> None:
        self.agent = agent
        self.peer = peer
        self.rules = {"up": rules_up, "down": rules_down, "sensor": rules_up if rules_sensor is None else rules_sensor}
        self.rules |= {f"sensor/{name}": rules for name, rules in (rules_of_sensors or {}).items()}
        self.chains: dict[tuple[str, str], tuple[Chain, bool]] = {}  # of a wire, and whether it leads to the agent
        self.poses: LatestBefore[SenderPose] = LatestBefore()
        self.newest_pose: SenderPose | None = None
        self.events: list[tuple[ReportRow, str]] = []  # with its port
        self.clocks: tuple[tuple[int, int], tuple[int, int]] = ((-1, 0), (-1, 0))  # frame and time of the latest two
        self.carried: Counter[str] = Counter()
        self.fates: dict[str, Counter[str]] = {}

    def restamps_s(self, duration_s: float) -> float:
        """The largest shift of message times by the rules of one wire, s."""
        return max(sum(rule.restamps_s(duration_s) for rule in rules) for rules in self.rules.values())

    def on_clock(self, received: Received, context: Context) -> None:
        """Report what was done in the previous step."""
        self.clocks = (self.clocks[1], (received.frame, received.time_ns))
        self.report(context)

    def on_pose(self, received: Received, context: Context) -> None:
        """Store the agent's pose, which takes effect from the frame after its arrival."""
        body = received.body
        pose = SenderPose.after(
            self.newest_pose, received.time_ns, body["position"], body["rotation"], body["velocity"]
        )
        self.newest_pose = pose
        self.poses.add(context.frame, pose)

    def on_message(self, received: Received, context: Context) -> None:
        """Apply the rules of its wire to a message."""
        port = received.port
        self.carried[port] += 1
        chain, down = self.chains.get((port, received.subject)) or self.chain(port, received.subject, context)
        if not chain.rules:
            context.relay(f"{port}_out", received)
            return
        known = self.poses.get(context.frame) if chain.needs_position else None
        pose = known[1] if known else None
        sensed = sensed_of(received, pose) if chain.needs_detections else None
        outcome = chain.carry(
            Passage(
                time_ns=context.time_ns,
                now_ns=context.now_ns,
                size=len(received.encoded) if chain.needs_size else 0,
                position=pose.position if pose else None,
                referenced=chain.needs_frame and not down and has_frame(columns_of(received)),
                sensed=sensed,
            )
        )
        for passage, after_s in outcome.leaving:
            self.send(f"{port}_out", received, passage, after_s, context, sensed)
        if outcome.fates:
            self.note(port, received, outcome)

    def chain(self, port: str, subject: str, context: Context) -> tuple[Chain, bool]:
        """The rules of one wire, which has its own random draws and memory; and whether it leads to the agent."""
        ports = {wire_key(key): each.port for key, each in context.subscriptions.items()}
        inputs = context.subscriptions.values()
        traits = next(each.traits for each in inputs if (each.port, each.subject) == (port, subject))
        of_another = bool(self.agent) and agent_of(subject) not in ("", self.agent)
        down = traits.direction == DOWN or of_another
        direction = DOWN if down else traits.direction
        rules = self.rules.get(f"{direction}/{part_of(subject)}", self.rules[direction])
        of_sender = set() if down else {type(rule).__name__ for rule in rules if rule.of_sender}

        def rng(kind: str, *more: int) -> np.random.Generator:
            return context.rng("link", ports.get(traits.of, port) if kind in of_sender else port, subject, kind, *more)

        self.chains[port, subject] = Chain(rules, rng), down
        return self.chains[port, subject]

    def send(
        self, port: str, received: Received, passage: Passage, after_s: float, context: Context, sensed: Sensed | None
    ) -> None:
        """Forward one copy of a message, with the changes of the rules.

        sensed: its detections as received; None: not needed
        """
        body, time_ns = None, None
        if passage.skew_ns and columns_of(received):
            time_ns = max(0, received.time_ns + passage.skew_ns)
        if passage.turn or passage.shift != (0.0, 0.0):
            body = displaced(received.body, passage.shift, passage.turn, passage.position)
        if passage.sensed is not None and passage.sensed is not sensed:
            body = {**received.body, **passage.sensed.detections.columns()}
        if passage.flips:
            encoded = received.encoded
            if body is not None or time_ns is not None:
                header = received.message.header
                header = header if time_ns is None else header._replace(time_ns=time_ns)
                encoded = codec.encode(codec.conform(header, received.body if body is None else body))
            context.relay(port, received, payload=flipped(encoded, passage.flips), after_s=after_s)
        else:
            context.relay(port, received, body, time_ns=time_ns, after_s=after_s)

    def note(self, port: str, received: Received, outcome: PassageOutcome) -> None:
        """Note the fate of a message for the report; malformed messages are not reported."""
        try:
            header = received.message.header
        except MessageError:
            return
        for fate, rule in outcome.fates.items():
            kind = type_number(header.schema)
            event = ReportRow(kind, header.frame, header.seq, FATES.index(fate), rule, outcome.delay_s)
            self.events.append((event, port))

    def report(self, context: Context) -> None:
        """Report what was done in the previous step, except delays by less than a frame."""
        (previous, previous_ns), (now, now_ns) = self.clocks
        period_s = (now_ns - previous_ns) * 1e-9 / (now - previous) if previous >= 0 else 0.0
        rows = sorted(
            (event, port)
            for event, port in self.events
            if FATES[event.fate] != "delayed" or event.delay_s > period_s - 1e-9
        )
        self.events.clear()
        for event, port in rows:
            self.fates.setdefault(port, Counter())[FATES[event.fate]] += 1
        if rows:
            columns = zip(ReportRow._fields, zip(*(event for event, _ in rows), strict=True), strict=True)
            context.publish("report", {name: np.array(column) for name, column in columns})

    def finish(self, context: Context) -> dict[str, object]:
        """Numbers of messages on each wire, and their fates before the last step."""
        return {"link": {port: {"came": n, **self.fates.get(port, {})} for port, n in sorted(self.carried.items())}}


def columns_of(received: Received) -> Body:
    """The columns of a message; {} if malformed, which subscribers report."""
    try:
        len(received.body)
    except MessageError:
        return {}
    return received.body


def sensed_of(received: Received, pose: SenderPose | None) -> Sensed | None:
    """The detections in a message; None if there are none, or the message is malformed.

    pose: of the agent in an earlier frame; None: unknown
    """
    body = columns_of(received)
    if "mount_rotation" not in body:
        return None
    mount = rotation_from_quaternion(body["mount_rotation"])
    return Sensed(Detections.from_columns(body), body["mount_position"], mount, pose)


if __name__ == "__main__":
    main(Link)
