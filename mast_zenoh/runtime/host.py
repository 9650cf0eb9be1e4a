"""Hosts one node, without I/O: messages in, messages out. Both runtimes are shells around this.

The host decodes and checks what comes in, holds a message back until the clock of the step it was sent in has
come, calls the node's handlers, numbers what the node publishes, and counts: per key what was sent and what has been
handled (lock-step waits for these to balance), per source what was malformed.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any

from mast_zenoh.control import results
from mast_zenoh.control.failures import Failure
from mast_zenoh.errors import MessageError
from mast_zenoh.messages import codec
from mast_zenoh.messages.schemas import Header, Message
from mast_zenoh.messages.timespan import Timespan
from mast_zenoh.node import Node, Overheard, Received, Source, Unopened, handler_names
from mast_zenoh.runtime.context import NodeContext, Outgoing
from mast_zenoh.runtime.held import Held, HeldMessages
from mast_zenoh.runtime.limits import HELD
from mast_zenoh.wiring.model import ANY, NO_WIRING, Input, Ports, Wiring


class Host(NodeContext):
    """One node with its ports connected; see the module's docstring, and `NodeContext` for the parameters.

    timespan: the frames and times that messages can have; None: any
    observe: called with the key and header of every sound message;
    on_failure: called with every failure of a handler, when it has been counted;
    handled: messages by key; failures: by handler.
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
        self._last_step = self._end  # in which a message can have been sent
        self._awaited = timespan is not None and now is None and bool(ports.outputs) and _direct_clock(wiring)
        self._overhears = ANY in node.inputs.values()
        self._handlers = {port: getattr(node, handler) for port, handler in handler_names(type(node)).items()}
        if self._overhears:
            self._handlers = {port: self._or_rejected(handler) for port, handler in self._handlers.items()}

    # -- what the runtime calls ----------------------------------------------------------------------------------

    def start(self, peers: Mapping[str, str]) -> None:
        """Begin: `peers` are the other nodes that are up, name to role. Counts and raises what `start` raises."""
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
        """Another node has come up."""
        self._guard("joined", self.node.joined, peer, role, self)

    def left(self, peer: str, role: str) -> None:
        """Another node has gone."""
        self._guard("left", self.node.left, peer, role, self)

    def rewired(self, wiring: Wiring) -> None:
        """From now on messages take the ways of another wiring."""
        self.wiring = wiring
        self._publishers = None
        if not _direct_clock(wiring):
            self._awaited, self._last_step = False, self._end
        self._guard("rewired", self.node.rewired, self)

    def finish(self) -> dict[str, Any]:
        """End: the node's results; none if `finish` fails. What the node publishes now goes nowhere."""
        self._emit = lambda out: None

        def finish() -> dict[str, Any]:
            return results.checked(self.node.finish(self))

        return self._guard("finish", finish) or {}

    def failed(self, part: str, error: BaseException) -> None:
        """See node.Context."""
        self._note_failure(part, type(self.node), (), error)

    def deliver(self, key: str, payload: bytes | Message, step: int, *, counted: bool = True, flaw: str = "") -> None:
        """A message has come on `key`, sent in `step` of its sender (-1: not known, it is taken at once).

        `counted`: it was sent by a node of this run, so that lock-step waits until it is handled.
        """
        hears = self.subscriptions.get(key)
        if hears is None:
            return
        if self._overhears:
            self._overhear(key, hears, payload, step, counted, flaw)
            return
        if step > self._last_step:
            self._reject(key, f"step: sent in frame {step}, expected at most {self._last_step}", counted)
            return
        if hears.port in self.node.unopened:
            if flaw and isinstance(payload, Message):
                payload = codec.encode(payload)  # as bytes, so that it is passed on as it is
            if isinstance(payload, bytes):
                self._take(key, hears, Unopened(hears.message, hears.subject, payload, step), counted)  # type: ignore[arg-type]  # see Unopened
                return
        try:
            if flaw:
                raise MessageError(flaw)
            message = payload if isinstance(payload, Message) else codec.decode(payload, hears.message)
            _, source, frame, time_ns, _ = message.header
            if source != hears.source:
                raise MessageError(f"{hears.message}: source {source[:40]!r}, expected {hears.source!r}")
            if (time_ns != self.time_ns or frame != self.frame) and self._timespan is not None:
                # Otherwise it is about the newest clock's frame, as nearly all messages are.
                refusal = self._timespan.refusal(message.header, step if step >= 0 else self.frame)
                if refusal:
                    raise MessageError(refusal)
        except MessageError as error:
            self._reject(key, str(error), counted)
            return
        if self.observe:
            self.observe(key, message.header)
        received = Received(message, hears.subject, payload if isinstance(payload, bytes) else None, step)
        if hears.message == "clock":
            self._clock(key, hears, received, counted)
        else:
            self._take(key, hears, received, counted)

    def drop(self, key: str, reason: str, *, count: int = 1, counted: int = 0) -> None:
        """Messages on `key` were dropped before they could be delivered; for `counted` of them lock-step waits."""
        if counted:
            self.handled[key] += counted
        self._count_rejected(key, reason, count)

    def hear(self, key: str, heard: Input) -> None:
        """From now on another key is heard."""
        self._hears[key] = heard

    @property
    def waiting(self) -> int:
        """How many messages wait here: for the clock of their step, or to leave."""
        return len(self._held) + len(self._delayed)

    @property
    def clocked(self) -> bool:
        """Whether it hears the clock."""
        return self._clocked

    def reset_counts(self) -> None:
        """Start counting anew (a node has died or joined; done at a frame boundary)."""
        self.sent.clear()
        self.handled.clear()

    # -- inside --------------------------------------------------------------------------------------------------

    def _clock(self, key: str, hears: Input, received: Received, counted: bool) -> None:
        if received.frame <= self.frame:
            self._reject(key, f"clock: frame {received.frame} after frame {self.frame}", counted)
            return
        self.frame, self.time_ns, self._step = received.frame, received.time_ns, received.frame
        if self._awaited:  # in lock-step the next clock does not come before this node has handled this one
            self._last_step = min(self.frame + 1, self._end)
        if self._now is not None and self._began_ns is None:
            self._began_ns = self._now()
        self._handle(key, hears, received, counted)
        if self._now is None:
            self._let_go(self._step)
        for message in self._held.release(self.frame):
            self._handle(*message)

    def _overhear(self, key: str, hears: Input, content: bytes | Message, step: int, counted: bool, flaw: str) -> None:
        """Hand a message on at once, sound or not: a node that publishes nothing cannot act too early."""
        if counted:
            self.handled[key] += 1
        if key in self._ignored:
            return
        overheard = Overheard(key, hears, content, step, flaw, self._timespan, self.frame)
        if hears.message == "clock":
            with suppress(MessageError):
                overheard.check()
                header = overheard.header
                if header.frame > self.frame:
                    self.frame, self.time_ns = header.frame, header.time_ns
        if self.observe:
            with suppress(MessageError):
                self.observe(key, overheard.header)
        self._handling = key
        self._guard(hears.port, self._handlers[hears.port], overheard, self)

    def _or_rejected(self, handler: Any) -> Any:
        """The handler of a node that hears every key: a message is rejected when the node finds it malformed."""

        def take(overheard: Overheard, context: Any) -> None:
            try:
                handler(overheard, context)
            except MessageError as error:
                self._reject(overheard.key, str(error), counted=False)

        return take

    def _take(self, key: str, hears: Input, received: Received, counted: bool) -> None:
        """Handle a message, or hold it until the clock of its step comes."""
        if received.step > self.frame and self._clocked:
            self._hold(received.step, key, hears, received, counted)
            return
        if not self._clocked:  # a node without a clock takes its step from the messages it handles
            self._step = max(self._step, received.step)
        self._handle(key, hears, received, counted)

    def _hold(self, step: int, key: str, hears: Input, received: Received, counted: bool) -> None:
        source = self.publisher(key)
        if not self._held.hold(step, source, Held(key, hears, received, counted)):
            self._reject(key, f"held: more than {HELD} of {source} wait for their clock", counted)

    def _handle(self, key: str, hears: Input, received: Received, counted: bool) -> None:
        self._handling = key
        self._guard(hears.port, self._handlers[hears.port], received, self)
        self._handling = ""
        if counted:
            self.handled[key] += 1

    def _reject(self, key: str, reason: str, counted: bool) -> None:
        if counted:
            self.handled[key] += 1
        self._count_rejected(key, reason)

    def _guard(self, what: str, call: Any, *arguments: Any) -> Any:
        """Call a handler; its error costs this one message, is counted, and logged once for each handler.

        what: the input port that it is the handler of, or the name of another handler
        """
        if self._now is not None:
            self._moment_ns = self._now()
        try:
            return call(*arguments)
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # GeneratorExit and CancelledError are no Exception
            self._note_failure(what, call, arguments, error)
            return None

    def _note_failure(self, what: str, call: Any, arguments: tuple[Any, ...], error: BaseException) -> None:
        handler = f"on_{what}" if self._handlers.get(what) is call else what
        if handler not in self.failures:
            self.log.error("%s failed (further failures of it are only counted)", handler, exc_info=error)
            self.failures[handler] = Failure(handler, error, getattr(self.node, handler, call))
        self.failures[handler].note(self._frame_of(arguments[0] if arguments else None))
        self.on_failure(self.failures[handler])

    def _frame_of(self, message: Any) -> int:
        """The frame in which a handler got a message: the clock's, or for a node without one, the message's."""
        if isinstance(message, Overheard):
            return message.step if message.step >= 0 else self.frame
        if isinstance(message, Received) and not self._clocked and message.step >= 0:
            return message.step
        return self.frame


def _direct_clock(wiring: Wiring) -> bool:
    """Whether no interposer can keep a clock from a node."""
    return not any(wire.interposers for wire in wiring.wires if wire.message == "clock")
