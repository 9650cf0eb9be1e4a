"""The nodes of a run on hosts with SSH, controlled through the hosts' wardens."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from mast_zenoh.config.resolved import NodeSpec
from mast_zenoh.deploy.joining import router_ended
from mast_zenoh.deploy.ssh.attachment import Attachment
from mast_zenoh.errors import EngineError
from mast_zenoh.launch.supervisor import Child, Supervisor
from mast_zenoh.security.credentials import ROUTER

#: From a command to its answer: a lost connection must be restored by then.
_ANSWER_S = 30.0

#: From SIGTERM to SIGKILL: a node hands in its results over a network.
_GRACE_S = 5.0


class RemoteNode(Child):
    """A node's process on a host; start: id of the command that started it last."""

    def __init__(self, name: str, spec: NodeSpec, attachment: Attachment) -> None:
        super().__init__(name, spec)
        self.attachment = attachment
        self.start = ""

    @property
    def exit(self) -> int | None:
        """Exit code; a node whose host has lost its supervisor counts as killed."""
        return exit_of(self.attachment, self.name, self.start)

    def where(self) -> dict[str, Any]:
        state = self.attachment.state(self.name, self.start)
        return {"host": self.attachment.host.name, "pid": state["pid"] if state else None}


class RemoteNodes(Supervisor[RemoteNode]):
    """The nodes of a run on all its hosts.

    attachments: by host; placed: the host of each node; a node that is added later runs on the first host
    command: gives the command of a node on its host, and the environment
    logs: folder for the nodes' output; changed: notified by the attachments
    router: its host, and id of the command that started it; None: it is not on any host
    """

    def __init__(
        self,
        attachments: Mapping[str, Attachment],
        placed: Mapping[str, str],
        command: Callable[[str, str], tuple[Sequence[str], dict[str, str]]],
        logs: Path,
        changed: threading.Condition,
        router: tuple[Attachment, str] | None = None,
    ) -> None:
        super().__init__()
        self._router = router
        self._logs = logs
        self._attachments = attachments
        self._placed = placed
        self._command = command
        self._changed = changed

    def start_all(self, specs: Mapping[str, NodeSpec]) -> None:
        """Start nodes, and wait until the hosts have started them."""
        super().start_all(specs)
        deadline = time.monotonic() + _ANSWER_S
        for name in specs:
            child = self.children[name]
            child.attachment.answer(child.start, max(0.0, deadline - time.monotonic()))

    def start(self, name: str, spec: NodeSpec) -> None:
        """Start a node without waiting for the host."""
        child = RemoteNode(name, spec, self._attachments[self._placed.get(name, next(iter(self._attachments)))])
        self.children[name] = child
        (self._logs / f"{name}.log").touch()
        self._restart(child)

    def _restart(self, child: RemoteNode) -> None:
        argv, env = self._command(child.name, child.attachment.host.name)
        child.start = child.attachment.tell("start", name=child.name, argv=list(argv), env=env)

    def end_now(self, child: RemoteNode) -> None:
        """Kill a node and wait for its end; raises EngineError without an answer."""
        self._signal([child], signal.SIGKILL)
        if not self.wait(child, _ANSWER_S):
            raise EngineError(f"{child.name} does not end")

    def _suspend(self, child: RemoteNode) -> None:
        self._signal([child], signal.SIGSTOP)

    def _resume(self, children: Iterable[RemoteNode]) -> None:
        self._signal(children, signal.SIGCONT)

    def wait(self, child: RemoteNode, seconds: float) -> bool:
        with self._changed:
            return self._changed.wait_for(lambda: child.exit is not None, seconds)

    def dispose(self, child: RemoteNode) -> None:
        """Do nothing: the host keeps only the log."""

    def running(self) -> list[RemoteNode]:
        """The running nodes; raises EngineError if the router has ended."""
        if self._router is not None:
            attachment, start = self._router
            code = exit_of(attachment, ROUTER, start)
            if code is not None:
                raise router_ended(f"the router on {attachment.host.called}", code, ROUTER)
        return super().running()

    def end(self, grace_s: float) -> None:
        """End all nodes; an unreachable host ends its own, which is noted."""
        commands = {}
        for child in super().running():
            child.notes.append("told to leave by SIGTERM")
            if child.attachment not in commands:
                commands[child.attachment] = child.attachment.tell("end", grace_s=max(grace_s, _GRACE_S))
        deadline = time.monotonic() + max(grace_s, _GRACE_S) * 2
        for attachment, command_id in commands.items():
            attachment.answer(command_id, max(0.0, deadline - time.monotonic()))
        for child in super().running():
            child.notes.append(f"{child.attachment.host.called} is out of reach")

    def _signal(self, children: Iterable[RemoteNode], number: int) -> None:
        """Send a signal and wait for the hosts; raises EngineError without an answer."""
        names_on: dict[Attachment, list[str]] = {}
        for child in children:
            names_on.setdefault(child.attachment, []).append(child.name)
        commands = {a: a.tell("signal", names=names, number=int(number)) for a, names in names_on.items()}
        for attachment, command_id in commands.items():
            if attachment.answer(command_id, _ANSWER_S) is None and not attachment.gone:
                raise EngineError(f"{attachment.host.called}: has not answered within {_ANSWER_S:.0f} s")


def exit_of(attachment: Attachment, name: str, start: str) -> int | None:
    """Exit code of a process on a host; killed if the host has lost its warden."""
    state = attachment.state(name, start)
    if state is not None and state["exit"] is not None:
        code: int = state["exit"]
        return code
    return -int(signal.SIGKILL) if attachment.gone else None
