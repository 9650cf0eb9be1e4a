"""The nodes of a run as services of a swarm, which Docker starts and restarts.

A service has one task at a time. If a task fails and Docker makes another, the node has ended and is restarted at
once. Kills and starts of the scenario scale the service between 0 and 1.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from mast_zenoh.config.resolved import NodeSpec
from mast_zenoh.deploy.docker import docker
from mast_zenoh.deploy.swarm import tasks
from mast_zenoh.deploy.swarm.document import ROUTER, STOP_GRACE_S, router_exit
from mast_zenoh.deploy.swarm.logs import keep_logs
from mast_zenoh.deploy.swarm.tasks import Task
from mast_zenoh.errors import EngineError
from mast_zenoh.launch.supervisor import Child, Supervisor, how_ended

_LOOK_EVERY_S = 0.5
_CHANGED_S = 60.0  # longest time for Docker to carry out a command
_AGAIN_S = 5.0  # until the command is repeated
_UNPLACED_S = 30.0  # longest time for Docker to find a machine for a node
_SILENT_S = 30.0  # longest time without an answer of Docker
_ROUTERLESS_S = 5.0  # from the router's end to its next task, if Docker makes one


class Service(Child):
    """A node's service.

    tasks: all its tasks, the newest first;  over: ids of those whose end has been handled
    """

    def __init__(self, name: str, spec: NodeSpec, service: str) -> None:
        super().__init__(name, spec)
        self.service = service
        self.tasks: list[Task] = []
        self.over: set[str] = set()
        self.scaled = 1
        self.last: int | None = None  # its exit code, if its task is gone
        self.waits_since: float | None = None  # waiting for a machine, on the monotonic clock

    @property
    def task(self) -> Task | None:
        """The current task: the first of those whose end has not been handled."""
        return next((task for task in reversed(self.tasks) if task.id not in self.over), None)

    @property
    def exit(self) -> int | None:
        return self.last if self.task is None else self.task.exit

    @property
    def ended(self) -> str:
        """How it ended, with Docker's reason if it was not started."""
        return f"{super().ended}: {self.task.refused}" if self.task and self.task.refused else super().ended

    def where(self) -> dict[str, Any]:
        return {"service": self.service, "host": next((task.machine for task in self.tasks if task.machine), None)}

    def container(self) -> str:
        """The name of its current container; raises EngineError if there is none."""
        if self.task is None:
            raise EngineError(f"{self.name}: Docker has no task for the service {self.service}")
        return f"{self.service}.1.{self.task.id}"


class Services(Supervisor[Service]):
    """The services of one stack.

    service: gives the name of a node's service;  here: this machine's name in the swarm
    logs:    folder for the nodes' output
    mode:    mode of the run: in lock-step it does not survive its router
    """

    def __init__(self, stack: str, service: Callable[[str], str], here: str, logs: Path, mode: str) -> None:
        super().__init__()
        self._stack = stack
        self._service = service
        self._here = here
        self._logs = logs
        self._router_returns = router_exit(mode) == "restart"
        self._router: Task | None = None
        self._routerless_since: float | None = None
        self._kept: set[str] = set()
        self._looked = float("-inf")  # when Docker answered last

    def start(self, name: str, spec: NodeSpec) -> None:
        """Start a node; raises EngineError for a node that is not in the stack."""
        child = self._child(name, spec)
        if not docker("service", "inspect", "--format", "{{.ID}}", child.service, check=False).strip():
            del self.children[name]
            raise EngineError(f"{name}: the stack {self._stack} has no such service, and gets none while it runs")
        self._scale(child, 1)

    def start_all(self, specs: Mapping[str, NodeSpec]) -> None:
        """Adopt nodes, which were started with the stack and wait for the launcher."""
        for name, spec in specs.items():
            self._child(name, spec)

    def _child(self, name: str, spec: NodeSpec) -> Service:
        self.children[name] = child = Service(name, spec, self._service(name))
        (self._logs / f"{name}.log").touch()
        return child

    def _restart(self, child: Service) -> None:
        task = child.task
        self._keep_logs([child])
        if task is not None and task.exit and child.spec.on_exit == "restart" and child.scaled:
            child.over.add(task.id)  # Docker makes another
        else:
            self._scale(child, 0)
            self._until_gone(child)
            child.over |= {old_task.id for old_task in child.tasks}
            self._scale(child, 1)
        child.last = child.waits_since = None

    def end_now(self, child: Service) -> None:
        self.resume([child])  # a paused container cannot be killed
        self._look()
        if child.exit is None:
            container = self._container(child, "killed")
            self._keep_logs([child])
            docker("kill", container)
        child.last = -9 if child.exit is None else child.exit
        self._scale(child, 0)  # or Docker would restart it
        self._until_gone(child)

    def _suspend(self, child: Service) -> None:
        docker("pause", self._container(child, "paused"))

    def _resume(self, children: Iterable[Service]) -> None:
        for child in children:
            docker("unpause", child.container(), check=False)

    def dispose(self, child: Service) -> None:
        self._keep_logs([child])

    def running(self) -> list[Service]:
        """The running nodes; raises EngineError if one has no machine or the router ended."""
        self._look(_LOOK_EVERY_S)
        self._check_router()
        for child in self.children.values():
            task = child.task
            if child.exit is not None or (task is not None and not task.waits):
                child.waits_since = None
            elif child.waits_since is None:
                child.waits_since = time.monotonic()
            elif time.monotonic() - child.waits_since > _UNPLACED_S:
                why = task.error if task else "it has made no task for it"
                raise EngineError(f"{child.name}: Docker has found no machine for it in {_UNPLACED_S:.0f} s: {why}")
        return super().running()

    def newly_ended(self) -> list[Service]:
        """Nodes that have ended since the last call; their logs are complete."""
        ended = super().newly_ended()
        self._keep_logs(ended)
        return ended

    def end(self, grace_s: float) -> None:
        """Resume all nodes and ask them to leave; others are killed with the stack."""
        self._look()
        running = self.running_now()
        self.resume(running)
        for child in running:
            child.notes.append("told to leave by SIGTERM")
        here = [child for child in running if child.task is not None and child.task.machine == self._here]
        if here:  # their containers and logs stay
            docker("kill", "--signal", "TERM", *(child.container() for child in here), check=False)
        if elsewhere := [child for child in running if child not in here]:
            self._keep_logs(elsewhere)
            self._scale_all(elsewhere, 0)
        deadline = time.monotonic() + max(grace_s, STOP_GRACE_S)
        while self.running_now() and time.monotonic() < deadline:
            threading.Event().wait(0.1)
            self._look(_LOOK_EVERY_S)
        for child in self.running_now():
            child.notes.append("told to leave by SIGKILL")
            child.last = -9
        self._keep_logs(self.children.values())

    def running_now(self) -> list[Service]:
        """The nodes that ran at the last look."""
        return super().running()

    def _look(self, every_s: float = 0.0) -> None:
        """Update the tasks from Docker, unless that was done within `every_s`."""
        if time.monotonic() - self._looked < every_s:
            return
        try:
            tasks_by_node = tasks.of(self._stack)
        except EngineError:
            if time.monotonic() - self._looked > _SILENT_S:
                raise
            return
        self._looked = time.monotonic()
        self._router = next(iter(tasks_by_node.get(ROUTER, ())), None)
        for child in self.children.values():
            former, child.tasks = child.task, tasks_by_node.get(child.name, [])
            if former is not None and child.task is None and child.last is None and not child.scaled:
                child.last = former.exit if former.exit is not None else tasks.ASKED_TO_END

    def _check_router(self) -> None:
        router = self._router
        if router is None or router.exit is None:
            self._routerless_since = None
            return
        if self._routerless_since is None:
            self._routerless_since = time.monotonic()
        if not self._router_returns or time.monotonic() - self._routerless_since > _ROUTERLESS_S:
            raise EngineError(
                f"the router has ended: {router.refused or how_ended(router.exit)}; see logs/{ROUTER}.log"
            )

    def _scale(self, child: Service, to: int) -> None:
        self._scale_all([child], to)

    def _scale_all(self, children: Iterable[Service], to: int) -> None:
        changed = [child for child in children if child.scaled != to or to]
        for child in changed:
            child.scaled = to
        if changed:
            docker("service", "scale", "--detach", *(f"{child.service}={to}" for child in changed))

    def _until_gone(self, child: Service) -> None:
        """Wait until Docker has removed its newest task: earlier scaling would start none.

        If the task ends while the service is scaled to 0, Docker may not remove it (its two changes of the task
        collide, and one is not retried) until it is told to scale again.
        """
        deadline = time.monotonic() + _CHANGED_S
        commanded = time.monotonic()
        newest = {task.id for task in child.tasks[:1]}
        while True:
            self._look()
            if not newest & {task.id for task in child.tasks} and all(task.exit is not None for task in child.tasks):
                return
            if time.monotonic() > deadline:
                states = ", ".join(f"{task.state}, to be {task.wanted}" for task in child.tasks)
                raise EngineError(
                    f"{child.name}: the service {child.service} does not end within {_CHANGED_S:.0f} s: task {states}"
                )
            if time.monotonic() - commanded > _AGAIN_S:
                docker("service", "scale", "--detach", f"{child.service}=0")
                commanded = time.monotonic()
            threading.Event().wait(0.2)

    def _container(self, child: Service, done: str) -> str:
        machine = child.task.machine if child.task else ""
        if machine != self._here:
            where = f"it is on {machine}" if machine else "it is on no machine yet"
            raise EngineError(f"{child.name} cannot be {done}: Docker does that only on its own machine, and {where}")
        return child.container()

    def _keep_logs(self, children: Iterable[Service]) -> None:
        """Append the logs of the current tasks to the nodes' logs, each task once."""
        wanted = []
        for child in children:
            if child.task is not None and child.task.id not in self._kept:
                self._kept.add(child.task.id)
                wanted.append((child.task.id, self._logs / f"{child.name}.log", child.task.refused))
        if wanted:
            keep_logs(wanted)
