"""What a protocol asks for: its actions, carried out by the Zenoh adapter or by the simulated mesh."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection
from typing import Any, NamedTuple

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
