"""The events of the protocol: what a process handles, one after the other, see `Inbox`.

Each is a small frozen value with all that the process decides by. MessagePack holds it as a list that begins with the
name of its class, so `log` can write it, and read it again.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import msgspec

from mast_zenoh.mesh.control.flow import Epoch, MessageCounts, Rewire
from mast_zenoh.mesh.protocol.actions import Query
from mast_zenoh.mesh.protocol.pacer import TokenPresence


class Event(msgspec.Struct, frozen=True, tag=True, array_like=True):
    """What a process handles next."""


class MessageEvent(Event, frozen=True):
    """A message of a wire; epoch, step: of its stamp."""

    key: str
    payload: bytes
    epoch: int
    step: int


class DroppedEvent(Event, frozen=True):
    """The inbox had no room for some messages; counts: of (key, epoch)."""

    counts: dict[tuple[str, int], int]


class EpochEvent(Event, frozen=True):
    """The driver begins an epoch."""

    epoch: Epoch


class MatchedEvent(Event, frozen=True):
    """The publisher of a key has a subscriber."""

    key: str


class StopEvent(Event, frozen=True):
    """The node is to hand in its results, and end."""

    reason: str


class HandedInEvent(Event, frozen=True):
    """The answer to the results: "" if the launcher has accepted them, None: no answer, else why it refuses them."""

    refusal: str | None


class DrainEvent(Event, frozen=True):
    """A publisher asks whether everything was forwarded that it has sent on a key."""

    query: Query
    key: str


class DrainedEvent(Event, frozen=True):
    """The answer to that, or none in time."""

    key: str
    answered: bool


class OutsideEvent(Event, frozen=True):
    """In real time: messages from programs outside the run have arrived for the node."""


class DueEvent(Event, frozen=True):
    """In real time: a message was delayed while Zenoh's thread handled it; the main thread sends it when it is due."""


class RewireEvent(Event, frozen=True):
    """For the driver: the launcher asks for a change of the wiring."""

    query: Query
    change: Rewire


class NewestEvent(Event, frozen=True):
    """News of a node for the driver, of which only the newest waits."""

    node: str

    def after(self, waiting: Any) -> NewestEvent:
        """This event, when an older one of its kind and node still waits."""
        return self


class CountsEvent(NewestEvent, frozen=True):
    """A node's report."""

    counts: MessageCounts


class PresenceEvent(NewestEvent, frozen=True):
    """A node's token has appeared or gone."""

    presence: TokenPresence

    def after(self, waiting: PresenceEvent) -> PresenceEvent:
        return PresenceEvent(self.node, waiting.presence.followed_by(self.presence))


#: Of these classes an event is.
AnyEvent: TypeAlias = (
    MessageEvent
    | DroppedEvent
    | EpochEvent
    | MatchedEvent
    | StopEvent
    | HandedInEvent
    | DrainEvent
    | DrainedEvent
    | OutsideEvent
    | DueEvent
    | RewireEvent
    | CountsEvent
    | PresenceEvent
)
