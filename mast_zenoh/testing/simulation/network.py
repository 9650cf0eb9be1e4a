"""The simulated mesh: virtual time, and what happens to messages, tokens and declarations between processes.

What Zenoh promises holds: messages of one publisher on one key arrive in order, a process's token appears after its
declarations, and what a killed process had sent arrives up to some message. All else is drawn: how long each takes, so
that messages of different keys overtake each other, control messages overtake data, and so on.
"""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Callable, Hashable
from random import Random
from typing import Any, Generic, Protocol, TypeVar

from mast_zenoh.mesh.protocol.events import Event, MatchedEvent, MessageEvent
from mast_zenoh.testing.simulation.world import Schedule

S = 1_000_000_000  #: ns in a second
LEASE_NS = 2 * S  #: after which the token of a node whose link is cut disappears, where nodes are not waited for
_CALM_NS = 100_000


class VirtualTime:
    """Calls in virtual time; random: of all delays of a run."""

    def __init__(self, schedule: Schedule) -> None:
        self.now_ns = 0
        self.played = 0
        self.random = Random(schedule.seed)
        self._calm = schedule.calm
        self._slow = self.random.choice((0.001, 0.01, 0.05))  # share of slow deliveries
        self._heap: list[tuple[int, int, Callable[..., object], tuple[Any, ...]]] = []
        self._count = 0

    def at(self, time_ns: int, call: Callable[..., object], *arguments: Any) -> None:
        """Call something at a time."""
        self._count += 1
        heapq.heappush(self._heap, (max(time_ns, self.now_ns), self._count, call, arguments))

    def after(self, seconds: float, call: Callable[..., object], *arguments: Any) -> None:
        """Call something after some seconds."""
        self.at(self.now_ns + round(seconds * S), call, *arguments)

    def delay_ns(self) -> int:
        """A drawn delay: usually some 0.2 ms, sometimes 10 ms, rarely half a second."""
        if self._calm:
            return _CALM_NS
        draw = self.random.random()
        mean = 200_000 if draw > self._slow else 10_000_000 if draw > 0.1 * self._slow else S // 2
        return 1 + int(self.random.expovariate(1.0) * mean)

    def run(self, until_ns: int, most: int, over: Callable[[], bool]) -> bool:
        """Make the calls in order until a condition holds; False if it does not by a time, or within so many calls."""
        heap = self._heap
        while heap and not over():
            self.now_ns, _, call, arguments = heapq.heappop(heap)
            if self.now_ns > until_ns or self.played >= most:
                return False
            self.played += 1
            call(*arguments)
        return over()


class Connected(Protocol):
    """A process, as far as the network knows it; see processes.SimulatedProcess."""

    name: str
    alive: bool
    lost_after_ns: int
    declared_ns: dict[str, int]

    def take_in(self, receive: Callable[..., object], *arguments: Any) -> None:
        """Receive something now, or when the process is resumed."""

    def receive_message(self, message: MessageEvent) -> None:
        """Receive a message of a wire."""

    def arrive_event(self, event: Event) -> None:
        """Let an event arrive."""

    def arrive_control(self, source: Any, key: str, payload: bytes) -> None:
        """Let a control message arrive."""


P = TypeVar("P", bound=Connected)


class SimulatedNetwork(Generic[P]):
    """Delivers messages between the processes of a run.

    realtime: whether messages of wires may be lost, and a node whose link is cut loses its token
    in_transit: messages of wires on the way to a process, or in its inbox, by process and epoch
    """

    def __init__(self, time: VirtualTime, schedule: Schedule, *, realtime: bool) -> None:
        self.time = time
        self.processes: list[P] = []
        self.in_transit: Counter[tuple[P, int]] = Counter()
        self._realtime = realtime
        self._loss = schedule.loss if realtime else 0.0
        self._newest_ns: dict[Hashable, int] = {}  # when the last message of a stream arrives
        self._cut_ns: dict[str, tuple[int, int]] = {}  # by node, from when until when its link is cut
        self._paused_ns = (0, 0)  # from when until when nothing is forwarded
        self._subscribed: dict[str, dict[P, int]] = {}  # by key, from when on
        self._matching: dict[str, set[P]] = {}  # publishers that wait for a subscriber

    # -- messages --------------------------------------------------------------------------------------------------

    def send(
        self,
        stream: Hashable,
        source: str,
        target: str,
        call: Callable[..., object],
        *arguments: Any,
        least_ns: int = 0,
    ) -> None:
        """Call something after a delay, in the order of its stream.

        source, target: the nodes whose links are on the way; "" for the launcher
        """
        arrival_ns = max(self.time.now_ns + self.time.delay_ns(), least_ns)
        for node in (source, target):
            begin, end = self._cut_ns.get(node, (0, 0))
            if begin <= arrival_ns < end:
                arrival_ns = end + self.time.delay_ns()
        begin, end = self._paused_ns
        if begin <= arrival_ns < end:
            arrival_ns = end + self.time.delay_ns()
        arrival_ns = max(arrival_ns, self._newest_ns.get(stream, 0) + 1)
        self._newest_ns[stream] = arrival_ns
        self.time.at(arrival_ns, call, *arguments)

    def newest_ns(self, stream: Hashable) -> int:
        """When the last message of a stream arrives, so far."""
        return self._newest_ns.get(stream, 0)

    def publish(self, source: P, message: MessageEvent) -> None:
        """Send a message of a wire to the subscribers of its key, as far as the publisher knows of any."""
        key = message.key
        if not self.matched(source, key):
            return
        now_ns, random = self.time.now_ns, self.time.random
        for target, from_ns in self._subscribed.get(key, {}).items():
            if from_ns > now_ns or not target.alive:
                continue
            for _ in range(self._copies(source, target, random)):
                self.in_transit[target, message.epoch] += 1
                stream = source, key, target
                self.send(stream, source.name, target.name, self._arrive, source, target, message)

    def _copies(self, source: P, target: P, random: Random) -> int:
        """How often a message arrives: once, unless it may be lost."""
        if self._realtime and (self.is_cut(source.name) or self.is_cut(target.name)):
            return 0
        if self._loss and (draw := random.random()) < 2 * self._loss:
            return 0 if draw < self._loss else 2
        return 1

    def _arrive(self, source: P, target: P, message: MessageEvent) -> None:
        if target.alive and self.time.now_ns <= source.lost_after_ns:
            target.take_in(target.receive_message, message)
        else:
            self.in_transit[target, message.epoch] -= 1

    def broadcast(self, source: P | None, key: str, payload: bytes) -> None:
        """Send a control message to all processes that receive its key: the driver's, or the launcher's."""
        for target in self.processes:
            if target.alive:
                stream = (source, key, target)
                self.send(
                    stream, source.name if source else "", target.name, target.arrive_control, source, key, payload
                )

    # -- subscriptions ---------------------------------------------------------------------------------------------

    def subscribe(self, process: P, key: str) -> int:
        """Subscribe a process to a key; returns from when on."""
        from_ns = self.time.now_ns + self.time.delay_ns()
        self._subscribed.setdefault(key, {})[process] = from_ns
        for publisher in self._matching.pop(key, set()):
            if key in publisher.declared_ns:
                self._tell(publisher, key)
        return from_ns

    def matched(self, publisher: P, key: str) -> bool:
        """Whether a publisher knows of a subscriber of its key."""
        return any(
            self._known(publisher, key, subscriber) <= self.time.now_ns
            for subscriber in self._subscribed.get(key, ())
            if subscriber.alive
        )

    def tell_matched(self, publisher: P, key: str) -> None:
        """Tell a publisher when it knows of a subscriber."""
        if any(subscriber.alive for subscriber in self._subscribed.get(key, ())):
            self._tell(publisher, key)
        else:
            self._matching.setdefault(key, set()).add(publisher)

    def _tell(self, publisher: P, key: str) -> None:
        known_ns = min(
            self._known(publisher, key, subscriber) for subscriber in self._subscribed[key] if subscriber.alive
        )
        self.time.at(known_ns, publisher.arrive_event, MatchedEvent(key))

    def _known(self, publisher: P, key: str, subscriber: P) -> int:
        """When a publisher knows of a subscriber.

        A new publisher has to ask for its subscribers. Later ones are announced to it before their tokens.
        """
        return max(self._subscribed[key][subscriber], publisher.declared_ns[key])

    # -- links -----------------------------------------------------------------------------------------------------

    def is_cut(self, node: str) -> bool:
        """Whether a node's link is cut now."""
        begin, end = self._cut_ns.get(node, (0, 0))
        return begin <= self.time.now_ns < end

    def pause(self, seconds: float) -> None:
        """Forward nothing for some seconds: the router's process is suspended."""
        self._paused_ns = self.time.now_ns, self.time.now_ns + round(seconds * S)

    def noticed_ns(self, node: str) -> int:
        """When the router notices that the processes of a node are gone: at once, unless its link is cut."""
        begin, end = self._cut_ns.get(node, (0, 0))
        if not self.is_cut(node):
            return self.time.now_ns
        return min(begin + LEASE_NS, end) if self._realtime else end

    def cut(self, node: str, seconds: float) -> bool:
        """Cut a node's link for some seconds; returns whether its token disappears meanwhile."""
        begin_ns = self.time.now_ns
        self._cut_ns[node] = begin_ns, begin_ns + round(seconds * S)
        return self._realtime and seconds * S > LEASE_NS
