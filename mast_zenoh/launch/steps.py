"""Carries out the process steps of a scenario when the driver requests them."""

from __future__ import annotations

import queue
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from mast_zenoh.config.process_steps import ProcessStep
from mast_zenoh.config.resolved import NodeSpec, Resolved
from mast_zenoh.control import flow
from mast_zenoh.control.invalid import InvalidMessages
from mast_zenoh.control.signatures import Signatures
from mast_zenoh.errors import BackendError, MessageError
from mast_zenoh.launch.supervisor import Child, Supervisor

MAX_WAITING = 1000  #: requests of the driver that are not done yet
_LEAVE_GRACE_S = 5.0  # for a node that was asked to leave, before it is started again


def check(resolved: Resolved, where: str, *, unplugs: bool) -> None:
    """Raise BackendError for what cannot be done to the nodes of a run where they live; before anything is started.

    where: in words; unplugs: whether nodes have networks there that they can be taken off
    """
    for step in resolved.steps:
        if step.action == "disconnect" and not unplugs:
            raise BackendError(
                f"Unplug of {step.node!r} (before frame {step.frame}): only the containers of engine compose can be "
                f"taken off their networks (mast deploy up --engine compose), found {where}; use Partition, or on this "
                "machine `hosts` with HostPartition"
            )


class Steps:
    """Carries out process steps. A running node is not started, and a stopped one is not killed.

    planned: the steps of the scenario: nothing else is carried out, and each only once
    leave: asks a node to leave; done: what has been done so far: frame, action, node;
    cut: whether a node has been taken off its networks
    """

    def __init__(
        self,
        supervisor: Supervisor[Any],
        nodes: Mapping[str, NodeSpec],
        absent: frozenset[str],
        leave: Callable[[str], None],
        planned: Iterable[ProcessStep],
    ) -> None:
        self._supervisor = supervisor
        self._nodes = nodes
        self._absent = absent
        self._leave = leave
        self._planned = Counter((max(0, step.frame), step.action, step.node) for step in planned)
        self.done: list[dict[str, Any]] = []
        self.cut = False

    def start_all(self) -> None:
        """Start the nodes that are there from the beginning."""
        there = {name: spec for name, spec in self._nodes.items() if name not in self._absent}
        self._supervisor.start_all(there, self._absent)

    def carry_out(self, frame: int, group: Sequence[tuple[str, str]]) -> None:
        """Carry out what the driver requests before a frame: (action, node) of each step.

        Raises MessageError for what the scenario does not say.
        """
        wanted = Counter((frame, action, node) for action, node in group)
        if beyond := wanted - self._planned:
            _, action, node = min(beyond)
            raise MessageError(f"act: {action} {node} before frame {frame}: the scenario does not say so (again)")
        self._planned -= wanted
        coming = {node for action, node in group if action == "start"}
        for action, node in group:
            if self._do(action, node, coming):
                self.done.append({"frame": frame, "action": action, "node": node})

    def restart(self, child: Child) -> bool:
        """Start a node again that has ended by itself; False when that has been done too often."""
        return self._supervisor.restart(child, self._down({child.name}))

    def _do(self, action: str, node: str, coming: set[str]) -> bool:
        child = self._supervisor.children.get(node)
        if action == "start":
            return self._start(node, child, coming)
        if child is None or child.exit is not None:
            return False
        if action == "kill":
            self._supervisor.kill(child)
        elif action == "leave":
            child.exit_expected = True
            child.notes.append("told to leave by the scenario")
            self._supervisor.resume([child])
            self._leave(node)
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

    def _start(self, node: str, child: Child | None, coming: set[str]) -> bool:
        if child is None:
            self._supervisor.start(node, self._nodes[node], self._down(coming))
            return True
        if child.exit is None and not child.exit_expected:
            return False
        if not self._supervisor.wait(child, _LEAVE_GRACE_S):
            self._supervisor.kill(child)
        child.exit_expected = True  # that it comes again is the scenario's doing, however it went
        return self._supervisor.restart(child, self._down(coming))

    def _down(self, coming: Sequence[str] | set[str]) -> set[str]:
        return self._nodes.keys() - {child.name for child in self._supervisor.running()} - set(coming)


class StepRequests:
    """The driver's requests for process steps, from when they come until they are done; decoded where they come."""

    def __init__(self, steps: Steps, signatures: Signatures, invalid: InvalidMessages) -> None:
        self._steps = steps
        self._signatures = signatures
        self._invalid = invalid
        # Not a SimpleQueue: its `get` never returns if a signal is still being handled when the timeout is over.
        self._waiting: queue.Queue[flow.Act] = queue.Queue(MAX_WAITING)

    def take(self, payload: bytes) -> None:
        """Take up a request, in Zenoh's thread; one that is malformed or not signed takes no room."""
        try:
            self._waiting.put_nowait(self._signatures.open("act", payload, flow.decode_act))
        except MessageError as error:
            self._invalid.note("act", error)
        except queue.Full:
            self._invalid.note("act", f"more than {MAX_WAITING} wait")

    def serve(self, timeout_s: float, *, stopping: bool = False) -> None:
        """Wait up to so many seconds for a request, and carry it out unless the run is to stop."""
        try:
            request = self._waiting.get(timeout=timeout_s)
        except queue.Empty:
            return
        if not stopping:
            try:
                self._steps.carry_out(*request)
            except MessageError as error:
                self._invalid.note("act", error)
