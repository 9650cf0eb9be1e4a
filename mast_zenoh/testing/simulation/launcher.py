"""The simulated launcher: the launcher's own protocol, looked at every 10 ms of virtual time."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from typing import Any

from mast_zenoh.config.resolved import DRIVER_ROLE, Resolved
from mast_zenoh.control import failures, flow
from mast_zenoh.control.interception import Intercept, Release
from mast_zenoh.control.results import decode_part, decode_result
from mast_zenoh.control.signatures import Signatures
from mast_zenoh.control.tables import PartedTables
from mast_zenoh.errors import MessageError
from mast_zenoh.launch.launcher_protocol import DRIVER_TIMEOUT_S, LauncherActions, LauncherProtocol, Report, RunState
from mast_zenoh.runtime.protocol.driver import DriverProtocol
from mast_zenoh.testing.simulation.processes import SimulatedMesh, SimulatedProcess, SimulatedSupervisor

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
