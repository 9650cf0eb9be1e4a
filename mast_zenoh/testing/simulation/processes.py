"""Simulated processes of nodes, the supervisor that starts and ends them, and what they find around them."""

from __future__ import annotations

import logging
import traceback
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Collection, Iterable
from contextlib import nullcontext
from typing import Any, Protocol

from mast_zenoh.config.resolved import NodeSpec, Resolved
from mast_zenoh.control.signatures import Signatures
from mast_zenoh.launch.launcher_protocol import RunState
from mast_zenoh.launch.supervisor import Child, Supervisor
from mast_zenoh.runtime.protocol.actions import (
    DOZE_S,
    DRAIN_TIMEOUT_S,
    OFFER_TIMEOUT_S,
    ORPHAN_GRACE_S,
    Actions,
    Clocks,
)
from mast_zenoh.runtime.protocol.driver import DriverProtocol, protocol_of
from mast_zenoh.runtime.protocol.node import CLOCK
from mast_zenoh.runtime.protocol.traffic import ATTACHMENT, Event, Inbox, Item
from mast_zenoh.runtime.waiting import Limit, Room
from mast_zenoh.testing.simulation.network import Network, VirtualTime
from mast_zenoh.testing.simulation.world import World

_FOREVER = 1 << 62
_FULL = Limit(6, 1 << 20)  # of an inbox that is filled

KILLED, ORPHANED, CRASHED = -9, 3, 1  #: exit codes


class LauncherEnd(Protocol):
    """The launcher, as far as processes know it; see launcher.SimulatedLauncher."""

    alive: bool
    state: RunState

    def arrive_control(self, source: SimulatedProcess, key: str, payload: bytes) -> None:
        """Let a control message of a node arrive."""

    def arrive_result(self, source: SimulatedProcess, results: bytes, answer: Callable[[str | None], None]) -> None:
        """Let results of a node arrive, and answer."""


class SimulatedMesh(ABC):
    """What processes and launcher find around them: virtual time, the network, each other, and a watch on promises.

    run:    its id;  silent_log: a logger that writes nothing
    driver: its process, once it has joined;  doomed: nodes that are killed some time after a stop reaches them, s
    """

    world: World
    run: str
    silent_log: logging.Logger
    time: VirtualTime
    network: Network[SimulatedProcess]
    driver: SimulatedProcess | None
    launcher: LauncherEnd
    doomed: dict[str, float]

    @abstractmethod
    def current(self, node: str) -> SimulatedProcess | None:
        """The running process of a node."""

    @abstractmethod
    def handle(self, process: SimulatedProcess, event: Event | None) -> None:
        """Have a process handle an event."""

    @abstractmethod
    def token(self, process: SimulatedProcess, present: bool) -> None:
        """Have a process's token appear, after its declarations, or go: for the driver and for the launcher."""

    @abstractmethod
    def note_published(self, process: SimulatedProcess, key: str, payload: bytes, step: int) -> None:
        """Check what must hold when a message is published, and when a frame begins."""

    @abstractmethod
    def note_stop(self, process: SimulatedProcess, reason: str) -> None:
        """Check what must hold when the driver ends a run in lock-step."""

    @abstractmethod
    def violate(self, sentence: str) -> None:
        """Note a broken promise."""


class _NearlyFull(Room):
    """Has no room left but for a few messages of each source, and for clocks."""

    def take(self, source: str, size: int) -> bool:
        return super().take(source, size) or source == CLOCK

    def free(self, source: str, size: int) -> None:
        """What came before it was filled took no room here."""
        if self._messages[source]:
            super().free(source, size)


class DrainQuery:
    """A drain query on its way; answered: whether its end has been told."""

    def __init__(self, asker: SimulatedProcess, key: str) -> None:
        self.asker = asker
        self.key = key
        self.answered = False

    def finish(self, ok: bool) -> None:
        """Tell the asker, once."""
        if not self.answered:
            self.answered = True
            self.asker.arrive_event(("drained", self.key, ok))


class SimulatedProcess(Actions):
    """One process of a node.

    alive: whether it runs;  lost_after_ns: what it has sent and arrives later is lost, because it was killed
    joined_frame: the newest frame that had begun when it joined; -1: none
    declared_ns: when the publisher of each key begins to know its subscribers
    subscribed_ns: from when on all its subscriptions hold
    """

    def __init__(self, mesh: SimulatedMesh, name: str, resolved: Resolved, number: int) -> None:
        self.name = name
        self.alive = True
        self.exit: int | None = None
        self.log: list[str] = []
        self.joined_frame = -1
        self.lost_after_ns = _FOREVER
        self.declared_ns: dict[str, int] = {}
        self._mesh = mesh
        self._time = mesh.time
        self._network = mesh.network
        self._items: deque[Item] = deque()
        self._arrived: deque[tuple[Callable[..., object], tuple[Any, ...]]] = deque()  # while it is suspended
        self._suspended = False
        self._turn_due = False  # whether it is about to handle an event
        self._timer = 0
        self.subscribed_ns = 0
        world, time = mesh.world, mesh.time
        self.inbox = Inbox(self._put, nullcontext())
        clock: Callable[[], int] = lambda: time.now_ns  # noqa: E731
        self.protocol = protocol_of(
            resolved,
            name,
            world.build(name, resolved.nodes[name]),
            self,
            self.inbox,
            Clocks(clock, clock, lambda: 0.0),
            process=f"{name} {number}",
            signatures=Signatures(mesh.run),
        )
        self.protocol.host.log = mesh.silent_log
        self.publishes = bool(self.protocol.outlets)
        self._network.processes.append(self)
        self._guarded(self.protocol.start)
        self._turn()

    # -- running ---------------------------------------------------------------------------------------------------

    def _put(self, item: Item) -> None:
        self._items.append(item)
        if self.alive and not self._suspended:
            self._put_off()

    def _turn(self) -> None:
        """Handle an event, if any; prepare to wait if there is no other."""
        self._turn_due = False
        if not self.alive or self._suspended:
            return
        if self._items:
            item = self._items.popleft()
            event = self.inbox.take(item)
            self._guarded(self._mesh.handle, self, event)
            if event[0] == "message":
                self._network.in_transit[self, event[3]] -= 1
        self._go_on()

    def _go_on(self) -> None:
        if not self.alive:
            return
        if self.protocol.ended:
            self.end(0)
        elif self._items:
            self._put_off()
        elif self.protocol.dozes:
            self._turn_due = True  # what arrives does not wake it
            self._time.after(DOZE_S, self._wake)
        else:
            self._guarded(self._wait)

    def _wake(self) -> None:
        self._turn_due = False
        if not self.alive or self._suspended:
            return
        if self._items:
            self._put_off()
        else:
            self._guarded(self._wait)

    def _put_off(self) -> None:
        if not self._turn_due:
            self._turn_due = True
            self._time.at(self._time.now_ns + self._time.delay_ns(), self._turn)

    def _wait(self) -> None:
        self._timer += 1
        wait_s = self.protocol.idle()
        if wait_s is not None:
            self._time.after(wait_s, self._time_out, self._timer)

    def _time_out(self, timer: int) -> None:
        if timer == self._timer and self.alive and not self._suspended and not self._turn_due:
            self._guarded(self._mesh.handle, self, None)
            self._go_on()

    def _guarded(self, call: Callable[..., object], *arguments: Any) -> None:
        """Call the protocol; an exception ends the process, as it would end a real one."""
        try:
            call(*arguments)
        except Exception as error:
            self.log += traceback.format_exc().splitlines()
            if "start" not in self.protocol.host.failures:
                self._mesh.violate(f"{self.name} crashed: {type(error).__name__}: {error}")
            self.end(CRASHED)

    def take_in(self, receive: Callable[..., object], *arguments: Any) -> None:
        """Receive something now, or when the process is resumed."""
        if self._suspended:
            self._arrived.append((receive, arguments))
        elif self.alive:
            receive(*arguments)

    def receive_message(self, key: str, payload: bytes, epoch: int, step: int) -> None:
        """Receive a message of a wire."""
        if not self.protocol.receive_message(key, payload, epoch, step):
            self._network.in_transit[self, epoch] -= 1

    def arrive_event(self, event: Event) -> None:
        """Let an event arrive."""
        self.take_in(self.inbox.put, event)

    def arrive_control(self, source: SimulatedProcess | None, key: str, payload: bytes) -> None:
        """Let a control message arrive."""
        if source is None or self._time.now_ns <= source.lost_after_ns:
            self.take_in(self._receive_control, key, payload)

    def _receive_control(self, key: str, payload: bytes) -> None:
        kind, _, node = key.partition("/")
        if kind == "epoch":
            self.protocol.receive_epoch(payload)
        elif kind in ("stop", "leave") and node in ("", self.name):
            if self.name in self._mesh.doomed:
                self._time.after(self._mesh.doomed.pop(self.name), self.kill)
            self.protocol.receive_stop(key, payload)
        elif kind == "counts" and isinstance(self.protocol, DriverProtocol):
            self.protocol.receive_counts(node, payload)

    # -- what happens to it ------------------------------------------------------------------------------------------

    def suspend(self) -> None:
        """Suspend it, with all its threads."""
        self._suspended = True

    def resume(self) -> None:
        """Let it go on."""
        if self._suspended:
            self._suspended = False
            for receive, arguments in list(self._arrived):
                self.take_in(receive, *arguments)
            self._arrived.clear()
            self._put_off()

    def fill(self) -> None:
        """Leave room for a few messages of each source only."""
        self.inbox.room = _NearlyFull(_FULL)

    def terminate(self) -> None:
        """Have it finish, as SIGTERM does."""
        self.arrive_event(("stop", "terminated"))

    def orphan(self) -> None:
        """Close its standard input: the launcher is gone."""
        self.arrive_event(("stop", "orphaned"))
        self._time.after(ORPHAN_GRACE_S, self._leave)

    def _leave(self) -> None:
        if self.alive:
            self.end(ORPHANED)

    def kill(self) -> None:
        """Kill it: what it has just sent may be lost, from some message on."""
        if self.alive:
            self.lost_after_ns = self._time.now_ns + self._time.delay_ns()
            self.end(KILLED)

    def end(self, code: int) -> None:
        """End it, with an exit code."""
        self.alive = False
        self.exit = code
        self._mesh.token(self, False)

    # -- actions -----------------------------------------------------------------------------------------------------

    def subscribe(self, key: str) -> None:
        self.subscribed_ns = max(self.subscribed_ns, self._network.subscribe(self, key))

    def declare(self, key: str, message: str) -> None:
        self.declared_ns[key] = self._time.now_ns + self._time.delay_ns()

    def undeclare(self, key: str) -> None:
        del self.declared_ns[key]

    def unmatched(self, keys: Collection[str]) -> set[str]:
        unmatched = {key for key in keys if not self._network.matched(self, key)}
        for key in sorted(unmatched):
            self._network.tell_matched(self, key)
        return unmatched

    def publish(self, key: str, payload: bytes, attachment: bytes) -> None:
        if key not in self.declared_ns:
            raise LookupError(f"{self.name} publishes on {key} without a publisher")
        _, epoch, step = ATTACHMENT.unpack(attachment)
        self._mesh.note_published(self, key, payload, step)
        self._network.publish(self, key, payload, epoch, step)

    def control(self, key: str, payload: bytes) -> None:
        kind = key.partition("/")[0]
        if kind in ("act", "failed"):
            self._network.send(*((self, key), self.name, "", self._mesh.launcher.arrive_control, self, key, payload))
        elif kind == "counts":
            if (driver := self._mesh.driver) is not None:
                stream, least_ns = (self, key, driver), self._network.newest_ns(("alive", self.name, driver))
                arrive = driver.arrive_control
                self._network.send(stream, self.name, driver.name, arrive, self, key, payload, least_ns=least_ns)
        else:
            if kind == "stop":
                self._mesh.note_stop(self, payload.decode())
            self._network.broadcast(self, key, payload)

    def ask_drained(self, node: str, key: str) -> None:
        """The question is in the stream of the messages of its key."""
        query = DrainQuery(self, key)
        self._time.after(DRAIN_TIMEOUT_S, query.finish, False)
        target = self._mesh.current(node)
        if target is not None:
            receive = target.protocol.receive_drain
            self._network.send(*((self, key, target), self.name, node, target.take_in, receive, query, key.encode()))

    def answer(self, query: Any, payload: bytes | None) -> None:
        if isinstance(query, DrainQuery):
            self._network.send(*((self, query), self.name, query.asker.name, query.finish, payload is not None))
        else:
            self._network.send((self, query), self.name, "", query, payload)

    def appear(self) -> None:
        """The token follows the declarations."""
        self._mesh.token(self, True)

    def hand_in(self, results: bytes) -> None:
        answered: list[str | None] = []

        def finish(refusal: str | None) -> None:
            if not answered:
                answered.append(refusal)
                self.arrive_event(("handed_in", refusal))

        launcher = self._mesh.launcher
        self._network.send((self, "result"), self.name, "", launcher.arrive_result, self, results, finish)
        self._time.after(OFFER_TIMEOUT_S if launcher.alive else 0.01, finish, None)


class SimulatedChild(Child):
    """A node of the supervisor, with its current process; None while it is starting."""

    def __init__(self, name: str, spec: NodeSpec) -> None:
        super().__init__(name, spec)
        self.process: SimulatedProcess | None = None
        self.starts = 0
        self.code: int | None = None  # of a process that has ended before it had joined

    @property
    def exit(self) -> int | None:
        return self.process.exit if self.process else self.code

    def where(self) -> dict[str, Any]:
        return {}


class SimulatedSupervisor(Supervisor[SimulatedChild]):
    """Starts simulated processes, each a moment after it was asked to."""

    def __init__(self, mesh: SimulatedMesh) -> None:
        super().__init__()
        self._mesh = mesh

    def start(self, name: str, spec: NodeSpec) -> None:
        self.children[name] = SimulatedChild(name, spec)
        self._begin(self.children[name])

    def _restart(self, child: SimulatedChild) -> None:
        self._begin(child)

    def _begin(self, child: SimulatedChild) -> None:
        child.process = child.code = None
        child.starts += 1
        number, mesh = child.starts, self._mesh
        time, start_s = mesh.time, mesh.world.start_s

        def begin() -> None:
            if child.starts == number and child.code is None and mesh.launcher.alive:
                # A process reads the scenario when it starts, not when it was asked to.
                resolved = mesh.launcher.state.resolved_for(child.name)
                if child.name not in resolved.nodes:  # its insertion has been given up
                    child.code = KILLED
                    return
                try:
                    child.process = SimulatedProcess(mesh, child.name, resolved, number)
                except Exception as error:  # of the node's own `__init__`
                    child.code = CRASHED
                    child.notes.append(f"{type(error).__name__}: {error}")

        time.after(start_s * (1.0 + time.random.random()), begin)

    def end_now(self, child: SimulatedChild) -> None:
        if child.process is None:
            child.code = KILLED
        else:
            child.process.kill()

    def _suspend(self, child: SimulatedChild) -> None:
        if child.process is not None:
            child.process.suspend()

    def _resume(self, children: Iterable[SimulatedChild]) -> None:
        for child in children:
            if child.process is not None:
                child.process.resume()

    def dispose(self, child: SimulatedChild) -> None:
        """See Supervisor."""

    def end(self, grace_s: float) -> None:
        for child in self.running():
            self.end_now(child)
