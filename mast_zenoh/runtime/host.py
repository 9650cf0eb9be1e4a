"""Hosts one node, without I/O: messages in, messages out. Both runtimes use this.

The host decodes and checks received messages, holds each until it has received the clock of the step in which the
message was sent, calls the node's handlers, and numbers the node's messages. It counts messages sent and handled by
key (lock-step waits until these balance), and rejected ones.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any

from mast_zenoh.control import results
from mast_zenoh.control.failures import Failure
from mast_zenoh.errors import MessageError
from mast_zenoh.messages import codec, row_limits
from mast_zenoh.messages.schemas import Header, Message
from mast_zenoh.messages.timespan import Timespan
from mast_zenoh.node import Node, Overheard, Received, Source, Unopened, handler_names
from mast_zenoh.runtime.context import NodeContext, Outgoing
from mast_zenoh.runtime.held import Held, HeldMessages
from mast_zenoh.runtime.limits import HELD
from mast_zenoh.wiring.model import ANY, NO_WIRING, Input, Ports, Wiring


class Host(NodeContext):
    """One node with its ports connected; `NodeContext` documents the other parameters.

    timespan: valid frames and times of messages; None: any
    observe: called with the key and header of every valid message
    on_failure: called with every failure of a handler, after it has been counted
    handled: number of messages by key; failures: by handler
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
    ) -> None:
        super().__init__(name, node, ports, seed, encode=encode, emit=emit, period_ns=period_ns, now=now, wiring=wiring)
        self.handled: Counter[str] = Counter()
        self.failures: dict[str, Failure] = {}
        self.on_failure: Callable[[Failure], None] = lambda failure: None
        self.observe: Callable[[str, Header], None] | None = None
        self._held = HeldMessages()
        self._timespan = timespan
        self._end = 1 << 62 if timespan is None else timespan.frames - 1
        self._last_step = self._end  # the latest step in which a message can have been sent
        self._awaited = timespan is not None and now is None and bool(ports.outputs) and _direct_clock(wiring)
        self._overhears = ANY in node.inputs.values()
        self._handlers = {port: getattr(node, handler) for port, handler in handler_names(type(node)).items()}
        if self._overhears:
            self._handlers = {port: self._rejecting(handler) for port, handler in self._handlers.items()}

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

        def finish() -> dict[str, Any]:
            return results.checked(self.node.finish(self))

        return self._guard("finish", finish) or {}

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
        if port_input.port in self.node.unopened:
            if flaw and isinstance(payload, Message):
                payload = codec.encode(payload)  # bytes are forwarded unchanged
            if isinstance(payload, bytes):
                unopened = Unopened(port_input.message, port_input.subject, payload, step)  # type: ignore[arg-type]  # see Unopened
                self._take(key, port_input, unopened, counted)
                return
        try:
            if flaw:
                raise MessageError(flaw)
            if not isinstance(payload, Message):
                message = codec.decode(payload, port_input.message, self.limits)
            elif port_input.port in self.node.unopened:
                message = payload
            else:
                message = codec.limited(payload, self.limits)
            _, source, frame, time_ns, _ = message.header
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
        if type(message.body) is row_limits.Shortened:
            self._count_rejected(key, row_limits.excess(message.body))
        if self.observe:
            self.observe(key, message.header)
        received = Received(message, port_input.subject, payload if isinstance(payload, bytes) else None, step)
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

    @property
    def waiting(self) -> int:
        """Number of held and delayed messages."""
        return len(self._held) + len(self._delayed)

    @property
    def clocked(self) -> bool:
        """Whether the node receives the clock."""
        return self._clocked

    def reset_counts(self) -> None:
        """Restart the counts at zero, at a frame boundary: a node has died or joined."""
        self.sent.clear()
        self.handled.clear()

    # -- internal ------------------------------------------------------------------------------------------------

    def _clock(self, key: str, port_input: Input, received: Received, counted: bool) -> None:
        if received.frame <= self.frame:
            self._reject(key, f"clock: frame {received.frame} after frame {self.frame}", counted)
            return
        self.frame, self.time_ns, self._step = received.frame, received.time_ns, received.frame
        if self._awaited:  # in lock-step the driver sends the next clock after this node has handled this one
            self._last_step = min(self.frame + 1, self._end)
        if self._now is not None and self._started_ns is None:
            self._started_ns = self._now()
        self._handle(key, port_input, received, counted)
        if self._now is None:
            self._send_due(self._step)
        for message in self._held.release(self.frame):
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

    def _rejecting(self, handler: Any) -> Any:
        """Wrap a handler of overheard messages to reject those that raise MessageError."""

        def reject_malformed(overheard: Overheard, context: Any) -> None:
            try:
                handler(overheard, context)
            except MessageError as error:
                self._reject(overheard.key, str(error), counted=False)

        return reject_malformed

    def _take(self, key: str, port_input: Input, received: Received, counted: bool) -> None:
        """Handle a message, or hold it until the clock of its step."""
        if received.step > self.frame and self._clocked:
            self._hold(received.step, key, port_input, received, counted)
            return
        if not self._clocked:  # a node without a clock takes its step from the messages it handles
            self._step = max(self._step, received.step)
        self._handle(key, port_input, received, counted)

    def _hold(self, step: int, key: str, port_input: Input, received: Received, counted: bool) -> None:
        source = self.publisher(key)
        if not self._held.hold(step, source, Held(key, port_input, received, counted)):
            self._reject(key, f"held: more than {HELD} of {source} wait for their clock", counted)

    def _handle(self, key: str, port_input: Input, received: Received, counted: bool) -> None:
        self._handling = key
        self._guard(port_input.port, self._handlers[port_input.port], received, self)
        self._handling = ""
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
            self._note_failure(name, call, arguments, error)
            return None

    def _note_failure(self, name: str, call: Any, arguments: tuple[Any, ...], error: BaseException) -> None:
        handler = f"on_{name}" if self._handlers.get(name) is call else name
        if handler not in self.failures:
            self.log.error("%s failed (its further failures are only counted)", handler, exc_info=error)
            self.failures[handler] = Failure(handler, error, getattr(self.node, handler, call))
        self.failures[handler].note(self._frame_of(arguments[0] if arguments else None))
        self.on_failure(self.failures[handler])

    def _frame_of(self, message: Any) -> int:
        """The frame in which a message was handled: the clock's, else the message's."""
        if isinstance(message, Overheard):
            return message.step if message.step >= 0 else self.frame
        if isinstance(message, Received) and not self._clocked and message.step >= 0:
            return message.step
        return self.frame


def _direct_clock(wiring: Wiring) -> bool:
    """Whether no interposer can withhold the clock from a node."""
    return not any(wire.interposers for wire in wiring.wires if wire.message == "clock")
