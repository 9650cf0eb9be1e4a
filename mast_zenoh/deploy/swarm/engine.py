"""`mast deploy up --engine swarm`: nodes as services on the machines of a swarm."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from mast_zenoh.config.resolved import Resolved
from mast_zenoh.deploy import credentials, numeric_environment
from mast_zenoh.deploy import docker as dockerd
from mast_zenoh.deploy import image as images
from mast_zenoh.deploy.addresses import free_port
from mast_zenoh.deploy.docker import docker
from mast_zenoh.deploy.joining import join
from mast_zenoh.deploy.swarm import document, placement, tasks
from mast_zenoh.deploy.swarm import stack as stacks
from mast_zenoh.deploy.swarm.logs import keep_log
from mast_zenoh.deploy.swarm.services import Services
from mast_zenoh.errors import EngineError
from mast_zenoh.launch import folder as run_folder
from mast_zenoh.launch.context import Mesh, RunContext
from mast_zenoh.launch.engine import Engine
from mast_zenoh.runtime.protocol.timetable import Timetable
from mast_zenoh.security import levels

_ROUTER_S = 90.0  # for the router to come up


class Swarm(Engine):
    """Services of the swarm that this machine manages.

    image:      image of the services, see `image.build`
    patience_s: how long they run without the launcher or the router, s: Docker restarts the router
    place:      by pattern of nodes' names, the value of the label `mast.host` of their machine; Docker spreads the
                others
    """

    name = "swarm"

    def __init__(
        self, image: str = images.TAG, patience_s: float = 30.0, place: Mapping[str, str] | None = None
    ) -> None:
        self.image = image
        self.patience_s = patience_s
        self.place = dict(place or {})

    def check(self, resolved: Resolved, secure: str) -> None:
        dockerd.check()
        check_here()
        check_manager()
        images.check(self.image)
        document.check_names(resolved)
        place = placement.resolve(self.place, resolved.nodes)
        placement.check(placement.machines(), place, placement.pinned(resolved.steps))

    def join(self, context: RunContext, stack: ExitStack) -> Mesh:
        run, folder, resolved = context.run_id, context.folder, context.resolved
        name = document.stack(run)
        context.record["deployment"] = {"engine": self.name, "image": self.image, "stack": name}
        run_folder.write_json(folder / "run.json", context.record)
        stack.callback(self.down, folder, context.record)
        deployment = stack.enter_context(credentials.deployment(context))
        if deployment.folder is not None:
            check_size(credentials.write_settings(deployment.folder, deployment.router))
        here, port = placement.machines()[0], free_port()
        content = document.text(
            resolved,
            run,
            image=reference(self.image),
            port=port,
            here=here.id,
            secure=context.secure,
            place=placement.resolve(self.place, resolved.nodes),
            pinned=placement.pinned(resolved.steps),
            absent=Timetable(resolved, lockstep=resolved.mode == "lockstep").absent,
            environment=numeric_environment.environment(),
            patience_s=self.patience_s,
        )
        (folder / document.FILE).write_text(content, encoding="utf-8")
        docker("stack", "deploy", "--compose-file", str(folder / document.FILE), *_detach_options(), name)
        stack.callback(keep_log, document.service(run, document.ROUTER), folder / "logs" / f"{document.ROUTER}.log")
        deployment.close()  # from now on the swarm keeps the keys, until the stack is removed
        endpoint = context.record["endpoint"] = levels.endpoint(context.secure, f"tcp/127.0.0.1:{port}")
        try:
            session = join(endpoint, deployment.launcher, _ROUTER_S, lambda: context.signals)
        except EngineError as error:
            reasons = [task.error for task in tasks.of(name).get(document.ROUTER, []) if task.error]
            raise EngineError(f"{error}{f'; Docker says: {reasons[0]}' if reasons else ''}") from None
        logs = folder / "logs"
        supervisor = Services(name, lambda node: document.service(run, node), here.name, logs, resolved.mode)
        return Mesh(stack.enter_context(session), supervisor, deployment)

    @classmethod
    def status(cls, folder: Path, record: dict[str, Any]) -> list[dict[str, str]]:
        tasks_by_node = tasks.of(record["deployment"]["stack"])
        return [
            {
                "node": node,
                "state": f"{node_tasks[0].state} {node_tasks[0].error}".strip(),
                "where": node_tasks[0].machine,
            }
            for node, node_tasks in sorted(tasks_by_node.items())
        ]

    @classmethod
    def logs(cls, folder: Path, record: dict[str, Any], node: str | None, *, follow: bool) -> None:
        """Print logs; a removed stack's logs are in the run folder."""
        tasks_by_node = tasks.of(record["deployment"]["stack"])
        names = [node] if node else sorted({*tasks_by_node, *(path.stem for path in (folder / "logs").glob("*.log"))})
        if follow and node in tasks_by_node:
            words = ["docker", "service", "logs", "--raw", "--follow", document.service(record["id"], node)]
            subprocess.run(words, check=False, stdin=subprocess.DEVNULL)
            return
        for name in names:
            path = folder / "logs" / f"{name}.log"
            lines = path.read_text(errors="replace").splitlines() if path.is_file() else []
            if name in tasks_by_node:
                command = ["docker", "service", "logs", "--raw", document.service(record["id"], name)]
                done = subprocess.run(
                    command, check=False, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, timeout=60
                )
                lines = done.stdout.splitlines()
            sys.stdout.writelines(f"{name}  {line}\n" for line in lines)

    @classmethod
    def down(cls, folder: Path, record: dict[str, Any]) -> None:
        shutil.rmtree(folder / document.CREDENTIALS, ignore_errors=True)
        stacks.remove(record["deployment"]["stack"])


def check_here(launcher_environment: Mapping[str, str] = os.environ) -> None:
    """Raise EngineError if DOCKER_HOST is another machine: the router would run there."""
    where = launcher_environment.get("DOCKER_HOST", "")
    if where and not where.startswith(("unix://", "npipe://")):
        raise EngineError(f"DOCKER_HOST is {where}: expected the engine of this machine; start the run on that machine")


def check_manager() -> None:
    """Raise EngineError if this machine does not manage a swarm."""
    state, _, manages = docker("info", "--format", "{{.Swarm.LocalNodeState}} {{.Swarm.ControlAvailable}}").partition(
        " "
    )
    if state == "inactive":
        raise EngineError(
            "this machine is not in a swarm: create one with `docker swarm init --advertise-addr 127.0.0.1`, or "
            "with an address that other machines reach"
        )
    if state != "active":
        raise EngineError(f"the swarm of this machine is {state}: expected active; see `docker info`")
    if manages.strip() != "true":
        raise EngineError(
            "this machine is a worker of its swarm: start the run on a manager, or `docker node promote` it"
        )


def reference(image: str) -> str:
    """The exact image for every machine: its digest if a registry has it, else its id.

    With the name alone, every machine would look it up in a registry.
    """
    digests, _, identity = docker("image", "inspect", "--format", "{{json .RepoDigests}}\t{{.Id}}", image).partition(
        "\t"
    )
    known = json.loads(digests)
    return str(known[0]) if known else identity.strip()


def check_size(settings: Path) -> None:
    """Raise EngineError if the router's settings are too large for a secret."""
    if (size := settings.stat().st_size) > document.LARGEST_SECRET:
        raise EngineError(
            f"the router's settings, with the rights of all nodes, are {size} bytes: a secret of a swarm is at most "
            f"{document.LARGEST_SECRET}; use the security level mtls, which has no rights, or fewer nodes"
        )


def _detach_options() -> list[str]:
    """Options that keep `docker stack deploy` from waiting and from asking a registry."""
    client = docker("version", "--format", "{{.Client.Version}}").partition(".")[0]
    return ["--resolve-image", "never", *(["--detach=true"] if client.isdigit() and int(client) >= 26 else [])]
