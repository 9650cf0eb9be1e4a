"""What the end of a process means for the run, and when a run that stops is over; docs/endings.md has the rules."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from rich.markup import escape

from mast_zenoh.control import failures
from mast_zenoh.control.failures import Entry
from mast_zenoh.control.stop_reasons import StopKind, decode_reason
from mast_zenoh.errors import ImplausibleCounts, NodeDied, RunError, StallError, StartError
from mast_zenoh.launch import ending
from mast_zenoh.launch.protocol.actions import LauncherActions
from mast_zenoh.launch.protocol.state import RunState
from mast_zenoh.launch.protocol.steps import Steps
from mast_zenoh.launch.supervisor import Child, Supervisor
from mast_zenoh.messagelog import churn

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
