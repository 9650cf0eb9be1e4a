"""Simulated processes of nodes, the supervisor that starts and ends them, and what they find around them."""

from __future__ import annotations

import hashlib
import logging
import traceback
from collections import Counter, defaultdict, deque
from collections.abc import Callable, Collection, Iterable
from contextlib import nullcontext
from typing import Any, Protocol

from mast_zenoh.config.resolved import NodeSpec, Resolved
from mast_zenoh.launch.launcher_protocol import RunState
from mast_zenoh.launch.supervisor import Child, Supervisor
from mast_zenoh.mesh.control.codec import Signatures
from mast_zenoh.mesh.control.flow import StopKind
from mast_zenoh.mesh.protocol import events
from mast_zenoh.mesh.protocol.driver import DriverProtocol, protocol_of
from mast_zenoh.mesh.protocol.events import (
    DOZE_S,
    DRAIN_TIMEOUT_S,
    OFFER_TIMEOUT_S,
    ORPHAN_GRACE_S,
    Actions,
    Clocks,
)
from mast_zenoh.mesh.protocol.node import CLOCK
from mast_zenoh.mesh.protocol.traffic import ATTACHMENT, EventInbox, Item, ProcessContext
from mast_zenoh.mesh.waiting import Limit, Room
from mast_zenoh.messages import codec
from mast_zenoh.testing.simulation.network import SimulatedNetwork, VirtualTime
from mast_zenoh.testing.simulation.world import Schedule, SimulatedWorld

_FOREVER = 1 << 62
CLOCK_ORIGIN_NS = 86_400 * 10**9  #: what a node's clock reads as a run begins: any number, so nothing may rely on it
_FULL = Limit(6, 1 << 20)  # of an inbox that is filled
_UNHEARD = 3  # frames in a row without a node that is there

KILLED, ORPHANED, CRASHED = -9, 3, 1  #: exit codes


class LauncherEnd(Protocol):
    """The launcher, as far as processes know it; see simulation.SimulatedLauncher."""

    alive: bool
    state: RunState

    def arrive_control(self, source: SimulatedProcess, key: str, payload: bytes) -> None:
        """Let a control message of a node arrive."""

    def arrive_part(self, part: bytes) -> None:
        """Let a part of a node's table arrive, before its results."""

    def arrive_result(self, source: SimulatedProcess, results: bytes, answer: Callable[[str | None], None]) -> None:
        """Let results of a node arrive, and answer."""

    def arrive_clock(self, frame: int) -> None:
        """Let the clock of a frame arrive."""

    def arrive_token(self, node: str, present: bool) -> None:
        """Let a change of a node's token arrive."""


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
            self.asker.arrive_event(events.DrainedEvent(self.key, ok))


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
        self.inbox = EventInbox(self._put, nullcontext())
        clocks = Clocks(lambda: CLOCK_ORIGIN_NS + time.now_ns, lambda: 0.0)
        context = ProcessContext(self, self.inbox, clocks, f"{name} {number}", Signatures(mesh.run))
        self.protocol = protocol_of(resolved, name, world.build(name, resolved.nodes[name]), context)
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
            if isinstance(event, events.MessageEvent):
                self._network.in_transit[self, event.epoch] -= 1
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

    def receive_message(self, message: events.MessageEvent) -> None:
        """Receive a message of a wire."""
        if not self.protocol.receive_message(message):
            self._network.in_transit[self, message.epoch] -= 1

    def arrive_event(self, event: events.Event) -> None:
        """Let an event arrive."""
        self.take_in(self.inbox.put, event)

    def arrive_control(self, source: SimulatedProcess | None, key: str, payload: bytes) -> None:
        """Let a control message arrive."""
        if source is None or self._time.now_ns <= source.lost_after_ns:
            self.take_in(self._receive_control, key, payload)

    def _receive_control(self, key: str, payload: bytes) -> None:
        receivers = self.protocol.receivers()
        receive = receivers.get(key) or receivers.get(key.partition("/")[0] + "/*")
        if receive == self.protocol.receive_stop and self.name in self._mesh.doomed:
            self._time.after(self._mesh.doomed.pop(self.name), self.kill)
        if receive is not None:
            receive(key, payload)

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
        self.arrive_event(events.StopEvent("terminated"))

    def orphan(self) -> None:
        """Close its standard input: the launcher is gone."""
        self.arrive_event(events.StopEvent("orphaned"))
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
        self._network.publish(self, events.MessageEvent(key, payload, epoch, step))

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

    def hand_in_part(self, part: bytes) -> None:
        if self._mesh.launcher.alive:
            self._mesh.launcher.arrive_part(part)

    def hand_in(self, results: bytes) -> None:
        answered: list[str | None] = []

        def finish(refusal: str | None) -> None:
            if not answered:
                answered.append(refusal)
                self.arrive_event(events.HandedInEvent(refusal))

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
    def cpu_s(self) -> float:
        """Computing takes no virtual time."""
        return 0.0

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

    def end(self, grace_s: float) -> None:
        for child in self.running():
            self.end_now(child)


class SimulatedMesh:
    """What processes and launcher find around them: virtual time, the network, each other, and a watch on promises.

    run:    its id;  silent_log: a logger that writes nothing
    driver: its process, once it has joined;  doomed: nodes that are killed some time after a stop reaches them, s
    violations: broken promises;  streams: digest of the messages of each key
    """

    launcher: LauncherEnd

    def __init__(self, world: SimulatedWorld, schedule: Schedule) -> None:
        self.world = world
        self.run = "simulated"
        self.silent_log = logging.Logger("simulated", logging.CRITICAL + 1)
        self.lockstep = world.resolved.mode == "lockstep"
        self.time = VirtualTime(schedule)
        self.network = SimulatedNetwork[SimulatedProcess](self.time, schedule, realtime=not self.lockstep)
        self.violations: list[str] = []
        self.driver: SimulatedProcess | None = None
        self.frame = -1  # the newest
        self._tokens: dict[str, SimulatedProcess] = {}
        self._known: dict[str, SimulatedProcess] = {}  # by node, the process whose token the driver has noted
        self._token_arrived: dict[str, SimulatedProcess | None] = {}  # the same for tokens that it has received
        self.doomed: dict[str, float] = {}
        self.streams = defaultdict[str, Any](hashlib.sha256)
        self._unheard: Counter[str] = Counter()  # frames in a row that began without a node that is there

    def running(self) -> list[SimulatedProcess]:
        """The processes that run."""
        return [process for process in self.network.processes if process.alive]

    def current(self, node: str) -> SimulatedProcess | None:
        """The running process of a node."""
        return next((process for process in self.network.processes if process.name == node and process.alive), None)

    def violate(self, sentence: str) -> None:
        """Note a broken promise."""
        self.violations.append(f"{self.time.now_ns * 1e-9:.4f} s: {sentence}")

    def handle(self, process: SimulatedProcess, event: events.Event | None) -> None:
        """Have a process handle an event."""
        if isinstance(event, events.PresenceEvent):
            arrived = self._token_arrived.get(event.node)
            self._known.pop(event.node, None)
            if arrived is not None:
                self._known[event.node] = arrived
        elif isinstance(event, events.EpochEvent) and not process.protocol.epoch:
            process.joined_frame = self.frame
        process.protocol.handle(event)

    def token(self, process: SimulatedProcess, present: bool) -> None:
        """Have a process's token appear, after its declarations, or go: for the driver and for the launcher."""
        name = process.name
        least_ns = process.subscribed_ns if present else self.network.noticed_ns(name)
        if present:
            self._tokens[name] = process
        else:
            self._tokens.pop(name, None)
        self.network.send(("alive", name), "", "", self.launcher.arrive_token, name, present, least_ns=least_ns)
        if self.driver is not None:
            self._tell_driver(self.driver, process, present)
        elif isinstance(process.protocol, DriverProtocol):
            self.driver = process
            for there in self._tokens.values():
                self._tell_driver(process, there, True)

    def _tell_driver(self, driver: SimulatedProcess, process: SimulatedProcess, present: bool) -> None:
        """Have a token appear or go; what goes is noticed by the router, whatever the link of its process does."""
        name = process.name

        def arrive() -> None:
            self._token_arrived[name] = process if present else None
            assert isinstance(driver.protocol, DriverProtocol)
            driver.protocol.receive_presence(name, present)

        stream = ("alive", name, driver)
        source, least_ns = (name, process.subscribed_ns) if present else ("", self.network.noticed_ns(name))
        self.network.send(stream, source, driver.name, lambda: driver.take_in(arrive), least_ns=least_ns)

    def note_published(self, process: SimulatedProcess, key: str, payload: bytes, step: int) -> None:
        """Check what must hold when a message is published, and when a frame begins."""
        self.streams[key].update(payload)
        if key == "clock" and isinstance(process.protocol, DriverProtocol):
            self.frame = step
            self.network.send((process, "clock", "launcher"), process.name, "", self.launcher.arrive_clock, step)
            if self.lockstep:
                self._check_frame(process.protocol, codec.decode_header(payload, "clock").frame)
        elif self.lockstep and step <= process.joined_frame:
            self.violate(f"{process.name} publishes for frame {step}, which had begun when it joined")

    def _check_frame(self, driver: DriverProtocol, frame: int) -> None:
        for process in self.running():
            name = process.name
            if name == driver.name or name not in driver.members or not process.publishes:
                continue
            waiting = self.network.in_transit[process, driver.epoch]
            if waiting:
                self.violate(f"frame {frame} begins with {waiting} messages on the way to {name}")
            if process.protocol.epoch != driver.epoch and self._known.get(name) is process:
                self.violate(f"frame {frame} begins although {name} has not entered epoch {driver.epoch}")
        for name in self._outside(driver):
            self._unheard[name] += 1
            if self._unheard[name] == _UNHEARD and self._known[name].publishes:
                self.violate(f"frame {frame} begins, the {_UNHEARD}rd one without {name}, which is there")

    def note_stop(self, process: SimulatedProcess, reason: str) -> None:
        """Check what must hold when the driver ends a run in lock-step."""
        if self.lockstep and reason == StopKind.END.value and isinstance(process.protocol, DriverProtocol):
            for name in self._outside(process.protocol):
                if self._unheard[name]:
                    self.violate(f"the run ends without {name}, which was there when the last frame began")

    def _outside(self, driver: DriverProtocol) -> list[str]:
        """The nodes whose tokens the driver has noted, and which are not in its epoch."""
        outside = [
            name
            for name, process in self._known.items()
            if process.alive and name in driver.membership.expected and process.protocol.epoch != driver.epoch
        ]
        self._unheard = Counter({name: self._unheard[name] for name in outside})
        return outside
