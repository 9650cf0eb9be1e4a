"""`mast deploy up --engine compose`: nodes as containers of this machine."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import threading
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from mast_zenoh.config.resolved import Resolved
from mast_zenoh.deploy import credentials, image, numeric_environment
from mast_zenoh.deploy import docker as engine
from mast_zenoh.deploy.compose import document
from mast_zenoh.deploy.compose.containers import Containers
from mast_zenoh.deploy.docker import docker
from mast_zenoh.deploy.joining import join
from mast_zenoh.errors import EngineError
from mast_zenoh.launch import folder as run_folder
from mast_zenoh.launch.context import Mesh, RunContext
from mast_zenoh.launch.engine import Engine
from mast_zenoh.security import levels

_ROUTER_S = 60.0  # for the router to come up
_MAKE_S = 600.0  # for docker-compose to make networks and containers
_ATTACHED = "{{range .Containers}}{{.Name}} {{end}}"
_REMOVAL_TIMEOUT_S = 20.0  # for networks and volumes to become unused and be removed


class Compose(Engine):
    """Containers of this machine.

    image:      image of the containers, see `image.build`
    patience_s: how long they run without the launcher, s
    """

    name = "compose"
    unplugs = True

    def __init__(self, image: str = image.TAG, patience_s: float = 10.0) -> None:
        self.image = image
        self.patience_s = patience_s

    def check(self, resolved: Resolved, secure: str) -> None:
        engine.check()
        command()
        image.check(self.image)
        document.check_names(resolved)

    def join(self, context: RunContext, stack: ExitStack) -> Mesh:
        run, folder = context.run_id, context.folder
        context.record["deployment"] = {"engine": self.name, "image": self.image, "label": f"{document.LABEL}={run}"}
        run_folder.write_json(folder / "run.json", context.record)
        stack.callback(self.down, folder, context.record)
        deployment = stack.enter_context(credentials.deployment(context))
        user = _user()
        if deployment.folder is not None:
            _hand_over(deployment.folder, deployment.router, user)
        content = document.text(
            context.resolved,
            run,
            image=self.image,
            secure=context.secure,
            user=user,
            environment=numeric_environment.environment(),
            patience_s=self.patience_s,
        )
        (folder / document.FILE).write_text(content, encoding="utf-8")
        project = [*command(), "--project-name", document.project(run), "--file", str(folder / document.FILE)]
        engine.run([*project, "up", "--no-start"], timeout=_MAKE_S)
        router = document.container(run, document.ROUTER)
        supervisor = stack.enter_context(
            Containers(f"{document.LABEL}={run}", lambda name: document.container(run, name), folder / "logs", router)
        )
        # By Compose itself: 1.29 connects a container to its other networks when it starts it.
        engine.run([*project, "up", "--detach", "--no-deps", document.ROUTER], timeout=_MAKE_S)
        stack.callback(_keep_log, router, folder / "logs" / f"{document.ROUTER}.log")
        endpoint = levels.endpoint(context.secure, f"tcp/{_published(router)}")
        context.record["endpoint"] = endpoint
        session = join(endpoint, deployment.launcher, _ROUTER_S, lambda: context.signals)
        return Mesh(stack.enter_context(session), supervisor, deployment)

    @classmethod
    def status(cls, folder: Path, record: dict[str, Any]) -> list[dict[str, str]]:
        label = record["deployment"]["label"]
        lines = docker("ps", "--all", "--filter", f"label={label}", "--format", "{{.Names}}\t{{.Status}}").splitlines()
        rows = (line.partition("\t") for line in sorted(lines))
        start = len(document.container(record["id"], ""))
        return [{"node": name[start:], "state": state, "where": name} for name, _, state in rows]

    @classmethod
    def logs(cls, folder: Path, record: dict[str, Any], node: str | None, *, follow: bool) -> None:
        """The logs of containers that are gone are in the run folder."""
        containers = {entry["node"]: entry["where"] for entry in cls.status(folder, record)}
        names = [node] if node else sorted(path.stem for path in (folder / "logs").glob("*.log")) or list(containers)
        if follow and node in containers:
            subprocess.run(["docker", "logs", "--follow", containers[node]], check=False, stdin=subprocess.DEVNULL)
            return
        for name in names:
            path = folder / "logs" / f"{name}.log"
            lines = path.read_text(errors="replace").splitlines() if path.is_file() else []
            if not lines and name in containers:
                lines = docker("logs", containers[name], check=False).splitlines()
            sys.stdout.writelines(f"{name}  {line}\n" for line in lines)

    @classmethod
    def down(cls, folder: Path, record: dict[str, Any]) -> None:
        shutil.rmtree(folder / document.CREDENTIALS, ignore_errors=True)
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


def _user() -> str:
    """UID:GID of the processes inside: this user's, to read credentials, unless root."""
    return f"{os.getuid()}:{os.getgid()}" if os.getuid() else image.USER


def _hand_over(folder: Path, router: dict[str, Any], user: str) -> None:
    """Write the router's settings with its key; the user inside owns all credentials."""
    credentials.write_settings(folder, router)
    if not os.getuid():
        uid, gid = map(int, user.split(":"))
        for path in folder.rglob("*"):
            os.chown(path, uid, gid)


def _published(router: str) -> str:
    """Address and port of the router on this machine."""
    deadline = time.monotonic() + _ROUTER_S
    while not (addresses := docker("port", router, f"{document.PORT}/tcp", check=False).split()):
        if time.monotonic() > deadline:
            last_line = docker("logs", "--tail", "1", router, check=False).strip()
            raise EngineError(f"the router's container {router} does not run{f': {last_line}' if last_line else ''}")
        threading.Event().wait(0.2)
    return addresses[0]


def _keep_log(router: str, path: Path) -> None:
    """Write the router's log at the end of the run."""
    done = subprocess.run(
        ["docker", "logs", router], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, check=False, timeout=60
    )
    path.write_bytes(done.stdout)
