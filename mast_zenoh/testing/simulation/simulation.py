"""Plays a whole run, launcher included, in one thread and in virtual time."""

from __future__ import annotations

import hashlib
import logging
from collections import Counter, defaultdict
from dataclasses import dataclass, field
from typing import Any

from mast_zenoh.control.failures import Entry
from mast_zenoh.control.flow import StopKind
from mast_zenoh.control.interception import Release
from mast_zenoh.launch.launcher_protocol import churn_of
from mast_zenoh.messages import codec
from mast_zenoh.runtime.protocol.driver import DriverProtocol
from mast_zenoh.runtime.protocol.traffic import Event
from mast_zenoh.testing.simulation.launcher import SimulatedLauncher
from mast_zenoh.testing.simulation.network import LEASE_NS, Network, S, VirtualTime
from mast_zenoh.testing.simulation.processes import SimulatedMesh, SimulatedProcess
from mast_zenoh.testing.simulation.world import Disturbance, Schedule, World

LONGEST_S = 400.0  #: virtual time by which every run has ended
_UNHEARD = 3  # frames in a row without a node that is there


@dataclass
class Outcome:
    """How a simulated run has ended.

    ended:   whether it has;  launcher_lost: whether the launcher was killed
    error:   class name and text of the run's error; "" for none
    results: of each node's `finish`; frames: number played;  churn: lost and returned nodes
    died:    nodes of which a process did not end by itself
    lost:    nodes that ended without results, with how; not those that the scenario or an interception ended
    rejected: numbers of rejected messages, by node
    failures: of handlers, by node, see control.failures
    notes:   lines that the launcher showed;  seconds: of virtual time;  events: number of calls that were played
    missed:  disturbances that met nothing: after the end, or when their process was not there
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
    died: set[str]
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
    missed: list[Disturbance]
    violations: list[str] = field(default_factory=list)

    def claims_to_be_exact(self, undisturbed: Outcome | None = None) -> bool:
        """Whether nothing in its record says that it differs from the undisturbed run; None: which rejects nothing."""
        complete = self.ended and not self.launcher_lost and not self.error
        rejected = {name: counts for name, counts in self.rejected.items() if counts}
        expected = {name: counts for name, counts in undisturbed.rejected.items() if counts} if undisturbed else {}
        return complete and not self.churn and not self.lost and rejected == expected


class Simulation(SimulatedMesh):
    """One run of a world with a schedule."""

    launcher: SimulatedLauncher

    def __init__(self, world: World, schedule: Schedule) -> None:
        resolved = world.resolved
        self.world = world
        self.run = "simulated"
        self.silent_log = logging.Logger("simulated", logging.CRITICAL + 1)
        self.lockstep = resolved.mode == "lockstep"
        self.time = VirtualTime(schedule)
        self.network = Network[SimulatedProcess](self.time, schedule, realtime=not self.lockstep)
        self.violations: list[str] = []
        self.driver: SimulatedProcess | None = None
        self.frame = -1  # the newest
        self.launcher = SimulatedLauncher(self)
        self._tokens: dict[str, SimulatedProcess] = {}
        self._known: dict[str, SimulatedProcess] = {}  # by node, the process whose token the driver has noted
        self._token_arrived: dict[str, SimulatedProcess | None] = {}  # the same for tokens that it has received
        self.doomed: dict[str, float] = {}
        self._streams = defaultdict[str, Any](hashlib.sha256)
        self._unheard: Counter[str] = Counter()  # frames in a row that began without a node that is there
        self._pending: list[Disturbance | None] = list(schedule.disturbances)
        for number, disturbance in enumerate(schedule.disturbances):
            self.time.after(disturbance.at_s, self._disturb, number)

    def play(self) -> Outcome:
        """Play the run to its end."""
        self.launcher.begin()
        resolved = self.world.resolved
        most = 20_000 + 1_000 * resolved.frames * len(resolved.nodes)
        ended = self.time.run(round(LONGEST_S * S), most, self._is_over)
        if not ended:
            running = [f"{process.name} ({process.protocol.state.value})" for process in self._running()]
            longest = f"{LONGEST_S:g} s, or {most} events"
            self.violate(f"the run has not ended after {longest}: {', '.join(running)}")
        launcher = self.launcher
        driver = next((outcome for outcome in launcher.outcomes.values() if "sent_ns" in outcome), {})
        problem = launcher.state.stop.problem
        children = launcher.supervisor.children.values()
        return Outcome(
            ended=ended,
            launcher_lost=not launcher.alive,
            error=f"{type(problem).__name__}: {problem}" if problem else "",
            results={name: outcome["results"] for name, outcome in launcher.outcomes.items()},
            frames=driver.get("frames", 0),
            churn=churn_of(launcher.outcomes, launcher.state) if driver else [],
            died={process.name for process in self.network.processes if process.exit},
            lost={child.name: child.ended for child in children if not child.handed_in and not child.exit_expected},
            rejected={name: outcome["rejected"] for name, outcome in launcher.outcomes.items()},
            failures={name: outcome["failures"] for name, outcome in launcher.outcomes.items() if outcome["failures"]},
            changes=launcher.changes,
            refused=launcher.refused,
            notes=launcher.notes,
            seconds=self.time.now_ns * 1e-9,
            events=self.time.played,
            streams={key: stream.digest() for key, stream in self._streams.items()},
            on_the_way=sum(self.network.in_transit.values()),
            missed=[disturbance for disturbance in self._pending if disturbance is not None]
            + [Disturbance(0.0, "kill at stop", node, seconds) for node, seconds in self.doomed.items()],
            violations=self.violations,
        )

    def _is_over(self) -> bool:
        return self.launcher.over or (not self.launcher.alive and not self._running())

    def _running(self) -> list[SimulatedProcess]:
        return [process for process in self.network.processes if process.alive]

    def current(self, node: str) -> SimulatedProcess | None:
        return next((process for process in self.network.processes if process.name == node and process.alive), None)

    def violate(self, sentence: str) -> None:
        self.violations.append(f"{self.time.now_ns * 1e-9:.4f} s: {sentence}")

    # -- what the processes do ---------------------------------------------------------------------------------------

    def handle(self, process: SimulatedProcess, event: Event | None) -> None:
        if event is not None and event[0] == "alive":
            arrived = self._token_arrived.get(event[1])
            self._known.pop(event[1], None)
            if arrived is not None:
                self._known[event[1]] = arrived
        elif event is not None and event[0] == "epoch" and not process.protocol.epoch:
            process.joined_frame = self.frame
        process.protocol.handle(event)

    def token(self, process: SimulatedProcess, present: bool) -> None:
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

    def _disturb(self, number: int) -> None:
        disturbance = self._pending[number]
        assert disturbance is not None
        _, kind, node, seconds = disturbance
        launcher = self.launcher
        if launcher.over:
            return
        self._pending[number] = None
        if kind == "suspend launcher":
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
        else:
            self._pending[number] = disturbance

    def _disturb_process(self, process: SimulatedProcess, kind: str, seconds: float) -> None:
        if kind == "kill":
            process.kill()
        elif kind == "fill":
            process.fill()
        elif kind in ("suspend", "freeze"):
            process.suspend()
            self.time.after(seconds, process.resume)
        elif kind == "cut" and self.network.cut(process.name, seconds):
            self.time.after(LEASE_NS / S, self._expire, process)
            self.time.after(seconds, self._reconnect, process)

    def _expire(self, process: SimulatedProcess) -> None:
        if process.alive:
            self.token(process, False)

    def _reconnect(self, process: SimulatedProcess) -> None:
        if process.alive:
            self.token(process, True)


def play(world: World, schedule: Schedule) -> Outcome:
    """Play a world with a schedule; raises ConfigurationError for one with a node that the world does not have."""
    schedule.check(world)
    return Simulation(world, schedule).play()
