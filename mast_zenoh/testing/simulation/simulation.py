"""Plays a whole run, launcher included, in one thread and in virtual time."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

from mast_zenoh.config.resolved import DRIVER_ROLE, Resolved
from mast_zenoh.errors import MessageError
from mast_zenoh.launch.launcher_protocol import (
    DRIVER_TIMEOUT_S,
    LauncherActions,
    LauncherProtocol,
    Report,
    RunState,
    churn_of,
)
from mast_zenoh.mesh.control import failures, flow
from mast_zenoh.mesh.control.codec import Signatures
from mast_zenoh.mesh.control.failures import Entry
from mast_zenoh.mesh.control.interception import Intercept, Release
from mast_zenoh.mesh.control.results import PartedTables, decode_part, decode_result
from mast_zenoh.mesh.protocol.driver import DriverProtocol
from mast_zenoh.testing.simulation.network import LEASE_NS, S
from mast_zenoh.testing.simulation.processes import SimulatedMesh, SimulatedProcess, SimulatedSupervisor
from mast_zenoh.testing.simulation.world import Disturbance, Schedule, SimulatedWorld

LONGEST_S = 400.0  #: virtual time by which every run has ended


@dataclass
class SimulationOutcome:
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

    def claims_to_be_exact(self, undisturbed: SimulationOutcome | None = None) -> bool:
        """Whether nothing in its record says that it differs from the undisturbed run; None: which rejects nothing."""
        complete = self.ended and not self.launcher_lost and not self.error
        rejected = {name: counts for name, counts in self.rejected.items() if counts}
        expected = {name: counts for name, counts in undisturbed.rejected.items() if counts} if undisturbed else {}
        return complete and not self.churn and not self.lost and rejected == expected


_POLL_S = 0.01


class SimulatedLauncher(LauncherActions):
    """Starts the nodes, watches them to the end, and takes their results.

    alive: whether it has not been killed;  over: whether the run is over
    outcomes: what each node has handed in;  notes: what it showed
    changes:  changes of the wiring;  refused: requests for them that were refused, with the reason
    """

    def __init__(self, mesh: SimulatedMesh) -> None:
        resolved = mesh.world.resolved
        self._mesh = mesh
        self._time = mesh.time
        self.alive = True
        self.over = False
        self.outcomes: dict[str, dict[str, Any]] = {}
        self.notes: list[str] = []
        self.changes: list[dict[str, Any]] = []
        self.refused: list[str] = []
        self.state = RunState(resolved, self.notes.append, lambda: mesh.time.now_ns * 1e-9)
        self.supervisor = SimulatedSupervisor(mesh)
        self.protocol = LauncherProtocol(self.state, self.supervisor, self)
        self.interceptions = self.protocol.interceptions
        self._waiting: deque[tuple[SimulatedProcess, bytes | None, bytes]] = deque()  # failures, results
        self._tables: dict[str, PartedTables] = {}  # by process
        self._acts: deque[flow.Act] = deque()
        self._arrived: deque[tuple[Callable[..., object], tuple[Any, ...]]] = deque()  # while it is suspended
        self._suspended = False
        self._requests = 0

    def begin(self) -> None:
        """Start the nodes that are present from the beginning."""
        self.protocol.steps.start_all()
        self._time.after(_POLL_S, self._look)

    def _look(self) -> None:
        """One iteration of the launcher's loop."""
        if not self.alive or self.over or self._suspended:
            return
        self.over = self.protocol.advance(self._acts.popleft() if self._acts else None)
        if self.over:
            self.supervisor.end(1.0)
            self.protocol.finish()
        else:
            self._time.after(0.0 if self._acts else _POLL_S, self._look)

    def reports(self) -> Iterator[Report]:
        while self._waiting:
            process, failure, results = self._waiting.popleft()
            if failure is not None:
                yield Report(process.name, failures.decode_failure(failure)[1])
                continue
            child = self.supervisor.children.get(process.name)
            if child is None or child.process is not process or child.handed_in:
                continue
            drives = child.spec.role == DRIVER_ROLE
            self.outcomes[process.name] = outcome = decode_result(results, process.name, drives=drives)
            outcome["results"] = self._tables.pop(outcome["process"], PartedTables()).close(outcome["results"])
            child.handed_in = True
            yield Report(process.name, stop_reason=outcome.get("stop_reason"))

    # -- what arrives ------------------------------------------------------------------------------------------------

    def _take_in(self, receive: Callable[..., object], *arguments: Any) -> None:
        if self._suspended:
            self._arrived.append((receive, arguments))
        elif self.alive and not self.over:
            receive(*arguments)

    def arrive_control(self, source: SimulatedProcess, key: str, payload: bytes) -> None:
        """Let a control message of a node arrive."""
        if self._time.now_ns <= source.lost_after_ns:
            if key == "act":
                self._take_in(self._acts.append, flow.decode_act(payload))
            else:
                self._take_in(self._waiting.append, (source, payload, b""))

    def arrive_part(self, part: bytes) -> None:
        """Let a part of a node's table arrive, before its results."""
        process, (table, _, columns) = decode_part(part)
        self._tables.setdefault(process, PartedTables()).append(table, columns)

    def arrive_result(self, source: SimulatedProcess, results: bytes, answer: Callable[[str | None], None]) -> None:
        """Let results of a node arrive, and answer."""

        def take() -> None:
            self._waiting.append((source, None, results))
            self._mesh.network.send((self, source, "result"), "", source.name, answer, "")

        if self._time.now_ns <= source.lost_after_ns:
            self._take_in(take)

    def arrive_clock(self, frame: int) -> None:
        """Let the clock of a frame arrive."""
        self._take_in(setattr, self.state, "frame", frame)

    def arrive_token(self, node: str, present: bool) -> None:
        """Let a change of a node's token arrive."""
        self._take_in(self.interceptions.note_presence, node, present)

    # -- what happens to it ------------------------------------------------------------------------------------------

    def suspend(self, seconds: float) -> None:
        """Suspend it for some seconds, and the router in its process."""
        self._suspended = True
        self._mesh.network.pause(seconds)
        self._time.after(seconds, self._resume)

    def _resume(self) -> None:
        self._suspended = False
        while self._arrived:
            receive, arguments = self._arrived.popleft()
            self._take_in(receive, *arguments)
        self._look()

    def kill(self) -> None:
        """Kill it: its nodes notice."""
        self.alive = False
        for child in self.supervisor.running():
            if child.process is not None:
                child.process.orphan()

    def request(self, action: Intercept | Release) -> None:
        """Ask it for a change of the wiring, as `mast intercept` does."""
        self._requests += 1
        self.interceptions.add(action, str(self._requests), action)

    # -- actions -----------------------------------------------------------------------------------------------------

    def stop(self, reason: str) -> None:
        self._mesh.network.broadcast(None, "stop", reason.encode())

    def leave(self, node: str, reason: str) -> None:
        self._mesh.network.broadcast(None, f"leave/{node}", reason.encode())

    def rewire(self, request: bytes, answered: Callable[[bytes | None], None]) -> None:
        payload = Signatures(self._mesh.run).sign("rewire", request)
        answers: list[bytes | None] = []

        def finish(answer: bytes | None) -> None:
            if not answers:
                answers.append(answer)
                self._take_in(answered, answer)

        driver = self._mesh.driver
        self._time.after(DRIVER_TIMEOUT_S, finish, None)
        if driver is not None and driver.alive and isinstance(driver.protocol, DriverProtocol):
            receive = driver.protocol.receive_rewire
            self._mesh.network.send(*((self, "rewire"), "", driver.name, driver.take_in, receive, finish, payload))

    def answer(self, query: Any, payload: bytes) -> None:
        """See LauncherActions."""

    def refuse(self, query: Any, error: Exception) -> None:
        self.refused.append(f"{type(error).__name__}: {error}")

    def note_invalid(self, kind: str, error: MessageError) -> None:
        raise error

    def adopt(self, resolved: Resolved, joining: tuple[str, Resolved] | None) -> None:
        """Processes read the state."""

    def record(self, change: dict[str, Any]) -> None:
        self.changes.append(change)

    def last_log_line(self, node: str) -> str:
        process = self.supervisor.children[node].process
        return process.log[-1] if process and process.log else ""


class Simulation(SimulatedMesh):
    """One run of a world with a schedule."""

    launcher: SimulatedLauncher

    def __init__(self, world: SimulatedWorld, schedule: Schedule) -> None:
        super().__init__(world, schedule)
        self.launcher = SimulatedLauncher(self)
        self._pending: list[Disturbance | None] = list(schedule.disturbances)
        for number, disturbance in enumerate(schedule.disturbances):
            self.time.after(disturbance.at_s, self._disturb, number)

    def play(self) -> SimulationOutcome:
        """Play the run to its end."""
        self.launcher.begin()
        resolved = self.world.resolved
        most = 20_000 + 1_000 * resolved.frames * len(resolved.nodes)
        ended = self.time.run(round(LONGEST_S * S), most, self._is_over)
        if not ended:
            running = [f"{process.name} ({process.protocol.state.value})" for process in self.running()]
            longest = f"{LONGEST_S:g} s, or {most} events"
            self.violate(f"the run has not ended after {longest}: {', '.join(running)}")
        launcher = self.launcher
        driver = next((outcome for outcome in launcher.outcomes.values() if "sent_ns" in outcome), {})
        problem = launcher.state.stop.problem
        children = launcher.supervisor.children.values()
        return SimulationOutcome(
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
            streams={key: stream.digest() for key, stream in self.streams.items()},
            on_the_way=sum(self.network.in_transit.values()),
            missed=[disturbance for disturbance in self._pending if disturbance is not None]
            + [Disturbance(0.0, "kill at stop", node, seconds) for node, seconds in self.doomed.items()],
            violations=self.violations,
        )

    def _is_over(self) -> bool:
        return self.launcher.over or (not self.launcher.alive and not self.running())

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


def play(world: SimulatedWorld, schedule: Schedule) -> SimulationOutcome:
    """Play a world with a schedule; raises ConfigurationError for one with a node that the world does not have."""
    schedule.check(world)
    return Simulation(world, schedule).play()
