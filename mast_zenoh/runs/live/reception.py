"""Receives copies of a run's messages, keeps only the newest of each key, and measures rates, lag and loss on wires.

Zenoh itself fills a ring for each key, and drops the oldest: no message waits for Python, so neither this process nor
what it does with a frame can hold back the run.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import zenoh

from mast_zenoh.errors import MessageError
from mast_zenoh.mesh.protocol.traffic import stamp_of
from mast_zenoh.messages import codec
from mast_zenoh.wiring.model import Wire, Wiring

#: Messages of a key that are kept after they were taken from its ring, and for which the ring has room by default.
KEPT = 16
#: s, over which a rate is measured.
_WINDOW_S = 2.0
#: How many shown frames a share of lost messages is from: of each, some steps are compared.
_COMPARED = 5
#: Frames of the run before the newest that do not count as lost: their messages may be under way.
_UNDER_WAY = 2


class Sample(NamedTuple):
    """A message as it arrived. step: frame of the run in which it was sent"""

    step: int
    payload: bytes


class ArrivedMessage(NamedTuple):
    """A message of a key that has just arrived. step: frame of the run in which it was sent"""

    key: str
    step: int
    payload: zenoh.ZBytes


class Reception:
    """The newest messages of some keys.

    prefix: of all keys of the run
    frames: number of frames that the run can have: a message with a later step is forged; None: not known
    room:   messages of a key that can wait until they are taken: beyond it, the oldest are dropped
    """

    def __init__(self, session: zenoh.Session, prefix: str, frames: int | None = None, room: int = KEPT) -> None:
        self._session = session
        self._room = room
        self._end = 1 << 62 if frames is None else frames
        self._prefix = prefix
        self._subscribers: dict[str, Any] = {}
        self._kept: dict[str, deque[tuple[int, Any]]] = {}

    def subscribe(self, keys: Iterable[str]) -> None:
        """Receive exactly these keys from now on."""
        wanted = dict.fromkeys(keys)
        for key in self._subscribers.keys() - wanted.keys():
            self._subscribers.pop(key).undeclare()
            self._kept.pop(key)
        for key in wanted:
            if key not in self._subscribers:
                ring: Any = zenoh.handlers.RingChannel(self._room)
                self._subscribers[key] = self._session.declare_subscriber(f"{self._prefix}/{key}", ring)
                self._kept[key] = deque(maxlen=KEPT)

    def poll(self) -> list[ArrivedMessage]:
        """Take what has arrived, and return it, key by key; messages from outside the run are left out."""
        arrived = []
        for key, subscriber in self._subscribers.items():
            kept = self._kept[key]
            while (sample := subscriber.handler.try_recv()) is not None:
                _, step = stamp_of(sample.attachment, key)
                if 0 <= step < self._end:
                    kept.append((step, sample.payload))
                    arrived.append(ArrivedMessage(key, step, sample.payload))
        return arrived

    def newest_step(self, key: str) -> int:
        """The step of the newest message of a key; -1: there is none."""
        kept = self._kept.get(key)
        return kept[-1][0] if kept else -1

    def lead(self, key: str) -> int:
        """By how many steps the newest message of any key is ahead of this key's newest one; 0: it is of this key."""
        return max(map(self.newest_step, self._kept), default=-1) - self.newest_step(key)

    def steps(self, key: str) -> list[int]:
        """The steps of the kept messages of a key, the oldest first."""
        return [step for step, _ in self._kept.get(key, ())]

    def newest(self, key: str) -> bytes | None:
        """The newest message of a key."""
        kept = self._kept.get(key)
        return kept[-1][1].to_bytes() if kept else None

    def sent_since(self, step: int) -> Iterator[tuple[str, Sample]]:
        """Key and content of the kept messages that were sent in a step or later, in the order of each key."""
        for key, kept in self._kept.items():
            for sent, payload in kept:
                if sent >= step:
                    yield key, Sample(sent, payload.to_bytes())

    def close(self) -> None:
        """Unsubscribe."""
        self.subscribe(())


class LegState(NamedTuple):
    """A leg of a wire.

    node:    its publisher;  role: the publisher's role;  key: the leg's key
    rate_hz: messages per s, from the numbers in their headers; None: not known yet
    lag:     frames between the clock and the newest message; None: none has arrived
    lost:    share of recent messages that came in but did not leave the publisher in the same frame; 0 for the
             first leg of a wire; None: unknown
    """

    node: str
    role: str
    key: str
    rate_hz: float | None
    lag: int | None
    lost: float | None


class WireState(NamedTuple):
    """A wire: its key, its legs from the publisher on, and the nodes that finally receive it."""

    key: str
    legs: tuple[LegState, ...]
    subscribers: tuple[str, ...]


class WireMeter:
    """Follows the numbers of messages on the received keys of a run."""

    def __init__(self, reception: Reception) -> None:
        self._reception = reception
        self._numbers: dict[str, deque[tuple[float, int]]] = {}
        self._compared: dict[str, deque[tuple[int, int]]] = {}  # by leg: messages that came in, and that were lost

    def note(self, now_s: float, types: Mapping[str, str]) -> None:
        """Note the newest messages. now_s: monotonic time;  types: message types of the received keys"""
        for key in self._numbers.keys() - types.keys():
            del self._numbers[key]
        for key, message in types.items():
            payload = self._reception.newest(key)
            if payload is None:
                continue
            try:
                number = codec.decode_header_only(payload, message).seq
            except MessageError:
                continue
            seen = self._numbers.setdefault(key, deque())
            if seen and number < seen[-1][1]:  # its publisher was started again
                seen.clear()
            seen.append((now_s, number))
            while len(seen) > 2 and now_s - seen[0][0] > _WINDOW_S:
                seen.popleft()

    def states(self, wiring: Wiring, types: Mapping[str, str], roles: Mapping[str, str], step: int) -> list[WireState]:
        """The received wires, those with interposers first. step: of the newest clock"""
        wires = [wire for wire in wiring.wires if any(leg.key in types for leg in wire.every_leg)]
        wires.sort(key=lambda wire: not wire.interposers)
        return [self._state(wire, roles, step) for wire in wires]

    def _state(self, wire: Wire, roles: Mapping[str, str], step: int) -> WireState:
        legs = []
        entering = {end.node: leg.key for leg in wire.every_leg for end in leg.subscribers}
        for index, leg in enumerate(wire.every_leg):
            node = leg.publisher.node
            lost = 0.0 if not index else self._lost(entering.get(node, ""), leg.key, step)
            legs.append(
                LegState(node, roles.get(node, ""), leg.key, self._rate(leg.key), self._lag(leg.key, step), lost)
            )
        return WireState(wire.key, tuple(legs), tuple(end.node for end in wire.subscribers))

    def _rate(self, key: str) -> float | None:
        seen: Sequence[tuple[float, int]] = self._numbers.get(key, ())
        if len(seen) < 2 or seen[-1][0] - seen[0][0] < _WINDOW_S / 4:
            return None
        return (seen[-1][1] - seen[0][1]) / (seen[-1][0] - seen[0][0])

    def _lag(self, key: str, step: int) -> int | None:
        newest = self._reception.newest_step(key)
        return max(step - newest, 0) if newest >= 0 else None

    def _lost(self, before: str, after: str, step: int) -> float | None:
        received, sent = {*self._reception.steps(before)}, {*self._reception.steps(after)}
        # Each ring holds its own newest messages: compare where both have some.
        first = min(sent, default=min(received, default=0))
        common = {each for each in received if first <= each <= step - _UNDER_WAY}
        compared = self._compared.setdefault(after, deque(maxlen=_COMPARED))
        compared.append((len(common), len(common - sent)))
        came, lost = map(sum, zip(*compared, strict=True))
        return lost / came if came else None
