"""Starts, watches, pauses, disconnects and ends the nodes of a run in containers."""

from __future__ import annotations

import json
import subprocess
import threading
import time
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from mast_zenoh.config.resolved import NodeSpec
from mast_zenoh.deploy.compose.document import ROUTER
from mast_zenoh.deploy.docker import docker
from mast_zenoh.deploy.joining import router_ended
from mast_zenoh.errors import EngineError
from mast_zenoh.launch.supervisor import Child, Supervisor

_AT_A_TIME = 4  # commands to the engine
_LOG_GRACE_S = 5.0  # from the end of a container to the end of its log
_END_S = 30.0  # longest time from a SIGKILL to the end of a container


class Container(Child):
    """A node's container."""

    def __init__(self, name: str, spec: NodeSpec, container: str) -> None:
        super().__init__(name, spec)
        self.container = container
        self.code: int | None = None
        self.ended_now = threading.Event()
        self.log: subprocess.Popen[bytes] | None = None
        self.networks: dict[str, list[str]] = {}  # that it was disconnected from, with the options to reconnect

    @property
    def exit(self) -> int | None:
        return None if self.code is None else _signed(self.code)

    def where(self) -> dict[str, Any]:
        return {"container": self.container}


class Containers(Supervisor[Container]):
    """The containers of one run; a context manager that notices containers that end.

    label: `KEY=VALUE` of all containers of the run; container: gives the name of a node's container
    logs:  folder for the nodes' output; router: name of the router's container
    """

    def __init__(self, label: str, container: Callable[[str], str], logs: Path, router: str) -> None:
        super().__init__()
        self._router = router
        self._router_code: int | None = None
        self._container = container
        self._logs = logs
        self._by_container: dict[str, Container] = {}
        self._events = _Events(label, self._died)

    def __enter__(self) -> Containers:
        self._events.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._events.close()
        for child in self.children.values():
            self.dispose(child)

    def start(self, name: str, spec: NodeSpec) -> None:
        """Start a node; raises EngineError for a node without a container."""
        self.start_all({name: spec})

    def start_all(self, specs: Mapping[str, NodeSpec]) -> None:
        """Start nodes, several at a time."""
        children = []
        for name, spec in specs.items():
            child = Container(name, spec, self._container(name))
            self._by_container[child.container] = child
            self.children[name] = child
            children.append(child)
        with ThreadPoolExecutor(_AT_A_TIME) as pool:
            list(pool.map(self._run, children))

    def _restart(self, child: Container) -> None:
        self._await_log(child)
        self.connect([child])
        child.code = None
        child.ended_now.clear()
        self._run(child)

    def _run(self, child: Container) -> None:
        since = f"{time.time():.6f}"
        try:
            docker("start", child.container)
        except EngineError as error:
            child.notes.append(str(error))
            child.code = 125  # as from `docker run`
            child.ended_now.set()
            with (self._logs / f"{child.name}.log").open("a") as log:
                log.write(f"{error}\n")
            return
        with (self._logs / f"{child.name}.log").open("ab") as log:
            child.log = subprocess.Popen(
                ["docker", "logs", "--follow", "--since", since, child.container],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )

    def end_now(self, child: Container) -> None:
        self.resume([child])  # a paused container cannot be killed
        docker("kill", child.container, check=False)
        if not child.ended_now.wait(_END_S):
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

    def running(self) -> list[Container]:
        """The running nodes; raises EngineError if the router has ended."""
        if self._router_code is not None:
            raise router_ended("the router", _signed(self._router_code), ROUTER)
        return super().running()

    def newly_ended(self) -> list[Container]:
        """Nodes that have ended since the last call; their logs are complete."""
        ended = super().newly_ended()
        for child in ended:
            self._await_log(child)
        return ended

    def dispose(self, child: Container) -> None:
        self._await_log(child)

    def end(self, grace_s: float) -> None:
        """Resume and reconnect all nodes, then end them: SIGTERM, wait, SIGKILL."""
        self.resume(super().running())
        self.connect(super().running())
        for word in ("TERM", "KILL"):
            running = super().running()
            if not running:
                break
            for child in running:
                child.notes.append(f"told to leave by SIG{word}")
            docker("kill", "--signal", word, *(child.container for child in running), check=False)
            deadline = time.monotonic() + (grace_s if word == "TERM" else _END_S)
            for child in running:
                child.ended_now.wait(max(0.0, deadline - time.monotonic()))

    def _died(self, container: str, code: int) -> None:
        if container == self._router:
            self._router_code = code
        child = self._by_container.get(container)
        if child is not None and child.code is None:
            child.code = code
            child.ended_now.set()

    def _await_log(self, child: Container) -> None:
        log, child.log = child.log, None
        if log is None:
            return
        try:
            log.wait(_LOG_GRACE_S)
        except subprocess.TimeoutExpired:
            log.kill()
            log.wait()


def _signed(code: int) -> int:
    """Docker's exit code in Python's form: negative for a signal instead of plus 128."""
    return code if code <= 128 else 128 - code


def connected_as(settings: Mapping[str, Any]) -> list[str]:
    """`docker network connect` options that restore a container's names and addresses.

    settings: its part of `docker inspect`; only addresses that were requested are restored
    """
    requested = settings.get("IPAMConfig") or {}
    addresses = (("--ip", requested.get("IPv4Address")), ("--ip6", requested.get("IPv6Address")))
    words = [word for option, address in addresses if address for word in (option, address)]
    return [*words, *(word for alias in settings.get("Aliases") or () for word in ("--alias", alias))]


class _Events:
    """Reports the containers of a run that end, from the Docker engine's events."""

    def __init__(self, label: str, died: Callable[[str, int], None]) -> None:
        self._label = label
        self._died = died
        self._since = time.time()
        self._closed = False
        self._process: subprocess.Popen[str] | None = None
        self._thread = threading.Thread(target=self._listen, name="container events")

    def start(self) -> None:
        """Start listening."""
        self._thread.start()

    def close(self) -> None:
        """Stop listening."""
        self._closed = True
        if self._process is not None:
            self._process.kill()
        self._thread.join()

    def _listen(self) -> None:
        """Run `docker events`, again if it ends because the engine was restarted."""
        words = ["docker", "events", "--filter", f"label={self._label}", "--filter", "event=die"]
        while not self._closed:
            since = ["--since", f"{self._since:.6f}"]
            self._process = subprocess.Popen(
                [*words, *since, "--format", "{{json .}}"],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                text=True,
                start_new_session=True,
            )
            if self._closed:
                self._process.kill()
            assert self._process.stdout is not None
            with self._process, self._process.stdout as lines:
                for line in lines:
                    event = json.loads(line)
                    self._since = event["timeNano"] * 1e-9 + 2e-6  # not this one again
                    attributes = event["Actor"]["Attributes"]
                    self._died(attributes["name"], int(attributes["exitCode"]))
            threading.Event().wait(0.0 if self._closed else 0.5)
