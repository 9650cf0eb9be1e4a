"""What a protocol handles and asks for: events in, actions out.

Each is a small frozen value with all that the process decides by. MessagePack holds it as a list that begins with the
name of its class, so `log` can write it, and read it again.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection
from typing import Any, NamedTuple, TypeAlias

import msgspec

from mast_zenoh.mesh.control.flow import Epoch, MessageCounts, Rewire
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


DRAIN_TIMEOUT_S = 2.0  #: for the answer to `ask_drained`
OFFER_TIMEOUT_S = 5.0  #: for the launcher to answer one `hand_in`
DOZE_S = 0.004  #: how long a process waits that dozes, see `NodeProtocol.dozes`
ORPHAN_GRACE_S = 2.0  #: for a process whose launcher is gone to finish

#: A query that waits for an answer: of Zenoh, or of the simulated mesh.
Query = Any


class Clocks(NamedTuple):
    """The clocks of a process: monotonic, ns, which all processes of a machine share, and its processor time, s."""

    monotonic_ns: Callable[[], int]
    cpu_s: Callable[[], float]


class Actions(ABC):
    """The actions of one process. Keys are below the run's prefix."""

    @abstractmethod
    def subscribe(self, key: str) -> None:
        """Receive the messages of a wire on a key."""

    @abstractmethod
    def declare(self, key: str, message: str) -> None:
        """Declare a publisher of messages of this type on a key of a wire."""

    @abstractmethod
    def undeclare(self, key: str) -> None:
        """Withdraw the publisher of a key."""

    @abstractmethod
    def unmatched(self, keys: Collection[str]) -> set[str]:
        """Those of these keys whose publisher has no subscriber; a MatchedEvent tells when one has."""

    @abstractmethod
    def publish(self, key: str, payload: bytes, attachment: bytes) -> None:
        """Publish a message on a key with a publisher."""

    @abstractmethod
    def control(self, key: str, payload: bytes) -> None:
        """Publish a control message; key: below @control/."""

    @abstractmethod
    def ask_drained(self, node: str, key: str) -> None:
        """Ask a node whether it has forwarded all messages sent to it on a key.

        The question follows the messages. A DrainedEvent is the answer.
        """

    @abstractmethod
    def answer(self, query: Query, payload: bytes | None) -> None:
        """Answer a query; None: refuse to."""

    @abstractmethod
    def appear(self) -> None:
        """Declare the liveliness token of the node."""

    @abstractmethod
    def hand_in_part(self, part: bytes) -> None:
        """Hand in a part of a table, after earlier ones and before the results; waits while several are waiting."""

    @abstractmethod
    def hand_in(self, results: bytes) -> None:
        """Offer the results to the launcher; a HandedInEvent follows."""
