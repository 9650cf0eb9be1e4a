"""What a node is handed to act with: its `node.Context`, which numbers, delays, counts and sends what it publishes."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable, Collection, Mapping
from typing import NamedTuple

import numpy as np

from mast_zenoh.errors import ConfigurationError, MessageError, nearest
from mast_zenoh.messages import codec
from mast_zenoh.messages.schemas import Body, Header, Message
from mast_zenoh.node import Node, Received
from mast_zenoh.runtime.delayed import Delayed
from mast_zenoh.runtime.limits import DELAYED, Room
from mast_zenoh.streams import stream
from mast_zenoh.wiring.model import Input, Ports, Wiring

MAX_DELAY_S = 3600.0  #: no message leaves later than that
_FOREVER = 1 << 62  # ns, or steps
_MAX_REASON = 200  # characters kept of why a message was rejected


class Outgoing(NamedTuple):
    """A message on its way out: its key, its content, and the step it is sent in.

    `payload` is bytes on a mesh; in one process the message itself. `flaw` says why a receiver would refuse it.
    """

    key: str
    payload: bytes | Message
    step: int
    flaw: str = ""


class _Kept(NamedTuple):
    """A message that leaves later, and what it takes up of the room of a source, bytes."""

    out: Outgoing
    source: str
    size: int


class NodeContext:
    """The publishing half of a node's host, which is also its context.

    period_ns: of the scene's frames: in lock-step a delay is counted in them
    wiring: of the whole run, for nodes that measure what happens on it
    now:  a monotonic clock, ns, for real time; without it time goes by frames, as in lock-step
    emit: called at once with every message that the node publishes
    frame, time_ns: of the newest clock;  sent: messages by key
    rejected: messages by (key, kind) that were not taken; first_rejected: by key the frame in which one was rejected
    first, and why
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
        self._publishers: dict[str, str] | None = None  # by key; made when it is asked for first
        self.frame = -1
        self.time_ns = 0
        self.log = logging.getLogger(f"mast.{name}")
        self._hears = dict(ports.inputs)
        self.hears: Mapping[str, Input] = self._hears
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
        self._clocked = any(hears.message == "clock" for hears in ports.inputs.values())
        self._period_ns = period_ns
        self._now = now
        self._step = -1  # that what is sent now is sent in
        self._began_ns: int | None = None  # when the first clock came
        self._moment_ns = 0  # when the handler that runs was called: for it no time goes by, so that nothing overtakes
        self._delayed: Delayed[_Kept] = Delayed()
        self._delayed_room = Room(DELAYED)
        self._handling = ""  # key of the message whose handler runs

    def publish(
        self, port: str, body: Body, *, subject: str | None = None, frame: int | None = None, time_ns: int | None = None
    ) -> None:
        """See node.Context."""
        schema = self._output(port)
        key = self._key(port, subject)
        header_frame = self.frame if frame is None else frame
        header_time = self.time_ns if time_ns is None else time_ns
        if schema == "clock":
            self.frame, self.time_ns, self._step = header_frame, header_time, header_frame
        if key is None:
            return
        header = Header(schema, self.name, header_frame, header_time, self._seq[key])
        message = codec.conform(header, body)
        self._seq[key] += 1
        self._send(key, message)

    @property
    def now_ns(self) -> int:
        """See node.Context."""
        if self._now is None:
            return self.time_ns
        return 0 if self._began_ns is None else self._moment_ns - self._began_ns

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
        """See node.Context."""
        schema = self._output(port)
        if schema != received.schema:
            raise ConfigurationError(f"{self.name}: port {port!r} carries {schema!r} messages, not {received.schema!r}")
        if payload is not None and (body is not None or time_ns is not None):
            raise ConfigurationError(
                f"{self.name}: port {port!r}: a payload is sent as it is: no body or time_ns with it"
            )
        key = self._outputs.get((port, received.subject))
        if key is None:
            return
        if payload is not None:
            self._out(key, payload, after_s=after_s)
        elif body is not None or time_ns is not None:
            header = received.message.header
            header = header if time_ns is None else header._replace(time_ns=time_ns)
            message = Message(header, received.body) if body is None else codec.conform(header, body)
            self._send(key, message, after_s)
        else:
            self._out(key, received.encoded if self._encode else received.payload or received.message, after_s=after_s)

    def ignore(self, keys: Collection[str]) -> None:
        """See node.Context."""
        self._ignored = frozenset(keys)

    def reject(self, reason: str) -> None:
        """See node.Context."""
        self._count_rejected(self._handling, reason)

    def connected(self, port: str, subject: str | None = None) -> bool:
        """See node.Context."""
        self._output(port)
        return bool(self._keys_of_port.get(port)) if subject is None else self._key(port, subject) is not None

    def rng(self, *purpose: str | int) -> np.random.Generator:
        """See node.Context."""
        return stream(self.seed, self.name, *purpose)

    # -- what the runtime calls ----------------------------------------------------------------------------------

    def release(self) -> float | None:
        """In real time: let go what is due by now. How long it is until the next will be, s; None: nothing waits."""
        if self._now is None or not self._delayed:
            return None
        self._let_go(self._now())
        due = self._delayed.due
        return None if due is None else max(0.0, (due - self._now()) * 1e-9)

    def publisher(self, key: str) -> str:
        """The node that publishes on a key: the interposer on what it has passed on."""
        if self._publishers is None:
            self._publishers = {leg.key: leg.publisher.node for _, leg in self.wiring.legs()}
        return self._publishers.get(key) or (self._hears[key].source if key in self._hears else key)

    def flush(self) -> None:
        """Let go at once what was to leave later, in the order in which it would have left."""
        if self._delayed:
            self._let_go(_FOREVER)

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
            raise ConfigurationError(f"{self.name}: port {port!r} has {len(keys)} wires: say which by subject=…")
        return keys[0] if keys else None

    def _send(self, key: str, message: Message, after_s: float = 0.0) -> None:
        if self._encode:
            self._out(key, codec.encode(message), after_s=after_s)
            return
        flaw = ""
        try:
            codec.check_values(message)
        except MessageError as error:
            flaw = str(error)
        self._out(key, message, flaw, after_s)

    def _out(self, key: str, payload: bytes | Message, flaw: str = "", after_s: float = 0.0) -> None:
        """Send a message, or keep it until it is due."""
        out = Outgoing(key, payload, self._step, flaw)
        if after_s == 0.0 and (self._now is None or not self._delayed):
            self._emit(out)
            self.sent[key] += 1
            return
        if not 0.0 <= after_s <= MAX_DELAY_S:
            raise ConfigurationError(f"{self.name}: after_s: found {after_s}, expected 0 to {MAX_DELAY_S:.0f}")
        if not self._clocked:
            raise ConfigurationError(
                f"{self.name}: after_s: a node that does not hear the clock cannot delay a message"
            )
        delay_ns = round(after_s * 1e9)
        if self._now is not None:
            due = self._moment_ns + delay_ns
            self._delay(due, due, out)
            self._let_go(self._moment_ns)  # what was due before this one leaves before it
        elif delay_ns < self._period_ns:
            self._emit(out)
            self.sent[key] += 1
        else:
            self._delay(self._step + delay_ns // self._period_ns, self.time_ns + delay_ns, out)

    def _delay(self, due: int, rank: int, out: Outgoing) -> None:
        """Keep a message until it is due, in the room of the source whose message is being handled."""
        came, payload = self._handling or out.key, out.payload
        source = self.publisher(came)
        # In one process it takes up what its bytes would on a mesh, so that both drop the same.
        size = len(payload if isinstance(payload, bytes) else codec.encode(payload))
        if self._delayed_room.take(source, size):
            self._delayed.push(due, rank, _Kept(out, source, size))
        else:
            self._count_rejected(came, f"delayed: more than {self._delayed_room.limit} of {source} are to leave later")

    def _let_go(self, now: int) -> None:
        """Send what is due by now (a step in lock-step, else ns), in the step in which it leaves."""
        for out, source, size in self._delayed.pop(now):
            self._delayed_room.free(source, size)
            self._emit(out._replace(step=self._step))
            self.sent[out.key] += 1

    def _count_rejected(self, key: str, reason: str, count: int = 1) -> None:
        """Count messages that were not taken, by key and by what precedes the colon of the reason."""
        if key not in self.first_rejected:
            self.first_rejected[key] = self.frame, " ".join(reason.split())[:_MAX_REASON]
            self.log.warning("rejected a message on %s: %s (further ones on this key are only counted)", key, reason)
        self.rejected[key, reason.split(":", 1)[0]] += count
