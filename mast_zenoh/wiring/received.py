"""Messages as nodes receive them: decoded, undecoded for forwarding, or overheard."""

from __future__ import annotations

from typing import NamedTuple

from mast_zenoh.errors import MessageError
from mast_zenoh.messages import codec
from mast_zenoh.messages.limits import NO_LIMITS, OVERHEARD, RowLimits, Timespan
from mast_zenoh.messages.schemas import Body, Header, Message, same_columns
from mast_zenoh.wiring.model import Input


class Received(NamedTuple):
    """A message as a node receives it.

    message: header and columns (read-only arrays)
    subject: the name in the wire's key: "infra_1" on agent/infra_1/tracks, "" on cc/picture, "infra_1/radar" on
             agent/infra_1/detections/radar
    payload: the bytes received; None in a single process, where messages are not encoded
    step:    the run's frame when it was sent; later than the message's own frame if it was delayed
    port:    the input port on which it arrived
    """

    message: Message
    subject: str
    payload: bytes | None = None
    step: int = -1
    port: str = ""

    @property
    def frame(self) -> int:
        """The frame that the message is about."""
        return self.message.header.frame

    @property
    def time_ns(self) -> int:
        """The time of that frame, or of the measurement in `detections`, ns since the scene began."""
        return self.message.header.time_ns

    @property
    def body(self) -> Body:
        """The columns."""
        return self.message.body

    @property
    def schema(self) -> str:
        """The message type."""
        return self.message.header.schema

    @property
    def encoded(self) -> bytes:
        """The bytes received, or as they would have been sent."""
        return codec.encode(self.message) if self.payload is None else self.payload


class Unopened(Received):
    """An undecoded message that a node only forwards.

    Accessing its content may raise MessageError.
    Its fields are (message type, subject, payload, step, port).
    """

    __slots__ = ()

    @property
    def message(self) -> Message:
        """The message: its header is decoded now, its body on first access."""
        assert self.payload is not None
        return codec.decode_lazily(self.payload, self.schema)

    @property
    def schema(self) -> str:
        """The message type of its wire; the content may be anything."""
        return str(self[0])


class Overheard:
    """A message received on any key of the run.

    For nodes with an input port of the type `model.ANY`. Content is decoded on access, so a node can skip messages.

    key:     its key, possibly a tap leg's
    wire:    properties of that key: subject, message type, publisher of the wire
    step:    the run's frame when the message was sent; -1: unknown
    """

    __slots__ = ("_content", "_flaw", "_header", "_limits", "_now", "_timespan", "key", "step", "wire")

    def __init__(
        self,
        key: str,
        wire: Input,
        content: bytes | Message,
        step: int,
        flaw: str = "",
        timespan: Timespan | None = None,
        now: int = -1,
        limits: RowLimits = NO_LIMITS,
    ) -> None:
        """content: the bytes as sent, or in one process the message.

        flaw: why receivers refuse the message, or ""
        timespan: its valid frames and times, None: any; now: the run's current frame, if `step` is unknown
        limits: on its rows
        """
        self.key, self.wire, self.step = key, wire, step
        self._timespan, self._now, self._limits = timespan, now, limits
        self._content, self._flaw = content, flaw
        self._header: Header | None = None

    @property
    def payload(self) -> bytes:
        """The bytes as they were sent, or as they would have been."""
        return self._content if isinstance(self._content, bytes) else codec.encode(self._content)

    @property
    def header(self) -> Header:
        """The header; raises MessageError if invalid or not from the wire's publisher."""
        header = self._header
        if header is None:
            content, wire = self._content, self.wire
            if isinstance(content, Message):
                header = content.header
                if self._flaw:
                    codec.check_header(header)
            else:
                header = codec.decode_header_only(content, wire.message)
            if header.source != wire.source:
                raise MessageError(f"{wire.message}: source {header.source[:40]!r}, expected {wire.source!r}")
            self._header = header
        return header

    @property
    def body(self) -> Body:
        """The columns, decoded at each access; raises MessageError if invalid."""
        # An agent's own tracks as their receivers use them; its mission estimate has the picture's objects, too.
        limit_of = OVERHEARD if self.wire.message == "tracks" and self.wire.output != "tracks" else None
        if isinstance(self._content, Message):
            if self._flaw:
                raise MessageError(self._flaw)
            return codec.limited(self._content, self._limits, limit_of).body
        return codec.decode(self._content, self.wire.message, self._limits, limit_of).body

    def check(self) -> None:
        """Raise MessageError if a subscriber of the key would refuse the message."""
        _ = self.header, self.body
        self.check_time()

    def check_time(self) -> None:
        """Raise MessageError if a subscriber would refuse the header, frame or time."""
        header = self.header
        if self._timespan is not None:
            refusal = self._timespan.refusal(header, self.step if self.step >= 0 else self._now)
            if refusal:
                raise MessageError(refusal)

    @property
    def encoded(self) -> bool:
        """Whether it was received as bytes, which its columns then keep in memory."""
        return isinstance(self._content, bytes)

    def same_bytes(self, other: Overheard) -> bool:
        """Whether both have the same bytes, or would have if they were sent."""
        mine, others = self._content, other._content
        if mine is others:
            return True
        if isinstance(mine, Message) and isinstance(others, Message):
            return mine.header == others.header and same_columns(mine.body, others.body)
        return self.payload == other.payload
