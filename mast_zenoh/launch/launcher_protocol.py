"""What the launcher decides about a run on a mesh; no Zenoh, no thread, no clock, no file."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import msgpack
from rich.markup import escape

from mast_zenoh.config.resolved import LEAVING, NodeSpec, Resolved
from mast_zenoh.errors import (
    ConfigurationError,
    ImplausibleCounts,
    MastError,
    MessageError,
    NodeDied,
    NotRunning,
    RunError,
    StallError,
    StartError,
)
from mast_zenoh.launch import ending
from mast_zenoh.launch.progress import Progress
from mast_zenoh.launch.supervisor import Child, Supervisor
from mast_zenoh.mesh.control import failures, flow
from mast_zenoh.mesh.control import interception as control
from mast_zenoh.mesh.control.failures import Entry
from mast_zenoh.mesh.control.flow import StopKind, decode_reason
from mast_zenoh.mesh.protocol.pacer import Timetable
from mast_zenoh.run_folder.recording import churn
from mast_zenoh.wiring import insertion
from mast_zenoh.wiring.insertion import InsertionPoint
from mast_zenoh.wiring.model import Wiring

DRIVER_TIMEOUT_S = 60.0  #: for the driver to answer `rewire`

#: A query that waits for an answer: of Zenoh, or of the simulated mesh.
Query = Any


class Report(NamedTuple):
    """A node's report: the first failure of a handler in its process, or its results.

    stop_reason: why the driver ended the run; None for other nodes
    """

    node: str
    failure: Entry | None = None
    stop_reason: str | None = None


class LauncherActions(ABC):
    """What the launcher's protocol asks for: carried out on the mesh, or by the simulated one."""

    @abstractmethod
    def reports(self) -> Iterable[Report]:
        """The reports of nodes since the last call, in order of arrival."""

    def last_data_s(self, node: str) -> float:
        """When the last piece of a file of a node, or part of a table, arrived, s on the monotonic clock."""
        return float("-inf")

    @abstractmethod
    def stop(self, reason: str) -> None:
        """Ask all nodes to finish."""

    @abstractmethod
    def leave(self, node: str, reason: str) -> None:
        """Ask a node to finish."""

    @abstractmethod
    def rewire(self, request: bytes, answered: Callable[[bytes | None], None]) -> None:
        """Sign a request for a change of the wiring, and send it to the driver.

        answered: called once with its answer; None: it has not answered in time
        """

    @abstractmethod
    def answer(self, query: Query, payload: bytes) -> None:
        """Answer a query."""

    @abstractmethod
    def refuse(self, query: Query, error: Exception) -> None:
        """Answer a query with an error, and count it if the request was invalid."""

    @abstractmethod
    def note_invalid(self, kind: str, error: MessageError) -> None:
        """Count an invalid control message."""

    @abstractmethod
    def adopt(self, resolved: Resolved, joining: tuple[str, Resolved] | None) -> None:
        """Have nodes that start from now on begin with this scenario.

        joining: a node that is started to be inserted, and the scenario with which it begins
        """

    @abstractmethod
    def record(self, change: dict[str, Any]) -> None:
        """Record a change of the wiring in run.json."""

    @abstractmethod
    def last_log_line(self, node: str) -> str:
        """The last line of a node's log, "" if there is none."""


@dataclass
class RunState:
    """State of one run on a mesh.

    resolved: the current scenario; an interception replaces it
    show:     prints a permanent line, with Rich markup
    now_s:    a monotonic clock, s
    signals:  stop signals received so far
    frame:    the newest frame that has begun; -1 before the first
    joining:  a node that is started to be inserted, and the scenario with which it begins
    stop:     the request to stop, and the error
    restarted: nodes that died, and that the launcher has restarted
    losses:   of results that the driver does not see, as in run.json
    given_up: nodes that were started to be inserted, and are not
    """

    resolved: Resolved
    show: Callable[[str], None]
    now_s: Callable[[], float]
    signals: list[int] = field(default_factory=list)
    frame: int = field(default=-1, init=False)
    joining: tuple[str, Resolved] | None = field(default=None, init=False)
    stop: ending.Stop = field(init=False)
    restarted: set[str] = field(default_factory=set, init=False)
    losses: list[dict[str, Any]] = field(default_factory=list, init=False)
    given_up: set[str] = field(default_factory=set, init=False)

    def __post_init__(self) -> None:
        self.stop = ending.Stop(self.now_s)

    def resolved_for(self, node: str) -> Resolved:
        """The scenario with which a node begins that is started now."""
        return self.joining[1] if self.joining is not None and self.joining[0] == node else self.resolved


_LEAVE_GRACE_S = 5.0  # for one node that was asked to leave, before it is killed


class Steps:
    """Carries out process steps; never starts a running node or kills a stopped one.

    Nothing but the steps of the scenario is carried out, and each only once.

    done:    the steps so far: frame, action, node
    leaving: nodes that were asked to leave, with the frame before which, until they have ended
    cut: whether a node has been disconnected from its networks
    """

    def __init__(self, state: RunState, supervisor: Supervisor[Any], actions: LauncherActions) -> None:
        self.done: list[dict[str, Any]] = []
        self.leaving: dict[str, int] = {}
        self.cut = False
        self._supervisor = supervisor
        self._nodes = state.resolved.nodes
        self._absent = Timetable(state.resolved, lockstep=state.resolved.mode == "lockstep").absent
        self._actions = actions
        self._planned = Counter((max(0, step.frame), step.action, step.node) for step in state.resolved.steps)
        self._now_s = state.now_s
        self._starting: dict[str, float] = {}  # nodes whose former process has to end first, with the latest time, s

    def start_all(self) -> None:
        """Start the nodes that are present from the beginning."""
        present = {name: spec for name, spec in self._nodes.items() if name not in self._absent}
        self._supervisor.start_all(present)

    def carry_out(self, frame: int, group: Sequence[tuple[str, str]]) -> None:
        """Carry out the driver's request before a frame: (action, node) of each step.

        Raises MessageError for steps that the scenario does not contain.
        """
        requested = Counter((frame, action, node) for action, node in group)
        if unplanned := requested - self._planned:
            _, action, node = min(unplanned)
            raise MessageError(f"act: {action} {node} before frame {frame}: the scenario has no such step left")
        self._planned -= requested
        for action, node in group:
            if self._do(frame, action, node):
                self.done.append({"frame": frame, "action": action, "node": node})

    def advance(self) -> None:
        """Continue steps that take time; called after the exits so far were handled."""
        for node in self.leaving:
            self._actions.leave(node, flow.LEAVE)  # every time: a process that is still starting has not received it
        for node, latest_s in list(self._starting.items()):
            child = self._supervisor.children[node]
            if child.exit is None:
                if self._now_s() >= latest_s:
                    self._supervisor.kill(child)
            elif child.exit_handled:  # so its results have been taken
                del self._starting[node]
                child.exit_expected = True  # the scenario restarts it, however it ended
                self._supervisor.restart(child)

    def _do(self, frame: int, action: str, node: str) -> bool:
        child = self._supervisor.children.get(node)
        if action == "start":
            return self._start(node, child)
        if child is None or (child.exit is not None and (child.exit_handled or action not in LEAVING)):
            return False
        if action == "kill":
            if child.exit is None:
                self._supervisor.kill(child)
            else:  # it has just died: the driver takes that for the step
                child.exit_expected = True
        elif action == "leave":
            child.exit_expected = True
            child.notes.append("told to leave by the scenario")
            self.leaving[node] = frame
            self._supervisor.resume([child])
            self._actions.leave(node, flow.LEAVE)
        elif action == "pause":
            self._supervisor.pause(child)
        elif action == "resume":
            self._supervisor.resume([child])
        elif action == "disconnect":
            self.cut = True
            self._supervisor.disconnect(child)
        else:
            self._supervisor.connect([child])
        return True

    def _start(self, node: str, child: Child | None) -> bool:
        if child is None:
            self._supervisor.start(node, self._nodes[node])
            return True
        if child.exit is None and not child.exit_expected:
            return False
        self._starting[node] = self._now_s() + _LEAVE_GRACE_S
        return True


LEAVE_GRACE_S = 20.0  #: without progress of any node, from the end of the scene to the last node's results
INTERRUPT_GRACE_S = 10.0  #: the same after a stop signal, when only data counts as progress
_SHOWN_S = 2.0  # of waiting at the end, before it is shown


def churn_of(outcomes: Mapping[str, Mapping[str, Any]], state: RunState) -> list[dict[str, Any]]:
    """Losses and returns of nodes, as in run.json: those that the driver has noted, and those that it does not see.

    A node may die when the driver has ended the run, and be restarted. Its new process takes part in nothing, so what
    it hands in are no results of the run. A node whose insertion was given up never belonged to it.

    outcomes: what each node has handed in, the driver among them
    """
    driver = next(outcome for outcome in outcomes.values() if "sent_ns" in outcome)
    unused = [name for name in sorted(state.restarted & outcomes.keys()) if outcomes[name]["last_frame"] < 0]
    late = ({"frame": driver["frames"], "node": name, "what": churn.LOST} for name in unused)
    return [event for event in (*driver["churn"], *state.losses, *late) if event["node"] not in state.given_up]


class Endings:
    """Handles reports, exits and stop signals, and asks all nodes to finish when the run is to stop."""

    def __init__(self, state: RunState, supervisor: Supervisor[Any], steps: Steps, actions: LauncherActions) -> None:
        self._state = state
        self._stop = state.stop
        self._supervisor = supervisor
        self._steps = steps
        self._actions = actions
        self._interrupts = 0  # stop signals that have been handled
        self._progress = Progress(state.now_s, actions.last_data_s)

    @property
    def waiting(self) -> str:
        """For which nodes the end of the run waits, and for how long; empty: for none, or not for long."""
        since = self._stop.since
        waited_s = 0.0 if since is None else self._state.now_s() - since
        names = [child.name for child in self._supervisor.running() if not child.handed_in]
        if waited_s < _SHOWN_S or not names:
            return ""
        more = f" and {len(names) - 3} more" if len(names) > 3 else ""
        return f"{', '.join(names[:3])}{more}: finishing, {waited_s:.0f} s"

    def advance(self) -> bool:
        """Handle what has happened since the last call; returns whether the run is over."""
        was_running = bool(self._supervisor.running())  # before the exits are taken: each of them is handled
        ended = self._supervisor.newly_ended()
        self.take_reports()  # after the exits: a process has handed in its results before it ended
        for child in ended:
            self._handle_exit(child)
        if not self._stop.requested:
            self._steps.advance()
        if len(self._state.signals) > self._interrupts:
            self._interrupts = len(self._state.signals)
            self._stop.problem = ending.from_signals(self._state.signals)
            self._stop.request("interrupted")
        if self._stop.since is not None and self._ask_to_stop(self._stop.since):
            return True
        return not was_running and not self._supervisor.running()

    def take_reports(self) -> None:
        """Handle what nodes have reported: results, and the first failure of each handler."""
        for node, failure, stop_reason in self._actions.reports():
            if failure is not None:
                self._handler_failed(node, failure)
            elif stop_reason is not None:
                self._stop.request()
                if (problem := self._problem(node, stop_reason)) is not None:
                    self._stop.note(problem)

    def _handler_failed(self, node: str, failure: Entry) -> None:
        """Show the failure of a handler; one of `start` ends the run."""
        (line,) = failures.lines({node: [failure]}, {node: f"logs/{node}.log"})
        self._state.show(f"[red]{escape(line)}")
        if failure["handler"] == "start":
            self._stop.fail(ending.from_failed_start(line, failure["exception"]), "a node did not start")

    def _problem(self, node: str, text: str) -> RunError | None:
        """The error for the driver's reason to stop; None for the end of the scene."""
        reason = decode_reason(text)
        if reason.kind is StopKind.END:
            return None
        if reason.kind is StopKind.STALL:
            return StallError(text)
        if reason.kind is StopKind.START:
            return StartError(text)
        if reason.kind is StopKind.IMPLAUSIBLE:
            return ImplausibleCounts(reason.detail)
        # If the launcher asked it to stop, there is a problem already, and this one is ignored.
        return RunError(f"{node} was told to stop at frame {self._state.frame}, not by the launcher: {text!r:.80}")

    def _handle_exit(self, child: Child) -> None:
        """Handle the end of a process; if it is unexpected, as the node's `on_exit` specifies."""
        frame = self._steps.leaving.pop(child.name, None)
        if frame is not None and not child.handed_in:
            self._state.losses.append({"frame": frame, "node": child.name, "what": churn.LOST})
        if child.exit_expected or (child.exit == 0 and (child.handed_in or self._stop.requested)):
            return
        event = f"{child.name} {child.ended} at frame {self._state.frame}"
        if self._state.frame < 0:
            text = f"{child.name} ended before the first frame: {child.ended}{self._log_line(child)}"
            self._stop.fail(StartError(text), "a node did not start")
        elif child.spec.on_exit == "restart" and child.handed_in:  # a new process would hand in others
            self._state.show(f"[yellow]{event}; its results had been taken")
        elif child.spec.on_exit == "restart" and not self._stop.requested:
            restarted = self._supervisor.restart(child)
            if restarted:
                self._state.restarted.add(child.name)
            consequence = "restarted" if restarted else "restarted too often, continuing without it"
            self._state.show(f"[yellow]{event}; {consequence}")
        elif child.spec.on_exit != "fail":
            self._state.show(f"[yellow]{event}; continuing without it")
        elif self._stop.problem is None:
            text = f"{event}; see logs/{child.name}.log{self._log_line(child)}"
            self._stop.fail(NodeDied(text), "a node died")

    def _log_line(self, child: Child) -> str:
        line = self._actions.last_log_line(child.name)
        return f": {line}" if line else ""

    def _ask_to_stop(self, since: float) -> bool:
        """Ask all nodes to stop; return whether no node makes progress any longer."""
        self._actions.stop(self._stop.reason)  # every time: one that is still starting or cut off has not received it
        if self._interrupts > 1:
            return True
        self._supervisor.resume(self._supervisor.running())  # a suspended node receives no message
        self._supervisor.connect(self._supervisor.running())
        # A disconnected node needs the longer grace period to reconnect.
        grace = INTERRUPT_GRACE_S if self._interrupts and not self._steps.cut else LEAVE_GRACE_S
        interrupted, running = self._interrupts > 0, self._supervisor.running()
        problems = [self._progress.problem(child, since, grace, interrupted=interrupted) for child in running]
        if not problems or not all(problems):
            return False
        for child, problem in zip(running, problems, strict=True):
            if child.spec.on_exit == "fail" and not child.exit_expected:
                self._stop.note(NodeDied(f"{child.name} {problem}; it is killed"))
        return True


MAX_REQUESTS = 64  #: in the queue
_START_TIMEOUT_S = 60.0  # for a node that is to be inserted

#: Work in steps: yields whenever it has to wait, and returns the answer.
Work = Generator[None, None, dict[str, Any]]


class Interceptions:
    """Inserts nodes into wires of a running run, and releases them, as requested; heals wires if inserted nodes die.

    Requests are served one after the other, one step in each iteration of the launcher's loop.

    alive: nodes with a liveliness token
    """

    def __init__(self, state: RunState, supervisor: Supervisor[Any], actions: LauncherActions) -> None:
        self.alive: set[str] = set()
        self._state = state
        self._supervisor = supervisor
        self._actions = actions
        self._requests: deque[tuple[Query, str, control.Intercept | control.Release]] = deque()
        self._served_ids: set[str] = set()
        self._work: Generator[None] | None = None
        self._inserted: set[str] = set()

    def add(self, query: Query, request_id: str, action: control.Intercept | control.Release) -> None:
        """Queue a request, from any thread; raises MessageError if too many wait."""
        if len(self._requests) >= MAX_REQUESTS:
            raise MessageError(f"more than {MAX_REQUESTS} requests are waiting")
        self._requests.append((query, request_id, action))

    def note_presence(self, node: str, present: bool) -> None:
        """Note that a node has appeared on the mesh, or gone; from any thread."""
        (self.alive.add if present else self.alive.discard)(node)

    def advance(self) -> None:
        """Do the next step of the current request, or of healing a wire, if any."""
        if self._work is None:
            self._work = self._next()
        if self._work is not None:
            try:
                next(self._work)
            except StopIteration:
                self._work = None

    def finish(self) -> None:
        """Refuse the requests that have not been served: the run is over."""
        while self._work is not None or self._requests:
            self.advance()

    def _next(self) -> Generator[None] | None:
        for name in sorted(self._inserted):
            child = self._supervisor.children[name]
            died = child.exit is not None and not child.exit_expected and not (child.exit == 0 and child.handed_in)
            if died and not self._state.stop.requested:
                return self._heal(child)
        return self._serve(*self._requests.popleft()) if self._requests else None

    def _serve(self, query: Query, request_id: str, action: control.Intercept | control.Release) -> Generator[None]:
        try:
            if request_id in self._served_ids:
                raise MessageError("a request that was sent before")
            self._served_ids.add(request_id)
            self._check_running()
            if isinstance(action, control.Intercept):
                answer = yield from self._intercept(*action)
            else:
                answer = yield from self._release(*action)
        except Exception as error:  # one request never ends the run
            self._actions.refuse(query, error)
        else:
            self._actions.answer(query, msgpack.packb(answer))

    def _intercept(self, name: str, spec: NodeSpec, place: InsertionPoint, modules: tuple[str, ...]) -> Work:
        """Start a node, and put it on its wire once it has joined the mesh."""
        before = self._state.resolved
        if name in before.nodes or any(child.name == name for child in self._supervisor.running()):
            raise ConfigurationError(f"node {name!r} already exists: give another --name")
        after = insertion.insert(Wiring.from_json(before.wiring), name, place)
        yield from self._until(lambda: self._state.frame >= 0)
        modules = tuple(dict.fromkeys([*before.modules, *modules]))
        planned = replace(before, nodes={**before.nodes, name: spec}, wiring=after.to_json(), modules=modules)
        self._adopt(before, (name, planned))
        try:
            self._supervisor.start(name, spec)
            child = self._supervisor.children[name]
            yield from self._until(lambda: name in self.alive or child.exit is not None, _START_TIMEOUT_S)
            if name not in self.alive:
                problem = f"{name} ended before it could be put on {place.wire}: {child.ended}"
                raise StartError(f"{problem}; see logs/{name}.log")
            answer = yield from self._ask_driver(after, {name: spec.role}, [])
        except MastError:
            self._adopt(before)
            self._state.given_up.add(name)
            if name in self._supervisor.children:
                yield from self._end(self._supervisor.children[name], "not put on its wire")
            raise
        self._adopt(planned)
        self._inserted.add(name)
        self._state.given_up.discard(name)
        place_before = {"before": place.before} if place.before else {}
        return self._record("intercept", name, [place.wire], answer | place_before)

    def _release(self, named: str | None, wire: str | None) -> Work:
        """Take a node off its wires, and end it once it has forwarded everything."""
        wiring = Wiring.from_json(self._state.resolved.wiring)
        name = named or insertion.interposer_of(wiring, wire or "")
        yield from self._until(lambda: self._state.frame >= 0)
        answer = yield from self._take_off(name)
        self._inserted.discard(name)
        if name in self._supervisor.children:
            yield from self._end(self._supervisor.children[name], "released")
        return self._record("release", name, answer.pop("wires"), answer)

    def _heal(self, child: Child) -> Generator[None]:
        """Reconnect the ends of a dead node's wires; the messages inside it are lost."""
        self._inserted.discard(child.name)
        try:
            answer = yield from self._take_off(child.name)
        except MastError as error:
            self._state.show(f"[yellow]the wire of {child.name} could not be healed: {error}")
            return
        self._supervisor.dispose(child)
        wires = answer.pop("wires")
        self._record("heal", child.name, wires, answer)
        self._state.show(f"[yellow]{', '.join(wires)} healed without {child.name}: the messages in it are lost")

    def _take_off(self, name: str) -> Work:
        before = self._state.resolved
        wiring = Wiring.from_json(before.wiring)
        after = insertion.remove(wiring, name)
        wires = [wire.key for wire in wiring.wires if name in wire.interposers]
        nodes = {other: spec for other, spec in before.nodes.items() if other != name}
        answer = yield from self._ask_driver(after, {}, [name])
        self._adopt(replace(before, nodes=nodes, wiring=after.to_json()))
        return answer | {"wires": wires}

    def _ask_driver(self, wiring: Wiring, join: dict[str, str], leave: list[str]) -> Work:
        """Have the driver switch all nodes to a new wiring; return its answer."""
        answers: list[bytes | None] = []
        self._actions.rewire(flow.encode_rewire(wiring, join, leave), answers.append)
        yield from self._until(lambda: answers)
        if answers[0] is None:
            raise RunError("nothing was changed: the driver does not answer")
        answer = flow.decode_rewired(answers[0])
        if answer.error:
            raise RunError(f"nothing was changed: {answer.error}")
        return {"frame": answer.frame, "took_ms": answer.took_ms}

    def _end(self, child: Child, reason: str) -> Generator[None]:
        """Ask a process to leave; kill it if it does not."""
        child.exit_expected = True
        child.notes.append(reason)
        self._actions.leave(child.name, reason)
        deadline = self._state.now_s() + _LEAVE_GRACE_S
        while child.exit is None and self._state.now_s() < deadline:
            yield
        if child.exit is None:
            self._supervisor.end_now(child)
        self._supervisor.dispose(child)
        deadline += _LEAVE_GRACE_S
        while child.name in self.alive and self._supervisor.running() and self._state.now_s() < deadline:
            yield  # its name may be used again once all nodes know that it is gone

    def _until(self, condition: Callable[[], object], seconds: float = float("inf")) -> Generator[None]:
        """Wait for a condition; raises NotRunning if the run stops, StartError on timeout."""
        deadline = self._state.now_s() + seconds
        while True:
            self._check_running()
            if condition():
                return
            if self._state.now_s() > deadline:
                raise StartError(f"timed out after {seconds:.0f} s")
            yield

    def _check_running(self) -> None:
        if self._state.stop.requested or not self._supervisor.running():
            raise NotRunning("the run is over")

    def _adopt(self, resolved: Resolved, joining: tuple[str, Resolved] | None = None) -> None:
        """Make this the run's scenario: nodes begin with it that start from now on, except one that is inserted."""
        self._state.resolved, self._state.joining = resolved, joining
        self._actions.adopt(resolved, joining)

    def _record(self, action: str, name: str, wires: list[str], answer: dict[str, Any]) -> dict[str, Any]:
        """Record a change in run.json, and return it."""
        change = {"action": action, "node": name, "wires": wires, **answer}
        self._actions.record(change)
        return change


class LauncherProtocol:
    """The launcher's loop of one run, on a mesh and on the simulated one."""

    def __init__(self, state: RunState, supervisor: Supervisor[Any], actions: LauncherActions) -> None:
        self.steps = Steps(state, supervisor, actions)
        self.endings = Endings(state, supervisor, self.steps, actions)
        self.interceptions = Interceptions(state, supervisor, actions)
        self._stop = state.stop
        self._actions = actions

    def advance(self, act: flow.Act | None) -> bool:
        """Handle what has happened since the last call; returns whether the run is over.

        act: a request of the driver for process steps, if there is one
        """
        if act is not None and not self._stop.requested:
            try:
                self.steps.carry_out(*act)
            except MessageError as error:
                self._actions.note_invalid("act", error)
        over = self.endings.advance()
        self.interceptions.advance()  # after the reports: a node that has handed in its results did not die
        return over

    def finish(self) -> None:
        """Refuse the requests that have not been served, and take the last reports: all processes have ended."""
        self.interceptions.finish()
        self.endings.take_reports()
