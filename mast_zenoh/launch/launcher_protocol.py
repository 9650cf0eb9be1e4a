"""What the launcher decides about a run on a mesh; no Zenoh, no thread, no clock, no file."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from rich.markup import escape

from mast_zenoh.config.process_steps import LEAVING, ProcessStep
from mast_zenoh.config.resolved import NodeSpec, Resolved
from mast_zenoh.control import failures, flow
from mast_zenoh.control.failures import Entry
from mast_zenoh.control.flow import StopKind, decode_reason
from mast_zenoh.errors import ImplausibleCounts, MessageError, NodeDied, RunError, StallError, StartError
from mast_zenoh.launch import ending
from mast_zenoh.launch.supervisor import Child, Supervisor
from mast_zenoh.messagelog import churn

DRIVER_TIMEOUT_S = 60.0  #: for the driver to answer `rewire`

#: A query that waits for an answer: of Zenoh, or of the simulated mesh.
Query = Any


class LauncherActions(ABC):
    """The actions of the launcher."""

    @abstractmethod
    def stop(self, reason: str) -> None:
        """Ask all nodes to finish."""

    @abstractmethod
    def leave(self, node: str, reason: str) -> None:
        """Ask a node to finish."""

    @abstractmethod
    def rewire(self, payload: bytes, answered: Callable[[bytes | None], None]) -> None:
        """Ask the driver for a change of the wiring.

        answered: called once with its answer; None: it has not answered in time
        """

    @abstractmethod
    def answer(self, query: Query, payload: bytes) -> None:
        """Answer a query."""

    @abstractmethod
    def refuse(self, query: Query, error: Exception) -> None:
        """Answer a query with an error, and count it if the request was invalid."""

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


class Stop:
    """Request to stop a run, with its time, reason and error.

    now_s:   a monotonic clock, s
    since:   time of the request, s; None: not requested
    problem: the first error; the run ends with it
    """

    def __init__(self, now_s: Callable[[], float]) -> None:
        self.since: float | None = None
        self.reason = "end"
        self.problem: RunError | None = None
        self._now_s = now_s

    @property
    def requested(self) -> bool:
        """Whether all nodes are asked to finish."""
        return self.since is not None

    def request(self, reason: str = "end") -> None:
        """Ask all nodes to finish from now on; only the first request counts."""
        if self.since is None:
            self.since, self.reason = self._now_s(), reason

    def note(self, problem: RunError) -> None:
        """Note the error with which the run will end; only the first counts."""
        self.problem = self.problem or problem

    def fail(self, problem: RunError, reason: str) -> None:
        """Note an error, and ask all nodes to finish."""
        self.note(problem)
        self.request(reason)


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
    """

    resolved: Resolved
    show: Callable[[str], None]
    now_s: Callable[[], float]
    signals: list[int] = field(default_factory=list)
    frame: int = field(default=-1, init=False)
    joining: tuple[str, Resolved] | None = field(default=None, init=False)
    stop: Stop = field(init=False)
    restarted: set[str] = field(default_factory=set, init=False)
    losses: list[dict[str, Any]] = field(default_factory=list, init=False)

    def __post_init__(self) -> None:
        self.stop = Stop(self.now_s)

    def resolved_for(self, node: str) -> Resolved:
        """The scenario with which a node begins that is started now."""
        return self.joining[1] if self.joining is not None and self.joining[0] == node else self.resolved


_STEP_GRACE_S = 5.0  # for a node that was asked to leave, before it is started again


class Steps:
    """Carries out process steps; never starts a running node or kills a stopped one.

    planned: the steps of the scenario: nothing else is carried out, and each only once
    actions: ask nodes to leave; done: the steps so far: frame, action, node
    leaving: nodes that were asked to leave, with the frame before which, until they have ended
    cut: whether a node has been disconnected from its networks
    """

    def __init__(
        self,
        supervisor: Supervisor[Any],
        nodes: Mapping[str, NodeSpec],
        absent: frozenset[str],
        actions: LauncherActions,
        planned: Iterable[ProcessStep],
        now_s: Callable[[], float],
    ) -> None:
        self._supervisor = supervisor
        self._nodes = nodes
        self._absent = absent
        self._actions = actions
        self._planned = Counter((max(0, step.frame), step.action, step.node) for step in planned)
        self.done: list[dict[str, Any]] = []
        self.leaving: dict[str, int] = {}
        self.cut = False
        self._now_s = now_s
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
        self._starting[node] = self._now_s() + _STEP_GRACE_S
        return True


LEAVE_GRACE_S = 20.0  #: from the end of the scene to the last node's results
INTERRUPT_GRACE_S = 5.0  #: the same after a stop signal


def churn_of(outcomes: Mapping[str, Mapping[str, Any]], state: RunState) -> list[dict[str, Any]]:
    """Losses and returns of nodes, as in run.json: those that the driver has noted, and those that it does not see.

    A node may die when the driver has ended the run, and be restarted. Its new process takes part in nothing, so what
    it hands in are no results of the run.

    outcomes: what each node has handed in, the driver among them
    """
    driver = next(outcome for outcome in outcomes.values() if "sent_ns" in outcome)
    unused = [name for name in sorted(state.restarted & outcomes.keys()) if outcomes[name]["last_frame"] < 0]
    late = ({"frame": driver["frames"], "node": name, "what": churn.LOST} for name in unused)
    return [*driver["churn"], *state.losses, *late]


class Endings:
    """Handles reports, exits and stop signals, and asks all nodes to finish when the run is to stop.

    take_reports: handles what nodes have reported up to now
    last_received_s: when the last piece of a file of a node arrived, s on the monotonic clock
    """

    def __init__(
        self,
        state: RunState,
        supervisor: Supervisor[Any],
        steps: Steps,
        actions: LauncherActions,
        *,
        take_reports: Callable[[], None],
        last_received_s: Callable[[], float] = lambda: float("-inf"),
    ) -> None:
        self._state = state
        self._stop = state.stop
        self._supervisor = supervisor
        self._steps = steps
        self._actions = actions
        self._take_reports = take_reports
        self._last_received_s = last_received_s
        self._interrupts = 0  # stop signals that have been handled

    def advance(self) -> bool:
        """Handle what has happened since the last call; returns whether the run is over."""
        was_running = bool(self._supervisor.running())  # before the exits are taken: each of them is handled
        ended = self._supervisor.newly_ended()
        self._take_reports()  # after the exits: a process has handed in its results before it ended
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

    def handed_in(self, node: str, stop_reason: str | None) -> None:
        """Handle the results of a node; stop_reason: the driver's, None for other nodes."""
        if stop_reason is not None:
            self._stop.request()
            if (problem := self._problem(node, stop_reason)) is not None:
                self._stop.note(problem)

    def handler_failed(self, node: str, failure: Entry) -> None:
        """Show the first failure of a handler; one of `start` ends the run."""
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
        """Ask all nodes to stop; return whether the grace period is over."""
        self._actions.stop(self._stop.reason)  # every time: one that is still starting or cut off has not received it
        if self._interrupts > 1:
            return True
        self._supervisor.resume(self._supervisor.running())  # a suspended node receives no message
        self._supervisor.connect(self._supervisor.running())
        # A disconnected node needs the longer grace period to reconnect.
        grace = INTERRUPT_GRACE_S if self._interrupts and not self._steps.cut else LEAVE_GRACE_S
        if self._state.now_s() - max(since, self._last_received_s()) <= grace:
            return False
        for child in self._supervisor.running():
            if child.spec.on_exit == "fail" and not child.exit_expected:
                self._stop.note(NodeDied(f"{child.name} has not finished within {grace:.0f} s; it is killed"))
        return True
