"""Carries out the process steps of a scenario when the driver requests them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from mast_zenoh.config.process_steps import LEAVING, ProcessStep
from mast_zenoh.config.resolved import NodeSpec
from mast_zenoh.control import flow
from mast_zenoh.errors import MessageError
from mast_zenoh.launch.protocol.actions import LauncherActions
from mast_zenoh.launch.supervisor import Child, Supervisor

_LEAVE_GRACE_S = 5.0  # for a node that was asked to leave, before it is started again


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
        self._starting[node] = self._now_s() + _LEAVE_GRACE_S
        return True
