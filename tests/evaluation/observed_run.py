"""A run in one process that records inputs and outputs of interposers."""

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from mast_zenoh.arrays.geometry import rotation_from_quaternion
from mast_zenoh.errors import MessageError
from mast_zenoh.mesh.host import Host, Outgoing
from mast_zenoh.mesh.inproc import InProcess
from mast_zenoh.messages import codec
from mast_zenoh.messages.schemas import Body, Header, Message
from mast_zenoh.node import Received
from mast_zenoh.wiring.model import InterposedWire

PERIOD_NS = 100_000_000


class Decoded(NamedTuple):
    """Header and columns as a subscriber decodes them; None where it rejects them."""

    header: Header | None
    body: Body | None


class SentCopy(NamedTuple):
    """A sent message: its content, and the frame of the run in which it is sent."""

    content: bytes | Message
    step: int


@dataclass(eq=False)
class Arrival:
    """A message sent to an interposer: passage, content, frame and relayed copies."""

    passage: InterposedWire
    content: bytes | Message
    step: int
    flaw: str
    sent: list[SentCopy] = field(default_factory=list)
    received: Received | None = None


class ObservedRun(InProcess):
    """A run in one process that records inputs and outputs of interposers.

    arrivals:  in order of arrival
    forgeries: messages that interposers published on their own wires, with the passage
    poses:     by agent and frame, position and rotation matrix that the simulator published: a driven car leaves those
               of its prepared scene
    """

    def __init__(self, resolved: Any, **options: Any) -> None:
        self.arrivals: list[Arrival] = []
        self.forgeries: list[tuple[InterposedWire, SentCopy]] = []
        self.poses: dict[tuple[str, int], tuple[np.ndarray, np.ndarray]] = {}
        self._passages_by_key: dict[str, list[InterposedWire]] = {}
        self._pose_of: dict[str, str] = {}
        super().__init__(resolved, **options)
        self.sources = {wire.key: wire.legs[0].publisher.node for wire in self._wiring.wires}
        self._pose_of = {wire.legs[0].key: wire.subject for wire in self._wiring.wires if wire.message == "pose"}
        self.passages = tuple(self._wiring.passages())
        for passage in self.passages:
            self._passages_by_key.setdefault(passage.received, []).append(passage)

    def read(self, passage: InterposedWire, content: bytes | Message, flaw: str = "") -> Decoded:
        """The content of a message as subscribers of a wire decode it."""
        header = None
        try:
            if isinstance(content, Message):
                header = content.header
            else:
                header = codec.decode_header_only(content, passage.message)
            if header.source != self.sources[passage.wire]:
                return Decoded(None, None)
            if isinstance(content, bytes):
                return Decoded(header, codec.decode(content, passage.message).body)
            codec.check_values(content)
            return Decoded(header, None if flaw else content.body)
        except MessageError:
            return Decoded(header, None)

    def _enqueue(self, message: Outgoing) -> None:
        for passage in self._passages_by_key.get(message.key, ()):
            self.arrivals.append(Arrival(passage, message.payload, message.step, message.flaw))
        if (agent := self._pose_of.get(message.key)) is not None and isinstance(message.payload, Message):
            body = message.payload.body
            self.poses.setdefault(
                (agent, message.payload.header.frame), (body["position"], rotation_from_quaternion(body["rotation"]))
            )
        super()._enqueue(message)

    def _build_host(self, name: str) -> Host:
        host = super()._build_host(name)
        passages = [passage for passage in self._wiring.passages() if passage.node == name]
        if passages:
            self._record_calls(host, passages)
        return host

    def _record_calls(self, host: Host, passages: list[InterposedWire]) -> None:
        """Record every call of relay and publish on the context of a node."""
        relay, publish, send_payload = host.relay, host.publish, host._send_payload
        payloads: list[tuple[bytes | Message, float]] = []

        def record_payload(key: str, payload: bytes | Message, flaw: str = "", after_s: float = 0.0) -> None:
            payloads.append((payload, after_s))
            send_payload(key, payload, flaw, after_s)

        def step(received: Received | None) -> int:
            return host.frame if host.clocked else max(host._step, received.step if received else -1)

        def record_relay(port: str, received: Received, *arguments: Any, **options: Any) -> None:
            payloads.clear()
            relay(port, received, *arguments, **options)
            arrival = self._arrival(host.name, received)
            for content, after_s in payloads:
                arrival.sent.append(SentCopy(content, step(received) + round(after_s * 1e9) // PERIOD_NS))

        def record_publish(port: str, *arguments: Any, **options: Any) -> None:
            payloads.clear()
            publish(port, *arguments, **options)
            for passage in passages:
                if host._key(port, passage.subject) == passage.sent:
                    self.forgeries += [(passage, SentCopy(content, step(None))) for content, _ in payloads]

        host.relay, host.publish, host._send_payload = record_relay, record_publish, record_payload  # type: ignore[method-assign]

    def _arrival(self, name: str, received: Received) -> Arrival:
        """The first undelivered arrival whose content equals `received`."""
        content = received.payload if received.payload is not None else received.message
        for arrival in self.arrivals:
            if arrival.passage.node != name or arrival.passage.subject != received.subject:
                continue
            if arrival.received is received:
                return arrival
            same = arrival.content is content
            if not same and arrival.flaw and isinstance(arrival.content, Message):
                same = codec.encode(arrival.content) == content
            if same and arrival.received is None:
                arrival.received = received
                return arrival
        raise AssertionError(f"{name} relays a message that it never received: {received}")
