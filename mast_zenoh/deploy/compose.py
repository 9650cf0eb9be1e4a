"""Engine `compose`: nodes as containers of this machine, made by docker-compose (1.29 or 2)."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from mast_zenoh.config.resolved import NodeSpec, Resolved
from mast_zenoh.deploy import documents
from mast_zenoh.deploy.docker import TAG, USER, check, check_image, docker, exit_code, run
from mast_zenoh.deploy.documents import LABEL, PORT, ROUTER
from mast_zenoh.deploy.engine import CREDENTIALS, DeployedNodes, DeploymentEngine, numeric_environment, write_settings
from mast_zenoh.errors import EngineError
from mast_zenoh.launch.context import RunContext
from mast_zenoh.launch.processes import end_process
from mast_zenoh.launch.supervisor import Child, how_ended
from mast_zenoh.mesh.security.deployment import Deployment

_MAKE_S = 600.0  # for docker-compose to make networks and containers
_LOG_S = 60.0  # for Docker to print a log
_LOG_GRACE_S = 5.0  # from the end of a container to the end of its log
_REMOVAL_TIMEOUT_S = 20.0  # for networks and volumes to become unused and be removed
_ATTACHED = "{{range .Containers}}{{.Name}} {{end}}"
_STATE = "{{.State.Running}} {{.State.ExitCode}}"

#: Commands to the Docker engine at a time.
_AT_A_TIME = 4

#: Options of a process whose standard output is a log: so are its errors, and Ctrl-C does not interrupt it.
_TO_LOG: dict[str, Any] = {"stdin": subprocess.DEVNULL, "stderr": subprocess.STDOUT, "start_new_session": True}


class Compose(DeploymentEngine):
    """Containers of this machine.

    image:      image of the containers, see `docker.build_image`
    patience_s: how long they run without the launcher, s
    """

    name = "compose"
    unplugs = True

    def __init__(self, image: str = TAG, patience_s: float = 30.0) -> None:
        self.image = image
        self.patience_s = patience_s

    def check(self, resolved: Resolved, secure: str) -> None:
        check()
        command()
        documents.check_names(resolved)
        check_image(self.image)

    def nodes(self, context: RunContext, stack: ExitStack) -> Containers:
        return Containers(self, context, stack)

    @classmethod
    def status(cls, folder: Path, record: dict[str, Any]) -> list[dict[str, str]]:
        label = record["deployment"]["label"]
        lines = docker("ps", "--all", "--filter", f"label={label}", "--format", "{{.Names}}\t{{.Status}}").splitlines()
        start = len(documents.container(record["id"], ""))
        rows = (line.partition("\t") for line in sorted(lines))
        return [{"node": name[start:], "state": state, "where": name} for name, _, state in rows]

    @classmethod
    def logs(cls, folder: Path, record: dict[str, Any], node: str | None, *, follow: bool) -> None:
        """Print logs; those of containers that are gone are in the run folder."""
        existing = [row["node"] for row in cls.status(folder, record)]
        files = {path.stem: path for path in (folder / "logs").glob("*.log")}
        for name in [node] if node else sorted({*existing, *files}):
            lines: list[str] = []
            if name in existing:
                command = ["docker", "logs", documents.container(record["id"], name)]
                if follow and node:
                    subprocess.run([*command, "--follow"], check=False, stdin=subprocess.DEVNULL)
                    return
                pipe, both = subprocess.PIPE, subprocess.STDOUT
                done = subprocess.run(command, check=False, text=True, stdout=pipe, stderr=both, timeout=_LOG_S)
                lines = done.stdout.splitlines()
            if not lines and name in files:
                lines = files[name].read_text(errors="replace").splitlines()
            sys.stdout.writelines(f"{name}  {line}\n" for line in lines)

    @classmethod
    def down(cls, folder: Path, record: dict[str, Any]) -> None:
        shutil.rmtree(folder / CREDENTIALS, ignore_errors=True)
        label = f"label={record['deployment']['label']}"
        if containers := docker("ps", "--all", "--quiet", "--filter", label).split():
            docker("rm", "--force", "--volumes", *containers)
        deadline = time.monotonic() + _REMOVAL_TIMEOUT_S
        for kind in ("network", "volume"):
            while left := docker(kind, "ls", "--quiet", "--filter", label).split():
                if kind == "network":
                    _detach_all(left)
                # A container that ended a moment ago may still be on its networks.
                docker(kind, "rm", *left, check=time.monotonic() > deadline)
                threading.Event().wait(0.2)


def _detach_all(networks: list[str]) -> None:
    """Force everything off these networks: the engine can keep the endpoint of a container that no longer exists."""
    for network in networks:
        attached = docker("network", "inspect", "--format", _ATTACHED, network, check=False)
        for name in attached.split():
            docker("network", "disconnect", "--force", network, name, check=False)


def command() -> list[str]:
    """The command of Compose on this machine; raises EngineError if there is none."""
    if shutil.which("docker-compose"):
        return ["docker-compose"]
    try:
        docker("compose", "version", timeout=20.0)
    except EngineError:
        raise EngineError("there is no docker-compose on this machine: install docker-compose, 1.29 or newer") from None
    return ["docker", "compose"]


class Container(Child):
    """A container of a node or of the router, which may not have been started yet.

    log: the process that appends its output to its log, until it ends
    """

    def __init__(self, name: str, spec: NodeSpec, container: str, log: Path) -> None:
        super().__init__(name, spec)
        self.container = container
        self.code: int | None = None
        self.log = log
        self.follower: subprocess.Popen[bytes] | None = None
        self.networks: dict[str, list[str]] = {}  # that it was disconnected from, with the options to reconnect

    @property
    def exit(self) -> int | None:
        return self.code

    def where(self) -> dict[str, Any]:
        return {"container": self.container}

    def follow(self, since: float) -> None:
        """Append its output since a time to its log."""
        words = ["docker", "logs", "--follow", "--since", f"{since:.6f}", self.container]
        with self.log.open("ab") as log:
            self.follower = subprocess.Popen(words, stdout=log, **_TO_LOG)

    def close(self) -> None:
        """End the process that follows its output."""
        if self.follower is not None:
            end_process(self.follower, _LOG_GRACE_S)

    def look(self) -> None:
        """Find out whether it has ended, if its output has."""
        if self.follower is None or self.follower.poll() is None:
            return
        running, _, code = docker("inspect", "--format", _STATE, self.container, check=False).partition(" ")
        if running == "true":  # the Docker engine was restarted
            self.follow(time.time())
        else:
            self.code, self.follower = exit_code(int(code or 137)), None


class Containers(DeployedNodes[Container]):
    """The containers of one run."""

    def __init__(self, engine: Compose, context: RunContext, stack: ExitStack) -> None:
        super().__init__(context, stack)
        self._engine = engine
        self._router = self._container(ROUTER, NodeSpec(ROUTER, "", "", {}, "fail"))

    def _container(self, name: str, spec: NodeSpec) -> Container:
        return Container(name, spec, documents.container(self.context.run_id, name), self.logs / f"{name}.log")

    # -- startup -------------------------------------------------------------------------------------------------

    def prepare(self) -> dict[str, Any]:
        return {"image": self._engine.image, "label": f"{LABEL}={self.context.run_id}"}

    def remove(self) -> None:
        self._engine.down(self.context.folder, self.context.record)
        for child in (self._router, *self.children.values()):
            child.close()

    def router_hosts(self) -> list[str]:
        return [ROUTER, "127.0.0.1"]  # for the nodes, and for the launcher

    def start_router(self, deployment: Deployment) -> str:
        user = f"{os.getuid()}:{os.getgid()}" if os.getuid() else USER  # who can read the credentials
        if deployment.folder is not None:
            hand_over(deployment.folder, deployment.router, user)
        content = documents.compose_text(
            self.context.resolved,
            self.context.run_id,
            image=self._engine.image,
            secure=self.context.secure,
            user=user,
            environment=numeric_environment(),
            patience_s=self._engine.patience_s,
        )
        file = self.context.folder / documents.COMPOSE_FILE
        file.write_text(content, encoding="utf-8")
        project = [*command(), "--project-name", documents.project(self.context.run_id), "--file", str(file)]
        run([*project, "up", "--no-start"], timeout=_MAKE_S)
        # By Compose itself: 1.29 connects a container to its other networks when it starts it.
        run([*project, "up", "--detach", "--no-deps", ROUTER], timeout=_MAKE_S)
        self._router.follow(0.0)
        return f"tcp/{self._published()}"

    def _published(self) -> str:
        """Address and port of the router on this machine."""
        deadline = time.monotonic() + self.router_s
        router = self._router.container
        while not (addresses := docker("port", router, f"{PORT}/tcp", check=False).split()):
            if time.monotonic() > deadline:
                last_line = docker("logs", "--tail", "1", router, check=False).strip()
                detail = f": {last_line}" if last_line else ""
                raise EngineError(f"the router's container {router} does not run{detail}")
            threading.Event().wait(0.2)
        return addresses[0]

    # -- supervision ---------------------------------------------------------------------------------------------

    def start(self, name: str, spec: NodeSpec) -> None:
        self.start_all({name: spec})

    def start_all(self, specs: Mapping[str, NodeSpec]) -> None:
        """Start nodes, several at a time."""
        children = {name: self._container(name, spec) for name, spec in specs.items()}
        self.children |= children
        with ThreadPoolExecutor(_AT_A_TIME) as pool:
            list(pool.map(self._run, children.values()))

    def _restart(self, child: Container) -> None:
        self.connect([child])
        child.code = None
        self._run(child)

    def _run(self, child: Container) -> None:
        since = time.time()
        try:
            docker("start", child.container)
        except EngineError as error:
            child.notes.append(str(error))
            child.code = 125  # as from `docker run`
            with child.log.open("a") as log:
                log.write(f"{error}\n")
        else:
            child.follow(since)

    def look(self) -> None:
        for child in (self._router, *self.children.values()):
            child.look()

    def router_ended(self) -> str | None:
        return None if self._router.code is None else f" has ended: {how_ended(self._router.code)}"

    def signal(self, children: list[Container], word: str) -> None:
        docker("kill", "--signal", word, *(child.container for child in children), check=False)

    def end_now(self, child: Container) -> None:
        self.resume([child])  # a paused container cannot be killed
        self.signal([child], "KILL")
        if not self.wait(lambda: child.code is not None, self.kill_s):
            raise EngineError(f"the container {child.container} does not end")

    def _suspend(self, child: Container) -> None:
        docker("pause", child.container)

    def _resume(self, children: Iterable[Container]) -> None:
        for child in children:
            docker("unpause", child.container, check=False)

    def disconnect(self, child: Container) -> None:
        networks = docker("inspect", "--format", "{{json .NetworkSettings.Networks}}", child.container)
        child.networks = {network: connected_as(settings) for network, settings in json.loads(networks).items()}
        child.cut_off = True
        for network in child.networks:
            docker("network", "disconnect", network, child.container)

    def connect(self, children: Iterable[Container]) -> None:
        """Reconnect nodes to their networks; failures are noted."""
        for child in children:
            if not child.cut_off:
                continue
            child.cut_off = False
            for network, words in child.networks.items():
                try:
                    docker("network", "connect", *words, network, child.container)
                except EngineError as error:
                    child.notes.append(f"not on {network} again: {error}")


def hand_over(folder: Path, router: Mapping[str, Any], user: str) -> None:
    """Write the router's settings with its key; the user inside owns all credentials."""
    write_settings(folder / ROUTER, router)
    if not os.getuid():
        uid, gid = map(int, user.split(":"))
        for path in folder.rglob("*"):
            os.chown(path, uid, gid)


def connected_as(settings: Mapping[str, Any]) -> list[str]:
    """`docker network connect` options that restore a container's names and addresses.

    settings: its part of `docker inspect`; only addresses that were requested are restored
    """
    requested = settings.get("IPAMConfig") or {}
    addresses = (("--ip", requested.get("IPv4Address")), ("--ip6", requested.get("IPv6Address")))
    words = [word for option, address in addresses if address for word in (option, address)]
    return [*words, *(word for alias in settings.get("Aliases") or () for word in ("--alias", alias))]
