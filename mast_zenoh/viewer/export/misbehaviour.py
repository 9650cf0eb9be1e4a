"""misbehaviour: what a station would report to its authority about others, as JSON lines.

A report has the content of ETSI TS 103 759 (who, about whom, when, where, which detector, which messages), in plain
names and not in its encoding. Reports are made from the recorded trust messages: a report for each time that a centre,
or an agent's peer, begins to hold another agent for faulty or suspends it.
"""

from __future__ import annotations

import json
import zlib
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mast_zenoh.errors import ExportError, MessageError
from mast_zenoh.integrity import deviations
from mast_zenoh.integrity.base import FAULTY, STATES, SUSPENDED
from mast_zenoh.messagelog.reader import Recorded, read
from mast_zenoh.messages import codec
from mast_zenoh.messages.schemas import Body
from mast_zenoh.v2x.reference_position import LocalPlane
from mast_zenoh.viewer.recorded import RecordedRun
from mast_zenoh.wiring.model import Wire, Wiring, agent_of, part_of

#: Age of the messages that are named as evidence, s, and number of these on each key, at most.
EVIDENCE_S, MOST_EVIDENCE = 1.0, 20
#: Ports whose messages are evidence: what an agent says, and its picture, which is judged by itself.
_CLAIMS = ("tracks", "broadcast", "awareness", "view", "broadcast_view")
_RELAY = "relay"


class Detector(NamedTuple):
    """What a stage has detected.

    reason: beginning of the reason in trust messages
    kind: class of detectors of TS 103 759: 1 a message is implausible in itself, 2 it contradicts earlier ones of its
        sender, 3 the local environment, 4 own sensors, 5 messages of other types or of other stations
    """

    name: str
    reason: str
    kind: int


DETECTORS = (
    Detector("seen_through_by_others", "reports objects that others see through", 5),
    Detector("impossible_object", "reports objects that no road user can be", 1),
    Detector("repeated_object", "reports one object twice", 1),
    *(Detector(f"different_{name}", reason, 5) for name, reason in deviations.REASONS.items()),
    Detector("refuted_claims", "its claims are refuted more often than an honest agent's", 5),
    Detector("disagreement", "not among the agents that agree with ", 5),
    Detector("misfit", "no group with it fits the last believed picture", 3),
    Detector("constant_error", "all its tracks are ", 5),
)


class Observer(NamedTuple):
    """A node that judges agents.

    node: its name; agent: whose peer it is, "": a centre
    evidence: by agent, the keys on which the agent's claims reach it, with the port that published them
    """

    node: str
    agent: str
    evidence: Mapping[str, Mapping[str, str]]


class Observers:
    """The nodes of a wiring that judge agents, by the key of their trust messages."""

    def __init__(self, wiring: Wiring) -> None:
        self.wiring = wiring
        self.of_key = {wire.legs[0].key: self._observer(wire) for wire in wiring.wires if wire.message == "trust"}
        self.subjects = {wire.key: wire.subject for wire in wiring.wires}

    @cached_property
    def stations(self) -> dict[str, str]:
        """By agent, the node that sends its messages to others: its peer, or itself."""
        ports: dict[str, dict[str, str]] = {}
        for wire in self.wiring.wires:
            publisher = wire.legs[0].publisher
            ports.setdefault(wire.subject, {})[publisher.port] = publisher.node
        return {agent: of.get("broadcast", of.get("tracks", agent)) for agent, of in ports.items()}

    def _observer(self, trust: Wire) -> Observer:
        node = trust.legs[0].publisher.node
        # A centre gets tracks and views through its broker.
        nodes = {node} | {
            leg.publisher.node
            for wire in self.wiring.wires
            for leg in wire.every_leg
            if wire.message in ("collated", "views") and node in {end.node for end in leg.subscribers}
        }
        evidence: dict[str, dict[str, str]] = {}
        for wire in self.wiring.wires:
            port = wire.legs[0].publisher.port
            if port in (*_CLAIMS, _RELAY) and wire.subject != trust.subject:
                keys = [leg.key for leg in wire.every_leg if nodes & {end.node for end in leg.subscribers}]
                evidence.setdefault(wire.subject, {}).update(dict.fromkeys(keys, port))
        return Observer(node, trust.subject, evidence)


class _Claim(NamedTuple):
    """The header of a message. step: frame in which it was sent"""

    step: int
    frame: int
    time_ns: int
    seq: int


def write(run: RecordedRun, path: Path) -> None:
    """Write a line for each report, in the order of time.

    Raises ExportError if no node of the run judges agents.
    """
    observers = [(frame, Observers(wiring)) for frame, wiring in run.wirings]
    if not any(each.of_key for _, each in observers):
        raise ExportError(
            f"{run.path}: found no node that judges agents, expected a command centre or a peer with an integrity "
            "stage: repeat the run with one, such as --set defence=FaultOrLie of the scenario peers"
        )
    with path.open("w", encoding="utf-8") as file:
        for report in _Reading(run, observers).reports():
            file.write(json.dumps(report) + "\n")


class _Reading:
    """Reads a recording once, and remembers what reports need."""

    def __init__(self, run: RecordedRun, observers: Sequence[tuple[int, Observers]]) -> None:
        self.run, self.observers = run, observers
        self.plane = LocalPlane(origin=(run.origin[0], run.origin[1]))
        self.claims: dict[str, deque[_Claim]] = {}  # by key
        self.places: dict[str, list[float]] = {}  # (3) m, by agent
        self.lost: dict[int, dict[str, Mapping[str, set[str]]]] = {}  # by frame and agent, who was not heard, by port
        self.states: dict[tuple[str, str], int] = {}  # of agents, by (observer, agent)
        self.refused = 0

    def reports(self) -> Iterator[dict[str, Any]]:
        """All reports."""
        keys = {key for _, each in self.observers for of in each.of_key.values() for key in _keys_of(of)}
        channels = any(wire.message == "reception" for _, each in self.observers for wire in each.wiring.wires)
        for message in read(self.run.path):
            step = message.step if message.step >= 0 else message.frame
            observers = next(each for frame, each in reversed(self.observers) if frame < step or frame < 0)
            if message.key in keys:
                claim = _Claim(step, message.frame, message.time_ns, message.seq)
                self.claims.setdefault(message.key, deque(maxlen=MOST_EVIDENCE)).append(claim)
            try:
                if message.message == "trust" and (observer := observers.of_key.get(message.key)):
                    yield from self.judged(message, _body(message), observer, observers, channels)
                elif message.message == "pose" and not message.tap:
                    subject = observers.subjects.get(message.wire, "")
                    self.places[subject] = _body(message)["position"].tolist()
                elif message.message == "reception":
                    self.receive(message, observers.subjects.get(message.wire, ""))
            except MessageError:
                self.refused += 1
        if self.refused:
            self.run.note(f"messages.mcap: invalid messages, which receivers refuse, are left out: {self.refused}")

    def receive(self, message: Recorded, agent: str) -> None:
        """Note what did not arrive at an agent, of what was sent in the frame before."""
        body = _body(message)
        tracks, awareness = (set(body[name].tolist()) for name in ("lost", "lost_awareness"))
        lost = {"broadcast": tracks, "broadcast_view": tracks, _RELAY: tracks, "awareness": awareness}
        self.lost.setdefault(message.frame - 1, {})[agent] = lost
        while len(self.lost) > 2 * MOST_EVIDENCE:
            del self.lost[min(self.lost)]

    def judged(
        self, message: Recorded, body: Body, observer: Observer, observers: Observers, channels: bool
    ) -> Iterator[dict[str, Any]]:
        """The reports that a trust message gives rise to. channels: whether messages may be lost on a channel"""
        columns = (body[name].tolist() for name in ("agents", "state", "reason", "log_odds", "mean"))
        for subject, state, reason, log_odds, mean in zip(*columns, strict=True):
            agent, relayed = agent_of(subject), part_of(subject) == _RELAY
            before = self.states.get((observer.node, subject), 0)
            self.states[observer.node, subject] = state
            if state not in (FAULTY, SUSPENDED) or state == before or agent == observer.agent:
                continue
            detector = next((each for each in DETECTORS if reason.startswith(each.reason)), None)
            yield {
                "reporter": observer.node,
                "reporter_station_id": zlib.crc32(observer.node.encode()),
                "reported": agent,
                "reported_station_id": zlib.crc32(observers.stations.get(agent, agent).encode()),
                "relayed": relayed,
                "frame": message.frame,
                "generation_time_us": message.time_ns // 1000,
                "observation_location": self.location(observer.agent),
                "state": STATES[state],
                "state_before": STATES[before],
                "detector": None if detector is None else detector.name,
                "detector_class": None if detector is None else detector.kind,
                "reason": reason,
                "confidence": float(1.0 / (1.0 + np.exp(np.clip(log_odds, -500.0, 500.0)))),
                "trust": mean,
                "evidence": list(self.evidence(message, agent, relayed, observer, channels)),
            }

    def location(self, agent: str) -> dict[str, float] | None:
        """Where an agent is; None: not known, or a centre."""
        if agent not in self.places:
            return None
        place = self.places[agent]
        position = self.plane.to_position(np.array(place))
        metres = dict(zip(("x_m", "y_m", "z_m"), place, strict=True))
        return metres | {"latitude": position.latitude / 1e7, "longitude": position.longitude / 1e7}

    def evidence(
        self, trust: Recorded, agent: str, relayed: bool, observer: Observer, channels: bool
    ) -> Iterator[dict[str, Any]]:
        """The newest messages of an agent that an observer had when it judged it, by key.

        relayed: whether it judged what the agent relays
        """
        for key, port in sorted(observer.evidence.get(agent, {}).items()):
            if (port == _RELAY) != relayed:
                continue
            for claim in self.claims.get(key, ()):
                # A peer uses what it hears from the next frame on.
                known = claim.step < trust.frame if observer.agent else claim.step <= trust.frame
                if not known or not 0 <= trust.time_ns - claim.time_ns <= EVIDENCE_S * 1e9:
                    continue
                if channels and observer.agent:
                    lost = self.lost.get(claim.step, {}).get(observer.agent)
                    if lost is None or agent in lost.get(port, ()):
                        continue
                yield {"key": key, "frame": claim.frame, "seq": claim.seq}


def _keys_of(observer: Observer) -> Iterator[str]:
    for keys in observer.evidence.values():
        yield from keys


def _body(message: Recorded) -> Body:
    """The columns of a message of a built-in type. Raises MessageError."""
    if message.malformed:
        raise MessageError(f"{message.key}: found a malformed message, expected one of type {message.message}")
    return codec.decode(message.payload, message.message).body
