"""Plays a whole run, launcher included, in one thread and in virtual time."""

from __future__ import annotations

import hashlib
import logging
from collections import Counter, defaultdict
from dataclasses import dataclass, field
from typing import Any

from mast_zenoh.control.failures import Entry
from mast_zenoh.control.interception import Release
from mast_zenoh.control.stop_reasons import StopKind
from mast_zenoh.launch.protocol.endings import losses_unseen_by_driver
from mast_zenoh.messages import codec
from mast_zenoh.runtime.protocol.driver import DriverProtocol
from mast_zenoh.runtime.protocol.inbox import Event
from mast_zenoh.testing.simulation.launcher import SimulatedLauncher
from mast_zenoh.testing.simulation.network import LEASE_NS, Events, Network, S
from mast_zenoh.testing.simulation.processes import SimulatedMesh, SimulatedProcess
from mast_zenoh.testing.simulation.schedule import Disturbance, Schedule
from mast_zenoh.testing.simulation.world import World

LONGEST_S = 400.0  #: virtual time by which every run has ended
_UNHEARD = 3  # frames in a row without a node that is there


@dataclass
class Outcome:
    """How a simulated run has ended.

    ended:   whether it has;  launcher_lost: whether the launcher was killed
    error:   class name and text of the run's error; "" for none
    results: of each node's `finish`; frames: number played;  churn: lost and returned nodes
    lost:    nodes that ended without results, with how; not those that the scenario or an interception ended
    rejected: numbers of rejected messages, by node
    failures: of handlers, by node, see control.failures
    changes, refused: changes of the wiring, and requests that were refused
    streams: digest of all messages sent on each key, in their order
    on_the_way: number of messages that had not arrived when the run ended
    violations: broken promises that were seen while it was played
    """

    ended: bool
    launcher_lost: bool
    error: str
    results: dict[str, dict[str, Any]]
    frames: int
    churn: list[dict[str, Any]]
    lost: dict[str, str]
    rejected: dict[str, dict[str, int]]
    failures: dict[str, list[Entry]]
    changes: list[dict[str, Any]]
    refused: list[str]
    notes: list[str]
    seconds: float
    events: int
    streams: dict[str, bytes]
    on_the_way: int
    violations: list[str] = field(default_factory=list)

    @property
    def claims_to_be_exact(self) -> bool:
        """Whether nothing in its record says that it differs from an undisturbed run."""
        complete = self.ended and not self.launcher_lost and not self.error
        return complete and not (self.churn or self.lost or any(self.rejected.values()))


class Simulation(SimulatedMesh):
    """One run of a world with a schedule."""

    launcher: SimulatedLauncher

    def __init__(self, world: World, schedule: Schedule) -> None:
        resolved = world.resolved
        self.world = world
        self.run = "simulated"
        self.quiet = logging.Logger("simulated", logging.CRITICAL + 1)
        self.lockstep = resolved.mode == "lockstep"
        self.events = Events(schedule)
        self.network = Network[SimulatedProcess](self.events, schedule, patient=self.lockstep, lossy=not self.lockstep)
        self.violations: list[str] = []
        self.trace: list[str] | None = None
        self.driver: SimulatedProcess
        self.frame = -1  # the newest
        self.launcher = SimulatedLauncher(self)
        self._tokens: dict[str, SimulatedProcess] = {}
        self._known: dict[str, SimulatedProcess] = {}  # by node, the process whose token the driver has noted
        self._token_arrived: dict[str, SimulatedProcess | None] = {}  # the same for tokens that it has received
        self.doomed: dict[str, float] = {}
        self._streams = defaultdict[str, Any](hashlib.sha256)
        self._unheard: Counter[str] = Counter()  # frames in a row that began without a node that is there
        for disturbance in schedule.disturbances:
            self.events.after(disturbance.at_s, self._disturb, disturbance)

    def play(self) -> Outcome:
        """Play the run to its end."""
        self.launcher.begin()
        ended = self.events.run(round(LONGEST_S * S), self._is_over)
        if not ended:
            running = [f"{process.name} ({process.protocol.state.value})" for process in self._running()]
            self.violate(f"the run has not ended after {LONGEST_S:g} s: {', '.join(running)}")
        launcher = self.launcher
        driver = next((each for each in launcher.outcomes.values() if "sent_ns" in each), {})
        problem = launcher.state.stop.problem
        children = launcher.supervisor.children.values()
        frames = driver.get("frames", 0)
        restarted = [child.name for child in children if child.restarts]
        return Outcome(
            ended=ended,
            launcher_lost=not launcher.alive,
            error=f"{type(problem).__name__}: {problem}" if problem else "",
            results={name: outcome["results"] for name, outcome in launcher.outcomes.items()},
            frames=frames,
            churn=driver.get("churn", []) + losses_unseen_by_driver(launcher.outcomes, restarted, frames),
            lost={child.name: child.ended for child in children if not child.handed_in and not child.exit_expected},
            rejected={name: outcome["rejected"] for name, outcome in launcher.outcomes.items()},
            failures={name: outcome["failures"] for name, outcome in launcher.outcomes.items() if outcome["failures"]},
            changes=launcher.changes,
            refused=launcher.refused,
            notes=launcher.notes,
            seconds=self.events.now_ns * 1e-9,
            events=self.events.played,
            streams={key: stream.digest() for key, stream in self._streams.items()},
            on_the_way=sum(self.network.in_transit.values()),
            violations=self.violations,
        )

    def _is_over(self) -> bool:
        return self.launcher.over or (not self.launcher.alive and not self._running())

    def _running(self) -> list[SimulatedProcess]:
        return [process for process in self.network.processes if process.alive]

    def current(self, node: str) -> SimulatedProcess | None:
        """See SimulatedMesh."""
        return next((process for process in self.network.processes if process.name == node and process.alive), None)

    def violate(self, sentence: str) -> None:
        """See SimulatedMesh."""
        self.violations.append(f"{self.events.now_ns * 1e-9:.4f} s: {sentence}")

    # -- what the processes do ---------------------------------------------------------------------------------------

    def handle(self, process: SimulatedProcess, event: Event | None) -> None:
        """See SimulatedMesh."""
        if self.trace is not None:
            self.trace.append(f"{self.events.now_ns * 1e-9:.4f} {process.name}: {_described(event)}")
        if event is not None and event[0] == "alive":
            arrived = self._token_arrived.get(event[1])
            self._known.pop(event[1], None)
            if arrived is not None:
                self._known[event[1]] = arrived
        elif event is not None and event[0] == "epoch" and not process.protocol.epoch:
            process.joined_frame = self.frame
        process.protocol.handle(event)

    def token(self, process: SimulatedProcess, present: bool) -> None:
        """See SimulatedMesh."""
        name, least_ns = process.name, process.subscribed_ns
        if present:
            self._tokens[name] = process
        else:
            self._tokens.pop(name, None)
        self.network.send(("alive", name), "", "", self.launcher.arrive_token, name, present, least_ns=least_ns)
        if hasattr(self, "driver"):
            self._tell_driver(process, present)
        elif isinstance(process.protocol, DriverProtocol):
            self.driver = process
            for there in self._tokens.values():
                self._tell_driver(there, True)

    def _tell_driver(self, process: SimulatedProcess, present: bool) -> None:
        name, driver = process.name, self.driver

        def arrive() -> None:
            self._token_arrived[name] = process if present else None
            assert isinstance(driver.protocol, DriverProtocol)
            driver.protocol.receive_presence(name, present)

        stream = ("alive", name, driver)
        least_ns = process.subscribed_ns
        self.network.send(stream, name, driver.name, lambda: driver.take_in(arrive), least_ns=least_ns)

    def note_published(self, process: SimulatedProcess, key: str, payload: bytes, step: int) -> None:
        """See SimulatedMesh."""
        self._streams[key].update(payload)
        if key == "clock" and isinstance(process.protocol, DriverProtocol):
            self.frame = step
            self.network.send((process, "clock", "launcher"), process.name, "", self.launcher.arrive_clock, step)
            if self.lockstep:
                self._check_frame(process.protocol, codec.decode_header(payload, "clock").frame)
        elif self.lockstep and step <= process.joined_frame:
            self.violate(f"{process.name} publishes for frame {step}, which had begun when it joined")

    def _check_frame(self, driver: DriverProtocol, frame: int) -> None:
        for process in self._running():
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
        """See SimulatedMesh."""
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

    # -- disturbances ------------------------------------------------------------------------------------------------

    def _disturb(self, disturbance: Disturbance) -> None:
        _, kind, node, seconds = disturbance
        launcher = self.launcher
        if launcher.over:
            return
        if kind == "stop launcher":
            launcher.suspend(seconds)
        elif kind == "lose launcher":
            launcher.kill()
        elif kind == "interrupt":
            launcher.state.signals.append(2)
        elif kind == "kill at stop":
            self.doomed[node] = seconds
        elif kind == "intercept":
            launcher.request(next(request for request in self.world.requests if request.name == node))
        elif kind == "release":
            launcher.request(Release(node, None))
        elif (process := self.current(node)) is not None:
            self._disturb_process(process, kind, seconds)

    def _disturb_process(self, process: SimulatedProcess, kind: str, seconds: float) -> None:
        if kind == "kill":
            process.kill()
        elif kind == "fill":
            process.fill()
        elif kind in ("stop", "freeze"):
            process.suspend()
            self.events.after(seconds, process.resume)
        elif kind == "cut" and self.network.cut(process.name, seconds):
            self.events.after(LEASE_NS / S, self.token, process, False)
            self.events.after(seconds, self._reconnect, process)

    def _reconnect(self, process: SimulatedProcess) -> None:
        if process.alive:
            self.token(process, True)


def _described(event: Event | None) -> str:
    if event is None:
        return "time"
    if event[0] == "message":
        return f"message {event[1]} epoch {event[3]} step {event[4]}"
    return " ".join(map(str, event))[:200]


def play(world: World, schedule: Schedule) -> Outcome:
    """Play a world with a schedule; raises ConfigurationError for one with a node that the world does not have."""
    schedule.check(world)
    return Simulation(world, schedule).play()
