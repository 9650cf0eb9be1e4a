"""Hosts one node, without I/O: messages in, messages out. Both runtimes use this.

The host decodes and checks received messages, holds each until it has received the clock of the step in which the
message was sent, calls the node's handlers, and numbers, delays and sends the node's messages. It counts messages sent
and handled by key (lock-step waits until these balance), and rejected ones.
"""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from typing import Any, NamedTuple, Protocol

import numpy as np

from mast_zenoh.config.resolved import Resolved
from mast_zenoh.errors import ConfigurationError, MessageError, nearest
from mast_zenoh.mesh.control import results
from mast_zenoh.mesh.control.failures import Failure
from mast_zenoh.mesh.control.results import PartedTables
from mast_zenoh.mesh.waiting import DELAYED, HELD, WaitingItems
from mast_zenoh.messages import codec
from mast_zenoh.messages.limits import NO_LIMITS, RowLimits, Shortened, Timespan, excess
from mast_zenoh.messages.packed import Packed, check_codec, check_kernels, pack
from mast_zenoh.messages.schemas import Body, Header, Message
from mast_zenoh.node import Node, Outside, Overheard, Received, Source, Unopened, handler_of
from mast_zenoh.streams import stream
from mast_zenoh.v2x.reference_position import WORLD_PLANE, LocalPlane
from mast_zenoh.wiring.model import ANY, NO_WIRING, Input, Ports, Wiring

MAX_DELAY_S = 3600.0  #: longest delay of a message
_FOREVER = 1 << 62  # ns, or steps
_MAX_REASON = 200  # characters kept of the reason of a rejection


class OpenedOutside(Outside, Protocol):
    """A node's link to programs outside the run, as the runtime opens it."""

    def note_clock(self, frame: int) -> None:
        """Note that the clock of a frame has arrived now."""

    def end(self) -> None:
        """Wait for nothing any more; from any thread, or a signal handler."""

    def close(self) -> None:
        """End the link."""


class Outgoing(NamedTuple):
    """An outgoing message: its key, its content, and the step in which it is sent.

    payload: bytes on a mesh; in one process the message itself
    flaw: why a receiver would reject it; empty: it is valid
    """

    key: str
    payload: bytes | Message
    step: int
    flaw: str = ""


class Host:
    """One node with its ports connected; also the node's `Context`.

    encode: whether messages are passed on as bytes, as on a mesh
    emit: called immediately with every message that the node publishes
    period_ns: interval of the scene's frames, ns: the unit of delays in lock-step
    now:  a monotonic clock, ns, for real time; None: time advances with frames, as in lock-step
    wiring: of the whole run, for nodes that observe wires
    timespan: valid frames and times of messages; None: any;  plane: of the stations of the run, for standard messages
    limits: of the run on the rows of messages
    observe: called with the key and header of every valid message
    on_failure: called with every failure of a handler, after it has been counted
    tables: rows that the node has appended; the runtime sets `hand_in`
    clocked: whether it receives the clock;  frame, time_ns: of the newest
    sent, handled: number of messages by key; failures: by handler
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
        period_ns: int = Source.period_ns,
        now: Callable[[], int] | None = None,
        wiring: Wiring = NO_WIRING,
        timespan: Timespan | None = None,
        plane: LocalPlane = WORLD_PLANE,
    ) -> None:
        check_kernels(ports.codecs, name)
        self.name = name
        self.node = node
        self.seed = seed
        self.wiring = wiring
        self.limits = NO_LIMITS
        self.observe: Callable[[str, Header], None] | None = None
        self.tables = PartedTables()
        self.on_failure: Callable[[Failure], None] = lambda failure: None
        self.frame = -1
        self.time_ns = 0
        self.log = logging.getLogger(f"mast.{name}")
        self.sent: Counter[str] = Counter()
        self.handled: Counter[str] = Counter()
        self.failures: dict[str, Failure] = {}
        self.rejected: Counter[tuple[str, str]] = Counter()
        self.first_rejected: dict[str, tuple[int, str]] = {}
        self._n_rejected, self._accepted = 0, set[str]()  # and the keys with a message that was not rejected
        self._publishers: dict[str, str] | None = None  # by key; built on first use
        self._inputs = dict(ports.inputs)
        self.subscriptions: Mapping[str, Input] = self._inputs  # nodes such as the recorder keep it: it grows
        self._emit = emit
        self._encode = encode
        self._outputs = ports.outputs
        self._types: dict[str, str] = {**ports.types, **node.outputs}  # of messages, by output port
        self._codecs = ports.codecs
        self._codec_of = ports.codec
        self._keys_of_port: dict[str, list[str]] = {}
        for (port, _), key in ports.outputs.items():
            self._keys_of_port.setdefault(port, []).append(key)
        self._seq: Counter[str] = Counter()
        self._ignored: frozenset[str] = frozenset()
        self.clocked = any(each.message == "clock" for each in ports.inputs.values())
        self._period_ns = period_ns
        self._now = now
        self._step = -1  # of messages sent now
        self._started_ns: int | None = None  # when the first clock was received
        self._handler_time_ns = 0  # when the running handler was called; constant within it, to keep messages in order
        self._delayed: WaitingItems[Outgoing] = WaitingItems(DELAYED)
        self._held: WaitingItems[tuple[str, Input, Received, bool]] = WaitingItems(HELD)  # arguments of `_handle`
        self._handling = ""  # key of the message being handled
        self._timespan = timespan
        self._plane = plane
        self._end = _FOREVER if timespan is None else timespan.frames - 1
        self._last_step = self._end  # the latest step in which a message can have been sent
        self._awaited = timespan is not None and now is None and bool(ports.outputs) and _direct_clock(wiring)
        self._overhears = ANY in node.inputs.values()
        self._chooses = type(node).choice is not Node.choice
        self.link: OpenedOutside | None = None  # of a node that has topics outside the run
        self._handlers: dict[str, Callable[[Any, Any], None]] = {}  # by input port
        self._handler_names: dict[str, str] = {}
        self._unopened: set[str] = set()  # ports of messages that are not decoded
        for port, message in [*node.inputs.items(), *((each.port, each.message) for each in ports.inputs.values())]:
            self._find_handler(port, message)

    @classmethod
    def of(cls, resolved: Resolved, name: str, node: Node, wiring: Wiring, **options: Any) -> Host:
        """The host of a node of a scenario; options: encode, emit and now."""
        facts: Any = {"period_ns": resolved.period_ns, "timespan": resolved.timespan, "plane": resolved.plane}
        host = cls(name, node, wiring.ports(name), resolved.seed, wiring=wiring, **facts, **options)
        host.limits = RowLimits(resolved.max_rows)
        return host

    # -- documented in node.Context ------------------------------------------------------------------------------

    def publish(
        self,
        port: str,
        body: Body,
        *,
        subject: str | None = None,
        frame: int | None = None,
        time_ns: int | None = None,
        known: int | None = None,
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
        self._send_message(key, message, known=known)

    @property
    def outside(self) -> Outside:
        if self.link is None:
            raise ConfigurationError(f"{self.name}: outside: the node names no topics in `outside_topics`")
        return self.link

    @property
    def now_ns(self) -> int:
        if self._now is None:
            return self.time_ns
        return 0 if self._started_ns is None else self._handler_time_ns - self._started_ns

    @property
    def elapsed_ns(self) -> int:
        return 0 if self._now is None else self._now() - self._handler_time_ns

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
            known = codec.known_objects(received.body, message.body) if self._codecs else None
            self._send_message(key, message, after_s, known)
        else:
            self._send_payload(
                key, received.encoded if self._encode else received.payload or received.message, after_s=after_s
            )

    def ignore(self, keys: Collection[str]) -> None:
        self._ignored = frozenset(keys)

    def reject(self, reason: str) -> None:
        self._count_rejected(self._handling, reason)

    def append(self, table: str, columns: Mapping[str, Any]) -> None:
        try:
            self.tables.append(table, columns)
        except MessageError as error:  # not of a received message
            raise ConfigurationError(f"{self.name}: {error}") from None

    def connected(self, port: str, subject: str | None = None) -> bool:
        self._output(port)
        return bool(self._keys_of_port.get(port)) if subject is None else self._key(port, subject) is not None

    def rng(self, *purpose: str | int) -> np.random.Generator:
        return stream(self.seed, self.name, *purpose)

    # -- called by the runtime -----------------------------------------------------------------------------------

    def start(self, peers: Mapping[str, str]) -> None:
        """Start the node; count and raise its errors. peers: other nodes' roles by name."""
        try:
            self.node.start(self)
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # see _guard
            self._note_failure("start", self.node.start, (), error)
            raise
        for peer, role in sorted(peers.items()):
            self.joined(peer, role)

    def arrived(self) -> None:
        """Tell the node that messages from outside have arrived."""
        self._guard("arrived", self.node.arrived, self)

    def joined(self, peer: str, role: str) -> None:
        """Tell the node that another one has joined."""
        self._guard("joined", self.node.joined, peer, role, self)

    def left(self, peer: str, role: str) -> None:
        """Tell the node that another one has left."""
        self._guard("left", self.node.left, peer, role, self)

    def rewired(self, wiring: Wiring) -> None:
        """Use another wiring from now on."""
        self.wiring = wiring
        self._publishers = None
        if not _direct_clock(wiring):
            self._awaited, self._last_step = False, self._end
        self._guard("rewired", self.node.rewired, self)

    def finish(self) -> dict[str, Any]:
        """Finish the node; returns its results, {} if that fails. Disables publishing."""
        self._emit = lambda out: None
        return self._guard("finish", lambda: self.tables.close(results.checked(self.node.finish(self)))) or {}

    def failed(self, part: str, error: BaseException) -> None:
        """Count the failure of a part of a handler, see `node.Context`."""
        self._note_failure(part, type(self.node), (), error)

    def deliver(self, key: str, payload: bytes | Message, step: int, *, counted: bool = True, flaw: str = "") -> None:
        """Receive a message on `key`: handle it, hold it, or reject it.

        step: the step in which it was sent; -1: unknown, so it is handled immediately
        counted: whether it is from a node of this run, so that lock-step waits until it is handled
        flaw: why it is invalid, for a message that was never encoded
        """
        port_input = self.subscriptions.get(key)
        if port_input is None:
            return
        if self._overhears:
            self._overhear(key, port_input, payload, step, counted, flaw)
            return
        if step > self._last_step:
            self._reject(key, f"step: sent in frame {step}, expected at most {self._last_step}", counted)
            return
        if port_input.port in self._unopened:
            if flaw and isinstance(payload, Message):
                payload = codec.encode(payload)  # bytes are forwarded unchanged
            if isinstance(payload, bytes):
                about = port_input.message, port_input.subject, payload, step, port_input.port
                unopened = Unopened(*about)  # type: ignore[arg-type]  # see Unopened
                self._take(key, port_input, unopened, counted)
                return
        choice = self.node.choice(port_input.port, port_input.subject, step) if self._chooses else None
        try:
            if not isinstance(payload, Message):
                message = codec.decode(payload, port_input.message, self.limits, choice=choice)
            elif port_input.port in self._unopened:
                message = payload
            else:
                message = codec.received(payload, self.limits, flaw, choice)
            _, source, frame, time_ns, _ = message.header
            body, kind = message.body, type(message.body)
            if (self._codecs or kind is Packed) and kind is not Shortened:
                check_codec(port_input.message, body, self._codec_of(key), self._plane)
            if source != port_input.source:
                raise MessageError(f"{port_input.message}: source {source[:40]!r}, expected {port_input.source!r}")
            if (time_ns != self.time_ns or frame != self.frame) and self._timespan is not None:
                # Nearly all messages are about the newest clock's frame, which needs no check.
                refusal = self._timespan.refusal(message.header, step if step >= 0 else self.frame)
                if refusal:
                    raise MessageError(refusal)
        except MessageError as error:
            self._reject(key, str(error), counted)
            return
        if type(body) is Shortened:
            self._count_rejected(key, excess(body))
        elif type(body) is Packed and body.left_out:
            self._count_rejected(key, f"objects: {body.left_out} of unknown position or time are not used")
        if self.observe:
            self.observe(key, message.header)
        encoded = payload if isinstance(payload, bytes) else None
        received = Received(message, port_input.subject, encoded, step, port_input.port)
        if port_input.message == "clock":
            self._clock(key, port_input, received, counted)
        else:
            self._take(key, port_input, received, counted)

    def drop(self, key: str, reason: str, *, count: int = 1, counted: int = 0) -> None:
        """Count messages dropped before delivery; lock-step waits for `counted` of them."""
        if counted:
            self.handled[key] += counted
        self._count_rejected(key, reason, count)

    def add_input(self, key: str, port_input: Input) -> None:
        """Accept messages on another key from now on."""
        self._inputs[key] = port_input
        self._find_handler(port_input.port, port_input.message)

    @property
    def waiting(self) -> int:
        """Number of held and delayed messages."""
        return len(self._held) + len(self._delayed)

    @property
    def unaccepted(self) -> list[str]:
        """The keys of its subscriptions on which nothing came but messages that were rejected."""
        rejected = self.first_rejected.keys() & self.subscriptions.keys()
        return [] if self._overhears else sorted(rejected - self._accepted)

    def reset_counts(self) -> None:
        """Restart the counts at zero, at a frame boundary: a node has died or joined."""
        self.sent.clear()
        self.handled.clear()

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
        return self._publishers.get(key) or (self.subscriptions[key].source if key in self.subscriptions else key)

    def flush(self) -> None:
        """Send all delayed messages immediately, in the order in which they are due."""
        if self._delayed:
            self._send_due(_FOREVER)

    # -- inside --------------------------------------------------------------------------------------------------

    def _find_handler(self, port: str, message: str) -> None:
        """Find the handler of an input port for messages of a type; raises TypeError if there is none."""
        node = self.node
        if port not in self._handlers:
            name = self._handler_names[port] = handler_of(type(node), port, message)
            self._handlers[port] = getattr(node, name)
            if port in node.unopened or (ANY in node.unopened and port not in node.inputs):
                self._unopened.add(port)

    def _output(self, port: str) -> str:
        if port not in self._types:
            raise ConfigurationError(f"{self.name}: no output port {port!r}{nearest(port, self._types)}")
        return self._types[port]

    def _key(self, port: str, subject: str | None) -> str | None:
        if subject is not None:
            return self._outputs.get((port, subject))
        keys = self._keys_of_port.get(port, [])
        if len(keys) > 1:
            raise ConfigurationError(f"{self.name}: port {port!r} has {len(keys)} wires: choose one with subject=…")
        return keys[0] if keys else None

    def _send_message(self, key: str, message: Message, after_s: float = 0.0, known: int | None = None) -> None:
        if self._codecs and (wire_codec := self._codec_of(key)):
            try:
                message = pack(message, wire_codec, self._plane, known)
            except MessageError as error:  # it is sent as it is, and refused by all that receive it
                self._count_rejected(key, f"codec: cannot be sent as {wire_codec}: {error}")
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
        if not self.clocked:
            raise ConfigurationError(f"{self.name}: after_s: a node that does not receive the clock delays no message")
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
        if not self._delayed.push(due, rank, out, source, size):
            self._count_rejected(source_key, f"delayed: more than {DELAYED} of {source} are delayed")

    def _send_due(self, now: int) -> None:
        """Send messages due at `now`, a step in lock-step, else ns; in the current step."""
        for out in self._delayed.pop(now):
            self._emit(out._replace(step=self._step))
            self.sent[out.key] += 1

    def _count_rejected(self, key: str, reason: str, count: int = 1) -> None:
        """Count rejected messages by key and kind, the reason's part before the colon."""
        if key not in self.first_rejected:
            self.first_rejected[key] = self.frame, " ".join(reason.split())[:_MAX_REASON]
            self.log.warning("rejected a message on %s: %s (more on this key will only be counted)", key, reason)
        self.rejected[key, " ".join(reason.split(":", 1)[0].split())] += count
        self._n_rejected += 1

    def _clock(self, key: str, port_input: Input, received: Received, counted: bool) -> None:
        if received.frame <= self.frame:
            self._reject(key, f"clock: frame {received.frame} after frame {self.frame}", counted)
            return
        self.frame, self.time_ns, self._step = received.frame, received.time_ns, received.frame
        if self._awaited:  # in lock-step the driver sends the next clock after this node has handled this one
            self._last_step = min(self.frame + 1, self._end)
        if self._now is not None and self._started_ns is None:
            self._started_ns = self._now()
        if self.link is not None:
            self.link.note_clock(self.frame)
        self._handle(key, port_input, received, counted)
        if self._now is None:
            self._send_due(self._step)
        for message in self._held.pop(self.frame):
            self._handle(*message)

    def _overhear(
        self, key: str, port_input: Input, content: bytes | Message, step: int, counted: bool, flaw: str
    ) -> None:
        """Handle a message immediately, valid or not: such a node has no outputs."""
        if counted:
            self.handled[key] += 1
        if key in self._ignored:
            return
        overheard = Overheard(key, port_input, content, step, flaw, self._timespan, self.frame, self.limits)
        if port_input.message == "clock":
            with suppress(MessageError):
                overheard.check()
                header = overheard.header
                if header.frame > self.frame:
                    self.frame, self.time_ns = header.frame, header.time_ns
        if self.observe:
            with suppress(MessageError):
                self.observe(key, overheard.header)
        self._handling = key
        self._guard(port_input.port, self._handlers[port_input.port], overheard, self)

    def _take(self, key: str, port_input: Input, received: Received, counted: bool) -> None:
        """Handle a message, or hold it until the clock of its step."""
        if received.step > self.frame and self.clocked:
            source, message = self.publisher(key), (key, port_input, received, counted)
            if not self._held.push(received.step, 0, message, source, _size(received)):
                self._reject(key, f"held: more than {HELD} of {source} wait for their clock", counted)
            return
        if not self.clocked:  # a node without a clock takes its step from the messages it handles
            self._step = max(self._step, received.step)
        self._handle(key, port_input, received, counted)

    def _handle(self, key: str, port_input: Input, received: Received, counted: bool) -> None:
        self._handling, n_rejected = key, self._n_rejected
        self._guard(port_input.port, self._handlers[port_input.port], received, self)
        self._handling = ""
        if self._n_rejected == n_rejected:
            self._accepted.add(key)
        if counted:
            self.handled[key] += 1

    def _reject(self, key: str, reason: str, counted: bool) -> None:
        if counted:
            self.handled[key] += 1
        self._count_rejected(key, reason)

    def _guard(self, name: str, call: Any, *arguments: Any) -> Any:
        """Call a handler; count an error, and log it once per handler.

        name: the handler's input port, or the name of another handler
        """
        if self._now is not None:
            self._handler_time_ns = self._now()
        try:
            return call(*arguments)
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # GeneratorExit and CancelledError are not Exceptions
            overheard = self._overhears and self._handlers.get(name) is call
            if overheard and isinstance(error, MessageError):  # of a message that subscribers would refuse
                self._reject(self._handling, str(error), counted=False)
                return None
            self._note_failure(name, call, arguments, error)
            return None

    def _note_failure(self, name: str, call: Any, arguments: tuple[Any, ...], error: BaseException) -> None:
        handler = self._handler_names[name] if self._handlers.get(name) is call else name
        if handler not in self.failures:
            self.log.error("%s failed (its further failures are only counted)", handler, exc_info=error)
            self.failures[handler] = Failure(handler, error, getattr(self.node, handler, call))
        self.failures[handler].note(self._frame_of(arguments[0] if arguments else None))
        self.on_failure(self.failures[handler])

    def _frame_of(self, message: Any) -> int:
        """The frame in which a message was handled: the clock's, else the message's."""
        if isinstance(message, Overheard):
            return message.step if message.step >= 0 else self.frame
        if isinstance(message, Received) and not self.clocked and message.step >= 0:
            return message.step
        return self.frame


def _size(received: Received) -> int:
    """Size of a message, bytes: its payload, or its columns if it was never encoded."""
    payload = received.payload
    return len(payload) if payload is not None else sum(column.nbytes for column in received.body.values())


def _direct_clock(wiring: Wiring) -> bool:
    """Whether no interposer can withhold the clock from a node."""
    return not any(wire.interposers for wire in wiring.wires if wire.message == "clock")
