"""A hosted node's `Context`: numbers, delays, counts and sends its messages."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable, Collection, Mapping
from typing import NamedTuple

import numpy as np

from mast_zenoh.errors import ConfigurationError, MessageError, nearest
from mast_zenoh.messages import codec
from mast_zenoh.messages.row_limits import NO_LIMITS
from mast_zenoh.messages.schemas import Body, Header, Message
from mast_zenoh.node import Node, Received
from mast_zenoh.runtime.delayed import Delayed
from mast_zenoh.runtime.limits import DELAYED, Room
from mast_zenoh.streams import stream
from mast_zenoh.wiring.model import Input, Ports, Wiring

MAX_DELAY_S = 3600.0  #: longest delay of a message
_FOREVER = 1 << 62  # ns, or steps
_MAX_REASON = 200  # characters kept of the reason of a rejection


class Outgoing(NamedTuple):
    """An outgoing message: its key, its content, and the step in which it is sent.

    payload: bytes on a mesh; in one process the message itself
    flaw: why a receiver would reject it; empty: it is valid
    """

    key: str
    payload: bytes | Message
    step: int
    flaw: str = ""


class _DelayedMessage(NamedTuple):
    """A message to send later, and the room it takes up, bytes, for a source."""

    out: Outgoing
    source: str
    size: int


class NodeContext:
    """The publishing half of a node's host, which is also the node's `Context`.

    period_ns: interval of the scene's frames, ns: the unit of delays in lock-step
    wiring: of the whole run, for nodes that observe wires
    now:  a monotonic clock, ns, for real time; None: time advances with frames, as in lock-step
    emit: called immediately with every message that the node publishes
    limits: of the run on the rows of messages; the runtime sets them
    frame, time_ns: of the newest clock;  sent: number of messages by key
    rejected: number of rejected messages by (key, kind)
    first_rejected: frame and reason of the first rejection, by key
    """

    def __init__(
        self,
        name: str,
        node: Node,
        ports: Ports,
        seed: int,
        *,
        encode: bool,
        emit: Callable[[Outgoing], None],
        period_ns: int,
        now: Callable[[], int] | None,
        wiring: Wiring,
    ) -> None:
        self.name = name
        self.node = node
        self.seed = seed
        self.wiring = wiring
        self.limits = NO_LIMITS
        self._publishers: dict[str, str] | None = None  # by key; built on first use
        self.frame = -1
        self.time_ns = 0
        self.log = logging.getLogger(f"mast.{name}")
        self._inputs = dict(ports.inputs)
        self.subscriptions: Mapping[str, Input] = self._inputs
        self.sent: Counter[str] = Counter()
        self.rejected: Counter[tuple[str, str]] = Counter()
        self.first_rejected: dict[str, tuple[int, str]] = {}
        self._emit = emit
        self._encode = encode
        self._outputs = ports.outputs
        self._keys_of_port: dict[str, list[str]] = {}
        for (port, _), key in ports.outputs.items():
            self._keys_of_port.setdefault(port, []).append(key)
        self._seq: Counter[str] = Counter()
        self._ignored: frozenset[str] = frozenset()
        self._clocked = any(each.message == "clock" for each in ports.inputs.values())
        self._period_ns = period_ns
        self._now = now
        self._step = -1  # of messages sent now
        self._started_ns: int | None = None  # when the first clock was received
        self._handler_time_ns = 0  # when the running handler was called; constant within it, to keep messages in order
        self._delayed: Delayed[_DelayedMessage] = Delayed()
        self._delayed_room = Room(DELAYED)
        self._handling = ""  # key of the message being handled

    # -- documented in node.Context ------------------------------------------------------------------------------

    def publish(
        self, port: str, body: Body, *, subject: str | None = None, frame: int | None = None, time_ns: int | None = None
    ) -> None:
        schema = self._output(port)
        key = self._key(port, subject)
        header_frame = self.frame if frame is None else frame
        header_time = self.time_ns if time_ns is None else time_ns
        if schema == "clock":
            self.frame, self.time_ns, self._step = header_frame, header_time, header_frame
        if key is None:
            return
        if frame is None and header_frame < 0:
            problem = f"{self.name}: {port}: published before the first clock"
            raise ConfigurationError(f"{problem}; a node that publishes needs an input of type clock")
        header = Header(schema, self.name, header_frame, header_time, self._seq[key])
        message = codec.conform(header, body)
        self._seq[key] += 1
        self._send_message(key, message)

    @property
    def now_ns(self) -> int:
        if self._now is None:
            return self.time_ns
        return 0 if self._started_ns is None else self._handler_time_ns - self._started_ns

    def relay(
        self,
        port: str,
        received: Received,
        body: Body | None = None,
        *,
        payload: bytes | None = None,
        time_ns: int | None = None,
        after_s: float = 0.0,
    ) -> None:
        schema = self._output(port)
        if schema != received.schema:
            raise ConfigurationError(f"{self.name}: port {port!r} carries {schema!r} messages, not {received.schema!r}")
        if payload is not None and (body is not None or time_ns is not None):
            raise ConfigurationError(
                f"{self.name}: port {port!r}: a payload is sent unchanged: expected no body or time_ns"
            )
        key = self._outputs.get((port, received.subject))
        if key is None:
            return
        if payload is not None:
            self._send_payload(key, payload, after_s=after_s)
        elif body is not None or time_ns is not None:
            header = received.message.header
            header = header if time_ns is None else header._replace(time_ns=time_ns)
            message = Message(header, received.body) if body is None else codec.conform(header, body)
            self._send_message(key, message, after_s)
        else:
            self._send_payload(
                key, received.encoded if self._encode else received.payload or received.message, after_s=after_s
            )

    def ignore(self, keys: Collection[str]) -> None:
        self._ignored = frozenset(keys)

    def reject(self, reason: str) -> None:
        self._count_rejected(self._handling, reason)

    def connected(self, port: str, subject: str | None = None) -> bool:
        self._output(port)
        return bool(self._keys_of_port.get(port)) if subject is None else self._key(port, subject) is not None

    def rng(self, *purpose: str | int) -> np.random.Generator:
        return stream(self.seed, self.name, *purpose)

    # -- called by the runtime -----------------------------------------------------------------------------------

    def release(self) -> float | None:
        """Send messages that are due; returns the seconds until the next, None for none.

        For real time: in lock-step the clock sends them.
        """
        if self._now is None or not self._delayed:
            return None
        self._send_due(self._now())
        due = self._delayed.due
        return None if due is None else max(0.0, (due - self._now()) * 1e-9)

    def publisher(self, key: str) -> str:
        """The node that publishes on a key; behind an interposer, the interposer."""
        if self._publishers is None:
            self._publishers = {leg.key: leg.publisher.node for _, leg in self.wiring.legs()}
        return self._publishers.get(key) or (self._inputs[key].source if key in self._inputs else key)

    def flush(self) -> None:
        """Send all delayed messages immediately, in the order in which they are due."""
        if self._delayed:
            self._send_due(_FOREVER)

    # -- inside --------------------------------------------------------------------------------------------------

    def _output(self, port: str) -> str:
        if port not in self.node.outputs:
            raise ConfigurationError(f"{self.name}: no output port {port!r}{nearest(port, self.node.outputs)}")
        message: str = self.node.outputs[port]
        return message

    def _key(self, port: str, subject: str | None) -> str | None:
        if subject is not None:
            return self._outputs.get((port, subject))
        keys = self._keys_of_port.get(port, [])
        if len(keys) > 1:
            raise ConfigurationError(f"{self.name}: port {port!r} has {len(keys)} wires: choose one with subject=…")
        return keys[0] if keys else None

    def _send_message(self, key: str, message: Message, after_s: float = 0.0) -> None:
        if self._encode:
            self._send_payload(key, codec.encode(message), after_s=after_s)
            return
        flaw = ""
        try:
            codec.check_values(message, self.limits)
        except MessageError as error:
            flaw = str(error)
        self._send_payload(key, message, flaw, after_s)

    def _send_payload(self, key: str, payload: bytes | Message, flaw: str = "", after_s: float = 0.0) -> None:
        """Send a payload, or keep it until it is due."""
        out = Outgoing(key, payload, self._step, flaw)
        if after_s == 0.0 and (self._now is None or not self._delayed):
            self._emit(out)
            self.sent[key] += 1
            return
        if not 0.0 <= after_s <= MAX_DELAY_S:
            raise ConfigurationError(f"{self.name}: after_s: found {after_s}, expected 0 to {MAX_DELAY_S:.0f}")
        if not self._clocked:
            raise ConfigurationError(
                f"{self.name}: after_s: a node that does not receive the clock cannot delay a message"
            )
        delay_ns = round(after_s * 1e9)
        if self._now is not None:
            due = self._handler_time_ns + delay_ns
            self._delay(due, due, out)
            self._send_due(self._handler_time_ns)  # earlier messages leave first
        elif delay_ns < self._period_ns:
            self._emit(out)
            self.sent[key] += 1
        else:
            self._delay(self._step + delay_ns // self._period_ns, self.time_ns + delay_ns, out)

    def _delay(self, due: int, rank: int, out: Outgoing) -> None:
        """Keep a message until it is due, in the room of the handled message's source."""
        source_key, payload = self._handling or out.key, out.payload
        source = self.publisher(source_key)
        # The encoded size also in one process, so that both drop the same messages.
        size = len(payload if isinstance(payload, bytes) else codec.encode(payload))
        if self._delayed_room.take(source, size):
            self._delayed.push(due, rank, _DelayedMessage(out, source, size))
        else:
            self._count_rejected(source_key, f"delayed: more than {self._delayed_room.limit} of {source} are delayed")

    def _send_due(self, now: int) -> None:
        """Send messages due at `now`, a step in lock-step, else ns; in the current step."""
        for out, source, size in self._delayed.pop(now):
            self._delayed_room.free(source, size)
            self._emit(out._replace(step=self._step))
            self.sent[out.key] += 1

    def _count_rejected(self, key: str, reason: str, count: int = 1) -> None:
        """Count rejected messages by key and kind, the reason's part before the colon."""
        if key not in self.first_rejected:
            self.first_rejected[key] = self.frame, " ".join(reason.split())[:_MAX_REASON]
            self.log.warning("rejected a message on %s: %s (more on this key will only be counted)", key, reason)
        self.rejected[key, reason.split(":", 1)[0]] += count
