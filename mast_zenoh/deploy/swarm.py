"""Engine `swarm`: nodes as services of a swarm, which Docker places, starts and restarts.

A service has one task at a time: one attempt to run a node. If a task fails and Docker makes another, the node has
ended and is restarted at once. Kills and starts of the scenario scale the service between 0 and 1.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import threading
import time
from collections.abc import Collection, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, NamedTuple

import zenoh

from mast_zenoh.config.resolved import NodeSpec, Resolved
from mast_zenoh.deploy import documents
from mast_zenoh.deploy.docker import AT_A_TIME, TAG, TO_LOG, DockerEngine, docker, exit_code
from mast_zenoh.deploy.documents import HOST_LABEL, ROUTER, STOP_GRACE_S
from mast_zenoh.deploy.engine import DeployedNodes, free_port, numeric_environment, write_settings
from mast_zenoh.errors import ConfigurationError, EngineError, nearest
from mast_zenoh.launch.context import RunContext
from mast_zenoh.launch.supervisor import Child, how_ended
from mast_zenoh.runtime.protocol.timetable import Timetable
from mast_zenoh.security.deployment import Deployment

#: Largest secret and config that a swarm accepts, bytes.
LARGEST_SECRET = 500_000

#: Docker's own label, on everything in a stack.
_NAMESPACE = "com.docker.stack.namespace"
_OF_SWARM = ("service", "network", "secret", "config")
_OF_MACHINE = ("container", "network")

_LOOK_EVERY_S = 0.5
_CHANGED_S = 60.0  # longest time for Docker to carry out a command
_AGAIN_S = 5.0  # until the command is repeated
_UNPLACED_S = 30.0  # longest time for Docker to find a machine for a node
_SILENT_S = 30.0  # longest time without an answer of Docker
_ROUTERLESS_S = 5.0  # from the router's end to its next task, if Docker makes one
_REMOVAL_TIMEOUT_S = 90.0
_LOG_S = 30.0


class Swarm(DockerEngine):
    """Services of the swarm that this machine manages.

    image:      image of the services, see `docker.build_image`
    patience_s: how long they run without the launcher or the router, s: Docker restarts the router
    place:      by pattern of nodes' names, the value of the label `mast.host` of their machine; Docker spreads the
                others
    """

    name = "swarm"

    def __init__(self, image: str = TAG, patience_s: float = 30.0, place: Mapping[str, str] | None = None) -> None:
        super().__init__(image, patience_s)
        self.place = dict(place or {})

    def check_platform(self, resolved: Resolved) -> None:
        check_here()
        check_manager()
        documents.check_service_names(resolved)
        check_placement(machines(), placement(self.place, resolved.nodes), pinned(resolved.steps))

    def nodes(self, context: RunContext, stack: ExitStack) -> Services:
        return Services(self, context, stack)

    @classmethod
    def status(cls, folder: Path, record: dict[str, Any]) -> list[dict[str, str]]:
        tasks_by_node = tasks_of(record["deployment"]["stack"])
        return [
            {"node": node, "state": f"{tasks[0].state} {tasks[0].error}".strip(), "where": tasks[0].machine}
            for node, tasks in sorted(tasks_by_node.items())
        ]

    @classmethod
    def log_command(cls, record: dict[str, Any], node: str) -> list[str]:
        return ["docker", "service", "logs", "--raw", documents.service_name(record["id"], node)]

    @classmethod
    def remove(cls, record: dict[str, Any]) -> None:
        remove_stack(record["deployment"]["stack"])


# -- the swarm ---------------------------------------------------------------------------------------------------


class Machine(NamedTuple):
    """A machine of the swarm: id, host name, whether it accepts tasks, and labels."""

    id: str
    name: str
    usable: bool
    labels: Mapping[str, str]


def machines() -> list[Machine]:
    """All machines of the swarm, this one first. Raises EngineError."""
    here = docker("info", "--format", "{{.Swarm.NodeID}}").strip()
    ids = docker("node", "ls", "--quiet").split()
    lines = docker("node", "inspect", "--format", "{{json .}}", *sorted(ids, key=lambda id_: id_ != here))
    found = []
    for data in (json.loads(line) for line in lines.splitlines() if line):
        spec, status = data["Spec"], data["Status"]
        usable = spec.get("Availability") == "active" and status.get("State") == "ready"
        found.append(Machine(data["ID"], data["Description"]["Hostname"], usable, spec.get("Labels") or {}))
    return found


def check_here(launcher_environment: Mapping[str, str] = os.environ) -> None:
    """Raise EngineError if DOCKER_HOST is another machine: the router would run there."""
    where = launcher_environment.get("DOCKER_HOST", "")
    if where and not where.startswith(("unix://", "npipe://")):
        raise EngineError(f"DOCKER_HOST is {where}: expected the engine of this machine; start the run on that machine")


def check_manager() -> None:
    """Raise EngineError if this machine does not manage a swarm."""
    state, manages = docker("info", "--format", "{{.Swarm.LocalNodeState}} {{.Swarm.ControlAvailable}}").split()
    if state == "inactive":
        raise EngineError(
            "this machine is not in a swarm: create one with `docker swarm init --advertise-addr 127.0.0.1`, or "
            "with an address that other machines reach"
        )
    if state != "active":
        raise EngineError(f"the swarm of this machine is {state}: expected active; see `docker info`")
    if manages != "true":
        raise EngineError(
            "this machine is a worker of its swarm: start the run on a manager, or `docker node promote` it"
        )


def placement(wanted: Mapping[str, str], nodes: Collection[str]) -> dict[str, str]:
    """The host of each node, by the first pattern that matches its name.

    Raises ConfigurationError for a pattern that matches no node.
    """
    host_of: dict[str, str] = {}
    for pattern, host in wanted.items():
        matching = [node for node in nodes if fnmatchcase(node, pattern)]
        if not matching:
            raise ConfigurationError(f"--place {pattern}: there is no such node{nearest(pattern, nodes)}")
        host_of = dict.fromkeys(matching, host) | host_of
    return host_of


def pinned(steps: Iterable[tuple[int, str, str]]) -> frozenset[str]:
    """The nodes that their steps (frame, action, node) bind to the launcher's machine.

    Docker kills and pauses only through the engine of the process's own machine.
    """
    return frozenset(node for _, action, node in steps if action in ("kill", "pause", "resume"))


def check_placement(machines: list[Machine], place: Mapping[str, str], pinned: Collection[str]) -> None:
    """Raise EngineError if a node has no machine, or a pinned node another one.

    machines: the launcher's machine first
    """
    here = machines[0]
    if not here.usable:
        raise EngineError(
            f"this machine takes no tasks, and the router has to be here: docker node update --availability active "
            f"{here.name}"
        )
    known = {machine.labels[HOST_LABEL] for machine in machines if machine.usable and HOST_LABEL in machine.labels}
    for node, host in place.items():
        if host not in known:
            hint = nearest(host, known) if known else ""
            raise EngineError(
                f"{node}: no machine of the swarm that takes tasks has the label {HOST_LABEL}={host}{hint}; "
                f"docker node update --label-add {HOST_LABEL}={host} MACHINE"
            )
        if node in pinned and here.labels.get(HOST_LABEL) != host:
            raise EngineError(
                f"{node}: the scenario kills or pauses it, and Docker does that only to containers of the launcher's "
                f"machine, {here.name}: expected it there, found it placed on {HOST_LABEL}={host}"
            )


def image_reference(image: str) -> str:
    """The exact image for every machine: its digest if a registry has it, else its id.

    With the name alone, every machine would look it up in a registry.
    """
    found = docker("image", "inspect", "--format", "{{json .RepoDigests}}\t{{.Id}}", image)
    digests, _, identity = found.partition("\t")
    known = json.loads(digests)
    return str(known[0]) if known else identity.strip()


def check_size(settings: Path) -> None:
    """Raise EngineError if the router's settings are too large for a secret."""
    if (size := settings.stat().st_size) > LARGEST_SECRET:
        raise EngineError(
            f"the router's settings, with the rights of all nodes, are {size} bytes: a secret of a swarm is at most "
            f"{LARGEST_SECRET}; use the security level mtls, which has no rights, or fewer nodes"
        )


def _detach_options() -> list[str]:
    """Options that keep `docker stack deploy` from waiting and from asking a registry."""
    client = docker("version", "--format", "{{.Client.Version}}").partition(".")[0]
    return ["--resolve-image", "never", *(["--detach=true"] if client.isdigit() and int(client) >= 26 else [])]


def remaining_parts(stack: str) -> dict[str, list[str]]:
    """Ids of a stack's remaining parts by kind; containers of this machine only.

    Raises EngineError.
    """
    active = docker("info", "--format", "{{.Swarm.LocalNodeState}}").strip() != "inactive"
    parts = {}
    for kind in dict.fromkeys((*(_OF_SWARM if active else ()), *_OF_MACHINE)):
        options = ("--all",) if kind == "container" else ()
        parts[kind] = docker(kind, "ls", "--quiet", *options, "--filter", f"label={_NAMESPACE}={stack}").split()
    return {kind: ids for kind, ids in parts.items() if ids}


def remove_stack(stack: str, seconds: float = _REMOVAL_TIMEOUT_S) -> None:
    """Remove a stack if it exists, and wait until it is gone; raises EngineError."""
    deadline = time.monotonic() + seconds
    while parts := remaining_parts(stack):
        if time.monotonic() > deadline:
            remaining = ", ".join(f"{len(ids)} {kind}(s)" for kind, ids in parts.items())
            raise EngineError(f"the stack {stack} still exists after {seconds:.0f} s: {remaining} left")
        if parts.keys() != {"container"}:  # they end by themselves, after their services
            docker("stack", "rm", stack, check=False)  # repeatedly, as a network in use is not removed
        threading.Event().wait(0.3)


# -- tasks -------------------------------------------------------------------------------------------------------

_FIELDS = ("ID", "Name", "Node", "DesiredState", "CurrentState", "Error")
_NOTHING = "nothing found in stack"  # only Docker's error text distinguishes this failure
_MISSING = "No such image"
_CODE = re.compile(r"non-zero exit \((\d+)\)")

#: A task in one of these states runs no more, and will not run.
_OVER = frozenset({"complete", "failed", "rejected", "shutdown", "orphaned"})

#: Exit codes for a task that could not be started (as from `docker run`), and for one that was asked to end.
_NOT_STARTED = 125
_ASKED_TO_END = -15


class Task(NamedTuple):
    """One attempt to run a node.

    machine: its name in the swarm, "" if not placed yet;  state: one word, such as "running"
    wanted:  the desired state;  error: Docker's reason for a failure or for waiting
    """

    id: str
    node: str
    machine: str
    wanted: str
    state: str
    error: str

    @property
    def exit(self) -> int | None:
        """Exit code of its process, negative for a signal; None if it has not ended."""
        if self.state not in _OVER:
            return None
        if self.state == "complete":
            return 0
        if found := _CODE.search(self.error):
            return exit_code(int(found[1]))
        return _ASKED_TO_END if self.state == "shutdown" else _NOT_STARTED

    @property
    def waits(self) -> bool:
        """Whether it waits for a machine, for a reason that Docker names."""
        return self.state in ("new", "pending") and bool(self.error)

    @property
    def refused(self) -> str:
        """Why its machine has not started it; empty if it has."""
        if self.exit != _NOT_STARTED or _CODE.search(self.error):
            return ""
        missing = (
            "; no registry has it: `docker save` it here, `docker load` it there" if _MISSING in self.error else ""
        )
        return f"{self.machine}: {self.error or self.state}{missing}"


def tasks_of(stack: str) -> dict[str, list[Task]]:
    """The tasks of a stack by node, newest first; none without it. Raises EngineError."""
    form = "\t".join(f"{{{{.{field}}}}}" for field in _FIELDS)
    try:
        return parse_tasks(stack, docker("stack", "ps", stack, "--no-trunc", "--format", form).splitlines())
    except EngineError as error:
        if _NOTHING in str(error):
            return {}
        raise


def parse_tasks(stack: str, lines: Iterable[str]) -> dict[str, list[Task]]:
    """Parse the output of `docker stack ps`: tasks by node, the newest first."""
    tasks: dict[str, list[Task]] = {}
    for line in lines:
        fields = line.split("\t")
        if len(fields) < len(_FIELDS):
            continue
        identity, name, machine, wanted, state, error = fields[: len(_FIELDS)]
        node = name.removeprefix("\\_ ").removeprefix(f"{stack}_").rpartition(".")[0]
        task = Task(identity, node, machine, wanted.lower(), state.partition(" ")[0].lower(), error.strip('"'))
        tasks.setdefault(node, []).append(task)
    return tasks


# -- nodes -------------------------------------------------------------------------------------------------------


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


class Services(DeployedNodes[Service]):
    """The services of one stack. In lock-step a run does not survive its router."""

    router_s = 90.0
    grace_s = STOP_GRACE_S
    kill_s = 0.0  # the stack's removal kills

    def __init__(self, engine: Swarm, context: RunContext, stack: ExitStack) -> None:
        super().__init__(context, stack)
        self._engine = engine
        self._stack = documents.stack_name(context.run_id)
        self._here = ""  # this machine's name in the swarm
        self._router: Task | None = None
        self._routerless_since: float | None = None
        self._kept: set[str] = set()
        self._looked = float("-inf")  # when Docker answered last

    def _service(self, node: str) -> str:
        return documents.service_name(self.context.run_id, node)

    # -- startup -------------------------------------------------------------------------------------------------

    def prepare(self) -> dict[str, Any]:
        return {"image": self._engine.image, "stack": self._stack}

    def remove(self) -> None:
        self._engine.down(self.context.folder, self.context.record)

    def router_hosts(self) -> list[str]:
        return [ROUTER, "127.0.0.1"]  # for the nodes, and for the launcher

    def start_router(self, deployment: Deployment) -> str:
        context, resolved, place = self.context, self.context.resolved, self._engine.place
        if deployment.folder is not None:
            check_size(write_settings(deployment.folder / ROUTER, deployment.router))
        here, port = machines()[0], free_port()
        self._here = here.name
        content = documents.stack_text(
            resolved,
            context.run_id,
            image=image_reference(self._engine.image),
            port=port,
            here=here.id,
            secure=context.secure,
            place=placement(place, resolved.nodes),
            pinned=pinned(resolved.steps),
            absent=Timetable(resolved, lockstep=resolved.mode == "lockstep").absent,
            environment=numeric_environment(),
            patience_s=self._engine.patience_s,
        )
        file = context.folder / documents.STACK_FILE
        file.write_text(content, encoding="utf-8")
        docker("stack", "deploy", "--compose-file", str(file), *_detach_options(), self._stack)
        self.stack.callback(_append_log, self._service(ROUTER), self.logs / f"{ROUTER}.log")
        deployment.close()  # from now on the swarm keeps the keys, until the stack is removed
        return f"tcp/127.0.0.1:{port}"

    def open_session(self, endpoint: str, deployment: Deployment) -> zenoh.Session:
        try:
            return super().open_session(endpoint, deployment)
        except EngineError as error:
            reasons = [task.error for task in tasks_of(self._stack).get(ROUTER, []) if task.error]
            raise EngineError(f"{error}{f'; Docker says: {reasons[0]}' if reasons else ''}") from None

    # -- supervision ---------------------------------------------------------------------------------------------

    def start(self, name: str, spec: NodeSpec) -> None:
        """Start a node; raises EngineError for a node that is not in the stack."""
        if not docker("service", "inspect", "--format", "{{.ID}}", self._service(name), check=False).strip():
            raise EngineError(f"{name}: the stack {self._stack} has no such service, and gets none while it runs")
        self.start_all({name: spec})
        self._scale([self.children[name]], 1)

    def start_all(self, specs: Mapping[str, NodeSpec]) -> None:
        """Adopt nodes, which were started with the stack and wait for the launcher."""
        for name, spec in specs.items():
            self.children[name] = Service(name, spec, self._service(name))
            (self.logs / f"{name}.log").touch()

    def _restart(self, child: Service) -> None:
        task = child.task
        self.keep_logs([child])
        if task is not None and task.exit and child.spec.on_exit == "restart" and child.scaled:
            child.over.add(task.id)  # Docker makes another
        else:
            self._scale([child], 0)
            self._until_gone(child)
            child.over |= {old_task.id for old_task in child.tasks}
            self._scale([child], 1)
        child.last = child.waits_since = None

    def end_now(self, child: Service) -> None:
        self.resume([child])  # a paused container cannot be killed
        self._look()
        if child.exit is None:
            container = self._container(child, "killed")
            self.keep_logs([child])
            docker("kill", container)
        child.last = -9 if child.exit is None else child.exit
        self._scale([child], 0)  # or Docker would restart it
        self._until_gone(child)

    def _suspend(self, child: Service) -> None:
        docker("pause", self._container(child, "paused"))

    def _resume(self, children: Iterable[Service]) -> None:
        for child in children:
            docker("unpause", child.container(), check=False)

    def signal(self, children: list[Service], word: str) -> None:
        """Ask nodes to leave; others are killed with the stack."""
        if word == "KILL":
            for child in children:
                child.last = -9
            return
        here = [child for child in children if child.task is not None and child.task.machine == self._here]
        if here:  # their containers and logs stay
            docker("kill", "--signal", "TERM", *(child.container() for child in here), check=False)
        if elsewhere := [child for child in children if child not in here]:
            self.keep_logs(elsewhere)
            self._scale(elsewhere, 0)

    def running(self) -> list[Service]:
        """The running nodes; raises EngineError if one has no machine or the router ended."""
        running = super().running()
        for child in self.children.values():
            task = child.task
            if child.exit is not None or (task is not None and not task.waits):
                child.waits_since = None
            elif child.waits_since is None:
                child.waits_since = time.monotonic()
            elif time.monotonic() - child.waits_since > _UNPLACED_S:
                why = task.error if task else "it has made no task for it"
                raise EngineError(f"{child.name}: Docker has found no machine for it in {_UNPLACED_S:.0f} s: {why}")
        return running

    def look(self) -> None:
        if time.monotonic() - self._looked >= _LOOK_EVERY_S:
            self._look()

    def _look(self) -> None:
        """Update the tasks from Docker."""
        try:
            tasks_by_node = tasks_of(self._stack)
        except EngineError:
            if time.monotonic() - self._looked > _SILENT_S:
                raise
            return
        self._looked = time.monotonic()
        self._router = next(iter(tasks_by_node.get(ROUTER, ())), None)
        for child in self.children.values():
            former, child.tasks = child.task, tasks_by_node.get(child.name, [])
            if former is not None and child.task is None and child.last is None and not child.scaled:
                child.last = former.exit if former.exit is not None else _ASKED_TO_END

    def router_ended(self) -> str | None:
        router = self._router
        if router is None or router.exit is None:
            self._routerless_since = None
            return None
        if self._routerless_since is None:
            self._routerless_since = time.monotonic()
        returns = documents.router_exit(self.context.resolved.mode) == "restart"
        if returns and time.monotonic() - self._routerless_since <= _ROUTERLESS_S:
            return None
        return f" has ended: {router.refused or how_ended(router.exit)}"

    def _scale(self, children: Iterable[Service], to: int) -> None:
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

    def keep_logs(self, children: Iterable[Service]) -> None:
        """Append the logs of the current tasks to the nodes' logs, each task once."""
        wanted = []
        for child in children:
            if child.task is not None and child.task.id not in self._kept:
                self._kept.add(child.task.id)
                wanted.append((child.task.id, self.logs / f"{child.name}.log", child.task.refused))
        if wanted:
            with ThreadPoolExecutor(AT_A_TIME) as pool:
                list(pool.map(lambda arguments: _append_log(*arguments), wanted))


def _append_log(task: str, path: Path, refused: str = "") -> None:
    """Append a task's or service's log to a file, or `refused`: why it did not start."""
    with path.open("ab") as log:
        if refused:
            log.write(f"{refused}\n".encode())
            return
        try:
            words = ["docker", "service", "logs", "--raw", task]
            subprocess.run(words, stdout=log, check=False, timeout=_LOG_S, **TO_LOG)
        except subprocess.TimeoutExpired:
            log.write(b"(Docker did not return all of it)\n")
