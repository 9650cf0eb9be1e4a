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

MAX_WAITING = 1000  #: requests of the driver in the queue
_LEAVE_GRACE_S = 5.0  # for a node that was asked to leave, before it is started again


def check(resolved: Resolved, where: str, *, unplugs: bool) -> None:
    """Raise BackendError for steps that are impossible where the nodes live.

    where: in words; unplugs: whether nodes can be disconnected from their networks there
    """
    for step in resolved.steps:
        if step.action == "disconnect" and not unplugs:
            raise BackendError(
                f"Unplug of {step.node!r} (before frame {step.frame}): only the containers of engine compose can be "
                f"disconnected from their networks (mast deploy up --engine compose), found {where}; use Partition, or "
                "on this machine `hosts` with HostPartition"
            )


class Steps:
    """Carries out process steps; never starts a running node or kills a stopped one.

    planned: the steps of the scenario: nothing else is carried out, and each only once
    leave: asks a node to leave; done: the steps so far: frame, action, node
    cut: whether a node has been disconnected from its networks
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
        """Start the nodes that are present from the beginning."""
        present = {name: spec for name, spec in self._nodes.items() if name not in self._absent}
        self._supervisor.start_all(present, self._absent)

    def carry_out(self, frame: int, group: Sequence[tuple[str, str]]) -> None:
        """Carry out the driver's request before a frame: (action, node) of each step.

        Raises MessageError for steps that the scenario does not contain.
        """
        requested = Counter((frame, action, node) for action, node in group)
        if unplanned := requested - self._planned:
            _, action, node = min(unplanned)
            raise MessageError(f"act: {action} {node} before frame {frame}: the scenario has no such step left")
        self._planned -= requested
        starting = {node for action, node in group if action == "start"}
        for action, node in group:
            if self._do(action, node, starting):
                self.done.append({"frame": frame, "action": action, "node": node})

    def restart(self, child: Child) -> bool:
        """Restart a node that has ended by itself; False if it was restarted too often."""
        return self._supervisor.restart(child, self._down({child.name}))

    def _do(self, action: str, node: str, starting: set[str]) -> bool:
        child = self._supervisor.children.get(node)
        if action == "start":
            return self._start(node, child, starting)
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

    def _start(self, node: str, child: Child | None, starting: set[str]) -> bool:
        if child is None:
            self._supervisor.start(node, self._nodes[node], self._down(starting))
            return True
        if child.exit is None and not child.exit_expected:
            return False
        if not self._supervisor.wait(child, _LEAVE_GRACE_S):
            self._supervisor.kill(child)
        child.exit_expected = True  # the scenario restarts it, however it ended
        return self._supervisor.restart(child, self._down(starting))

    def _down(self, starting: Sequence[str] | set[str]) -> set[str]:
        return self._nodes.keys() - {child.name for child in self._supervisor.running()} - set(starting)


class StepRequests:
    """Queue of the driver's requests for process steps, decoded on arrival."""

    def __init__(self, steps: Steps, signatures: Signatures, invalid: InvalidMessages) -> None:
        self._steps = steps
        self._signatures = signatures
        self._invalid = invalid
        # Not a SimpleQueue: its `get` never returns if a signal is still being handled when the timeout expires.
        self._waiting: queue.Queue[flow.Act] = queue.Queue(MAX_WAITING)

    def take(self, payload: bytes) -> None:
        """Queue a request, in Zenoh's thread; refuse a malformed or unsigned one."""
        try:
            self._waiting.put_nowait(self._signatures.open("act", payload, flow.decode_act))
        except MessageError as error:
            self._invalid.note("act", error)
        except queue.Full:
            self._invalid.note("act", f"more than {MAX_WAITING} requests are waiting")

    def serve(self, timeout_s: float, *, stopping: bool = False) -> None:
        """Wait up to timeout_s for a request; carry it out unless the run is stopping."""
        try:
            request = self._waiting.get(timeout=timeout_s)
        except queue.Empty:
            return
        if not stopping:
            try:
                self._steps.carry_out(*request)
            except MessageError as error:
                self._invalid.note("act", error)
