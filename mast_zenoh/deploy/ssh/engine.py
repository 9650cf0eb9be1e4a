"""Engine `ssh`: nodes on hosts with an SSH server and Python, started and watched through the hosts' wardens."""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import posixpath
import shutil
import signal
import socket
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterable, Mapping
from contextlib import ExitStack
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import asyncssh
import zenoh

from mast_zenoh.config.resolved import NodeSpec, Resolved
from mast_zenoh.deploy.engine import (
    CREDENTIALS,
    ROUTER_SETTINGS,
    DeployedNodes,
    DeploymentEngine,
    free_port,
    numeric_environment,
)
from mast_zenoh.deploy.ssh import connection, hostsfile
from mast_zenoh.deploy.ssh.connection import LEAVE_S, WardenAttachment, ask_warden, attaching
from mast_zenoh.deploy.ssh.hostsfile import LAUNCHER, SshHost
from mast_zenoh.errors import EngineError, Interrupted
from mast_zenoh.launch.context import RunContext
from mast_zenoh.launch.processes import ENVIRONMENT
from mast_zenoh.launch.supervisor import Child, how_ended
from mast_zenoh.mesh.hosting import RUN
from mast_zenoh.mesh.security import levels
from mast_zenoh.mesh.security.credentials import ROUTER
from mast_zenoh.mesh.security.deployment import Deployment
from mast_zenoh.mesh.session import open_router

_ATTACH_S = 60.0
_ANSWER_S = 30.0  # from a command to its answer: a lost connection must be restored by then
_LATER_S = 5.0  # how much longer the warden runs without a launcher than the nodes


class Ssh(DeploymentEngine):
    """Hosts with an SSH server.

    hosts:      a file such as deploy/hosts.toml
    patience_s: how long nodes run without the launcher, s; None: the value in the file
    """

    name = "ssh"

    def __init__(self, hosts: Path = Path("deploy/hosts.toml"), patience_s: float | None = None) -> None:
        content = hostsfile.read(hosts)
        self.hosts = content if patience_s is None else replace(content, patience_s=patience_s)

    def check(self, resolved: Resolved, secure: str) -> None:
        """Check that all hosts with nodes or the router are reachable and suitable."""
        levels.check(secure)

        async def probe(host: SshHost, packages: connection.Packages) -> None:
            async with connection.connected(host) as ssh:
                await connection.probe(ssh, host, packages)

        with tempfile.TemporaryDirectory(prefix="mast-wheel-") as folder, connection.Loop() as loop:
            packages = connection.Packages(Path(folder))
            loop.run(connection.together(*(probe(host, packages) for host in self.hosts.used(resolved.nodes).values())))

    def nodes(self, context: RunContext, stack: ExitStack) -> RemoteNodes:
        return RemoteNodes(self.hosts, context, stack)

    @classmethod
    def status(cls, folder: Path, record: dict[str, Any]) -> list[dict[str, str]]:
        """The state of every node; for an unreachable host, the reason."""
        places = _places(record)

        async def states(host: SshHost, place: dict[str, Any]) -> list[dict[str, str]]:
            try:
                answer = await ask_warden(host, place, "state")
            except EngineError as error:
                return [{"node": name, "state": str(error), "where": host.name} for name in place["nodes"]]
            by_name = {node["node"]: node for node in (answer or {}).get("nodes", [])}
            return [_state_row(name, by_name.get(name), host) for name in {**dict.fromkeys(place["nodes"]), **by_name}]

        with connection.Loop() as loop:
            rows = itertools.chain(*loop.run(connection.together(*(states(host, place) for host, place in places))))
        return sorted(rows, key=lambda row: row["node"])

    @classmethod
    def logs(cls, folder: Path, record: dict[str, Any], node: str | None, *, follow: bool) -> None:
        """Print the run folder's logs, which the launcher writes, then logs only on the host."""
        names = [node] if node else sorted({name for _, place in _places(record) for name in place["nodes"]})
        printing = threading.Lock()
        offsets = {}
        for name in names:
            path = folder / "logs" / f"{name}.log"
            content = path.read_bytes() if path.is_file() else b""
            offsets[name] = len(content)
            _print(name, content, printing)

        async def more(host: SshHost, place: dict[str, Any]) -> None:
            host_offsets = {name: offsets[name] for name in place["nodes"] if name in offsets}
            if not host_offsets:
                return
            async with connection.connected(host) as ssh, ssh.create_process(attaching(place)) as process:
                # All logs up to now come before the answer.
                process.stdin.write(json.dumps({"as": "reader", "logs": host_offsets}) + "\n")
                if not follow:
                    process.stdin.write(json.dumps({"id": os.urandom(8).hex(), "do": "state"}) + "\n")
                async for message in connection.messages_of(process):
                    if "log" in message and message["log"] in host_offsets:
                        _print(message["log"], message["text"].encode("latin-1"), printing)
                    elif "answer" in message and not follow:
                        return

        with connection.Loop() as loop, contextlib.suppress(KeyboardInterrupt):
            loop.run(connection.together(*(more(host, place) for host, place in _places(record))))

    @classmethod
    def down(cls, folder: Path, record: dict[str, Any]) -> None:
        """End the run on all hosts; raises EngineError at the end for unreachable ones."""

        async def end(host: SshHost, place: dict[str, Any]) -> None:
            if await ask_warden(host, place, "leave", grace_s=1.0) is None:
                async with connection.connected(host) as ssh:
                    await connection.ask(ssh, host, "remove", place["run_folder"])

        shutil.rmtree(folder / CREDENTIALS, ignore_errors=True)
        with connection.Loop() as loop:
            loop.run(connection.together(*(end(host, place) for host, place in _places(record))))


# -- from the run folder alone -----------------------------------------------------------------------------------


def _places(record: Mapping[str, Any]) -> list[tuple[SshHost, dict[str, Any]]]:
    return [(SshHost(**place["reach"]), place) for place in record["deployment"]["hosts"].values()]


def _state_row(name: str, node: Mapping[str, Any] | None, host: SshHost) -> dict[str, str]:
    if node is None:
        return {"node": name, "state": "not there", "where": host.name}
    state = "running" if node["exit"] is None else f"ended ({node['exit']})"
    return {"node": name, "state": state, "where": f"{host.name}, process {node['pid']}"}


def _print(name: str, content: bytes, printing: threading.Lock) -> None:
    with printing:
        sys.stdout.writelines(f"{name}  {line}\n" for line in content.decode(errors="replace").splitlines())
        sys.stdout.flush()


# -- the nodes of a run ------------------------------------------------------------------------------------------


class RemoteNode(Child):
    """A node's process on a host; start: id of the command that started it last."""

    def __init__(self, name: str, spec: NodeSpec, attachment: WardenAttachment) -> None:
        super().__init__(name, spec)
        self.attachment = attachment
        self.start = ""

    @property
    def exit(self) -> int | None:
        """Exit code; a node whose host has lost its supervisor counts as killed."""
        return self.attachment.exit(self.name, self.start)

    @property
    def cpu_s(self) -> float | None:
        """As the supervisor on its host has measured it last."""
        state = self.attachment.state(self.name, self.start)
        return state.get("cpu_s") if state else None

    def where(self) -> dict[str, Any]:
        state = self.attachment.state(self.name, self.start)
        return {"host": self.attachment.host.name, "pid": state["pid"] if state else None}


class RemoteNodes(DeployedNodes[RemoteNode]):
    """The nodes of a run on all its hosts; a node that is added later runs on the first host.

    hosts_file: the content of hosts.toml
    """

    router = ROUTER
    grace_s = 5.0  # a node hands in its results over a network
    kill_s = 5.0  # an unreachable host ends its nodes by itself

    def __init__(self, hosts_file: hostsfile.HostsFile, context: RunContext, stack: ExitStack) -> None:
        super().__init__(context, stack)
        self.hosts_file = hosts_file
        self.placed = hosts_file.placed(context.resolved.nodes)
        self.hosts = hosts_file.used(context.resolved.nodes)
        self.loop = stack.enter_context(connection.Loop(context.signals))
        self.changed = threading.Condition()
        self.attachments: dict[str, WardenAttachment] = {}
        self.installed: dict[str, connection.Installed] = {}
        self.reached_from: dict[str, str] = {}  # our address, as each host sees it
        self.endpoints: dict[str, str] = {}
        self.port = hosts_file.router.port
        self.router_start: tuple[WardenAttachment, str] | None = None  # its host, and id of the command that started it

    # -- startup -------------------------------------------------------------------------------------------------

    def prepare(self) -> dict[str, Any]:
        with tempfile.TemporaryDirectory(prefix="mast-wheel-") as folder:
            packages = connection.Packages(Path(folder))
            self._on_all(lambda host, ssh: self._install(host, ssh, packages))
        on = self.hosts_file.router.on
        self.port = self.port or free_port()
        for name in self.hosts:
            reached = self.reached_from[name] if on == LAUNCHER else self.hosts[on].address
            address = self.hosts_file.router.address or reached
            socket_ = f"tcp/{f'[{address}]' if ':' in address else address}:{self.port}"
            self.endpoints[name] = levels.endpoint(self.context.secure, socket_)
        return {"hosts": {name: self._place(name) for name in self.hosts}}

    def _on_all(self, do: Callable[[SshHost, asyncssh.SSHClientConnection], Any], *, whole: bool = False) -> None:
        async def on(host: SshHost) -> None:
            async with connection.connected(host) as ssh:
                await do(host, ssh)

        self.loop.run(connection.together(*(on(host) for host in self.hosts.values())), whole=whole)

    async def _install(self, host: SshHost, ssh: asyncssh.SSHClientConnection, packages: connection.Packages) -> None:
        self.installed[host.name] = await connection.install(ssh, host, packages)
        self.reached_from[host.name] = ssh.get_extra_info("sockname")[0]

    def _folder(self, name: str, *inside: str) -> str:
        return posixpath.join(self.installed[name].folder, "runs", self.context.run_id, name, *inside)

    def _place(self, name: str) -> dict[str, Any]:
        """The entry of run.json from which the run can be found on this host."""
        reach = asdict(self.hosts[name])
        reach |= {key: str(Path(reach[key]).expanduser().resolve()) for key in ("key", "known_hosts") if reach[key]}
        nodes = [node for node, host in self.placed.items() if host == name]
        nodes += [ROUTER] if self.hosts_file.router.on == name else []
        return {
            "reach": reach | {"nodes": [], "roles": []},
            "run_folder": self._folder(name),
            "python": self.installed[name].python,
            "release": self.installed[name].release,
            "nodes": nodes,
        }

    def router_hosts(self) -> list[str]:
        return levels.hosts(self.endpoints.values())

    def start_router(self, deployment: Deployment) -> str:
        self._on_all(self._start_warden, whole=True)
        self._attach()
        self._until(lambda: all(a.attached for a in self.attachments.values()), _ATTACH_S, self._not_attached)
        if self.hosts_file.router.on != LAUNCHER:
            self._start_router_on(self.hosts_file.router.on, deployment)
        return next(iter(self.endpoints.values()))

    async def _start_warden(self, host: SshHost, ssh: asyncssh.SSHClientConnection) -> None:
        installed = self.installed[host.name]
        words = ["env", f"PYTHONPATH={installed.release}", installed.python, "-m", "mast_zenoh.deploy.ssh.warden"]
        await connection.run(ssh, host, [*words, self._folder(host.name), str(self.hosts_file.patience_s + _LATER_S)])

    def _attach(self) -> None:
        for name, host in self.hosts.items():
            command = attaching(self.context.record["deployment"]["hosts"][name])
            self.attachments[name] = WardenAttachment(host, command, self.changed, self._log)
            self.loop.begin(self.attachments[name].stay())

    def _log(self, name: str, offset: int, piece: bytes) -> None:
        """Append to a log, in the event loop.

        A name with a path is ignored: hosts must not choose where to write.
        """
        if posixpath.basename(name) != name:
            return
        path = self.logs / f"{name}.log"
        with path.open("r+b" if path.exists() else "xb") as file:
            file.seek(offset)
            file.write(piece)

    def _start_router_on(self, name: str, deployment: Deployment) -> None:
        """Start the router on a host, and wait until it listens there."""
        host, attachment = self.hosts[name], self.attachments[name]
        listen = levels.endpoint(self.context.secure, f"tcp/0.0.0.0:{self.port}")
        argv = [*self._mast_node(name), "--router", "--listen", listen]
        if deployment.router:
            settings = self._folder(name, ROUTER_SETTINGS)
            argv += ["--settings", settings]

            async def copy() -> None:
                async with connection.connected(host) as ssh, ssh.start_sftp_client() as sftp:
                    await connection.write_file(sftp, settings, json.dumps(deployment.router).encode())

            self.loop.run(copy())
        start = attachment.tell("start", name=ROUTER, argv=argv, env=self._environment(name))
        self.router_start = attachment, start

        def ended() -> bool:
            return attachment.exit(ROUTER, start) is not None

        log = self.logs / f"{ROUTER}.log"
        self._until(lambda: ended() or (log.is_file() and b"router at" in log.read_bytes()), self.router_s, lambda: "")
        if ended():
            lines = log.read_text(errors="replace").strip().splitlines() if log.is_file() else []
            raise EngineError(f"{host.called}: the router did not start: {lines[-1] if lines else 'no output'}")

    def open_session(self, endpoint: str, deployment: Deployment) -> zenoh.Session:
        if self.hosts_file.router.on != LAUNCHER:
            return super().open_session(endpoint, deployment)
        endpoints = list(dict.fromkeys(self.endpoints.values()))
        if self.hosts_file.router.address and not _is_local(self.hosts_file.router.address):  # such as a gateway's
            endpoints = [levels.endpoint(self.context.secure, f"tcp/0.0.0.0:{self.port}")]
        try:
            return open_router(*endpoints, security=deployment.router)[0]
        except (zenoh.ZError, OSError) as error:
            raise EngineError(f"the router cannot listen at {', '.join(endpoints)}: {error} (router.port)") from None

    def begin(self, deployment: Deployment) -> None:
        if deployment.folder is not None:
            self._on_all(lambda host, ssh: self._copy_credentials(host, ssh, deployment))
            deployment.close()  # the nodes have theirs
        self._on_all(self._reach_router)

    async def _copy_credentials(self, host: SshHost, ssh: asyncssh.SSHClientConnection, deployment: Deployment) -> None:
        target = self._folder(host.name, CREDENTIALS)
        try:
            async with ssh.start_sftp_client() as sftp:
                await connection.make_folder(sftp, target)
                for node in (node for node, on in self.placed.items() if on == host.name):
                    own = deployment.of(node)
                    assert own is not None
                    await connection.make_folder(sftp, posixpath.join(target, node))
                    for file in own.iterdir():
                        await connection.write_file(sftp, posixpath.join(target, node, file.name), file.read_bytes())
        except (asyncssh.Error, OSError) as error:
            raise EngineError(f"{host.called}: {target}: {error}") from None

    async def _reach_router(self, host: SshHost, ssh: asyncssh.SSHClientConnection) -> None:
        endpoint = self.endpoints[host.name]
        address, _, port = endpoint.partition("/")[2].rpartition(":")
        answer = await connection.ask(ssh, host, "reach", address.strip("[]"), port)
        if answer["refused"]:
            raise EngineError(
                f"{host.called}: cannot reach the router at {endpoint}: {answer['refused']}; name an address that it "
                "can reach, or a host for the router to be on, in hosts.toml (router.address, router.on)"
            )

    def remove(self) -> None:
        """End the run on every host, and remove its folder.

        Unreachable hosts do so by themselves.
        """
        if not self.attachments:
            self._attach()
        attachments = [attachment for attachment in self.attachments.values() if not attachment.gone]
        for attachment in attachments:
            attachment.leave(grace_s=2.0)
        for name, attachment in self.attachments.items():
            self.context.record["deployment"]["hosts"][name]["reattached"] = max(0, attachment.reattached)
        deadline = time.monotonic() + LEAVE_S
        unreachable = [a.host.called for a in attachments if not a.has_left(deadline - time.monotonic())]
        if unreachable:
            self.context.show(
                f"[yellow]out of reach at the end: {', '.join(unreachable)}: all is removed there after "
                f"{self.hosts_file.patience_s + _LATER_S:.0f} s, or `mast deploy down {self.context.folder}`"
            )

    def _not_attached(self) -> str:
        return "; ".join(a.trouble or a.host.called for a in self.attachments.values() if not a.attached)

    def _until(self, condition: Callable[[], bool], seconds: float, pending: Callable[[], str]) -> None:
        def interrupted() -> bool:
            return bool(self.context.signals)

        if not self.wait(lambda: condition() or interrupted(), seconds):
            raise EngineError(f"not ready within {seconds:.0f} s: {pending()}")
        if interrupted():
            raise Interrupted("stopped by Ctrl-C or SIGTERM")

    # -- supervision ---------------------------------------------------------------------------------------------

    def _command(self, node: str, name: str) -> dict[str, Any]:
        """The command that starts a node on its host, and its environment."""
        endpoint = self.context.detours.get(node, self.endpoints[name])
        argv = [*self._mast_node(name), "--name", node, "--endpoint", endpoint]
        if self.context.secure != "open":
            argv += ["--credentials", self._folder(name, CREDENTIALS, node)]
        return {"argv": argv, "env": self._environment(name)}

    def _mast_node(self, name: str) -> list[str]:
        patience = ["--patience", str(self.hosts_file.patience_s)]
        words = ["-m", "mast_zenoh.deploy.remote_node", "--run", self.context.run_id]
        return [self.installed[name].python, *words, *patience]

    def _environment(self, name: str) -> dict[str, str]:
        own = {"PYTHONPATH": self.installed[name].release, RUN: self.context.run_id}
        return {**own, **ENVIRONMENT, **numeric_environment()}

    def start_all(self, specs: Mapping[str, NodeSpec]) -> None:
        """Start nodes, and wait until the hosts have started them."""
        super().start_all(specs)
        deadline = time.monotonic() + _ANSWER_S
        for name in specs:
            child = self.children[name]
            child.attachment.answer(child.start, deadline - time.monotonic())

    def start(self, name: str, spec: NodeSpec) -> None:
        """Start a node without waiting for the host."""
        child = RemoteNode(name, spec, self.attachments[self.placed.get(name, next(iter(self.attachments)))])
        self.children[name] = child
        (self.logs / f"{name}.log").touch()
        self._restart(child)

    def _restart(self, child: RemoteNode) -> None:
        command = self._command(child.name, child.attachment.host.name)
        child.start = child.attachment.tell("start", name=child.name, **command)

    def end_now(self, child: RemoteNode) -> None:
        """Kill a node and wait for its end; raises EngineError without an answer."""
        self._confirm(self._tell([child], signal.SIGKILL))
        if not self.wait(lambda: child.exit is not None, _ANSWER_S):
            raise EngineError(f"{child.name} does not end")

    def _suspend(self, child: RemoteNode) -> None:
        self._confirm(self._tell([child], signal.SIGSTOP))

    def _resume(self, children: Iterable[RemoteNode]) -> None:
        self._confirm(self._tell(children, signal.SIGCONT))

    def signal(self, children: list[RemoteNode], word: str) -> None:
        self._tell(children, signal.Signals[f"SIG{word}"])

    def end(self, grace_s: float) -> None:
        """End all nodes; an unreachable host ends its own, which is noted."""
        with contextlib.suppress(EngineError):  # a host that does not answer
            super().end(grace_s)
        for child in self.children.values():
            if child.exit is None:
                child.notes.append(f"{child.attachment.host.called} is out of reach")

    def router_ended(self) -> str | None:
        if self.router_start is None:
            return None
        attachment, start = self.router_start
        code = attachment.exit(ROUTER, start)
        return None if code is None else f" on {attachment.host.called} has ended: {how_ended(code)}"

    def _tell(self, children: Iterable[RemoteNode], number: int) -> dict[WardenAttachment, str]:
        """Send a signal to nodes; returns the ids of the commands."""
        names_on: dict[WardenAttachment, list[str]] = {}
        for child in children:
            names_on.setdefault(child.attachment, []).append(child.name)
        return {host: host.tell("signal", names=names, number=int(number)) for host, names in names_on.items()}

    def _confirm(self, commands: Mapping[WardenAttachment, str]) -> None:
        """Wait for the hosts; raises EngineError without an answer."""
        for attachment, command_id in commands.items():
            if attachment.answer(command_id, _ANSWER_S) is None and not attachment.gone:
                raise EngineError(f"{attachment.host.called}: has not answered within {_ANSWER_S:.0f} s")


def _is_local(address: str) -> bool:
    """Whether this machine can listen at an address."""
    try:
        family, kind, protocol, _, endpoint = socket.getaddrinfo(address, 0, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind, protocol) as probe:
            probe.bind(endpoint)
    except OSError:
        return False
    return True
