"""Starts a run on hosts with SSH until its nodes can be started, for `Ssh.join`."""

from __future__ import annotations

import json
import posixpath
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import zenoh

from mast_zenoh.deploy import numeric_environment
from mast_zenoh.deploy.addresses import bracketed, free_port, is_local
from mast_zenoh.deploy.joining import join
from mast_zenoh.deploy.ssh import connection, hostsfile, installation
from mast_zenoh.deploy.ssh.attachment import Attachment, attaching
from mast_zenoh.deploy.ssh.connection import Loop, connected, make_folder, together, write_file
from mast_zenoh.deploy.ssh.hostsfile import LAUNCHER, Host
from mast_zenoh.deploy.ssh.installation import Installed, Packages
from mast_zenoh.deploy.ssh.nodes import RemoteNodes, exit_of
from mast_zenoh.errors import EngineError, Interrupted
from mast_zenoh.launch import folder as run_folder
from mast_zenoh.launch.context import Mesh, RunContext
from mast_zenoh.launch.processes import ENVIRONMENT
from mast_zenoh.runtime.mesh.session import open_router
from mast_zenoh.security import levels
from mast_zenoh.security.credentials import ROUTER
from mast_zenoh.security.deployment import Deployment

if TYPE_CHECKING:
    import asyncssh

_ROUTER_S = 60.0  # for a router on a host to start
_ATTACH_S = 60.0
_LEAVE_S = 20.0  # for a host to end what it still runs and to remove its folder
_LATER_S = 5.0  # how much longer the warden runs without a launcher than the nodes
_SETTINGS = "router.json"


class Startup:
    """Starts a run step by step. Callbacks on the stack remove all that it makes.

    hosts_file: the content of hosts.toml; hosts: the hosts that are used
    """

    def __init__(
        self, hosts_file: hostsfile.Hosts, hosts: dict[str, Host], context: RunContext, stack: ExitStack
    ) -> None:
        self.hosts_file = hosts_file
        self.hosts = hosts
        self.context = context
        self.deployment: Deployment | None = None
        self.stack = stack
        self.run_id = context.run_id
        self.placed = hosts_file.placed(context.resolved.nodes)
        self.loop = stack.enter_context(Loop(context.signals))
        self.changed = threading.Condition()
        self.attachments: dict[str, Attachment] = {}
        self.installed: dict[str, Installed] = {}
        self.reached_from: dict[str, str] = {}  # our address, as each host sees it
        self.endpoints: dict[str, str] = {}
        self.router: tuple[Attachment, str] | None = None  # see RemoteNodes

    def run(self) -> Mesh:
        """Run all steps; returns the session, the nodes' supervisor and credentials."""
        with tempfile.TemporaryDirectory(prefix="mast-wheel-") as folder:
            packages = Packages(Path(folder))
            self._on_all(lambda host, ssh: self._install(host, ssh, packages))
        self.context.record["deployment"] = {"engine": "ssh", "hosts": {n: self._place(n) for n in self.hosts}}
        run_folder.write_json(self.context.folder / "run.json", self.context.record)
        self.stack.callback(self._leave)
        self._on_all(self._start_warden, whole=True)
        self._attach()
        self._until(lambda: all(a.attached for a in self.attachments.values()), _ATTACH_S, self._not_attached)
        session = self._route()
        self._on_all(self._copy_credentials)
        if self.deployment is not None:
            self.deployment.close()  # the nodes have theirs
        self._on_all(self._reach_router)
        logs = self.context.folder / "logs"
        nodes = RemoteNodes(self.attachments, self.placed, self._command, logs, self.changed, self.router)
        return Mesh(session, nodes, self.deployment)

    def _on_all(self, do: Callable[[Host, asyncssh.SSHClientConnection], Any], *, whole: bool = False) -> None:
        async def on(host: Host) -> None:
            async with connected(host) as ssh:
                await do(host, ssh)

        self.loop.run(together(*(on(host) for host in self.hosts.values())), whole=whole)

    # -- hosts ---------------------------------------------------------------------------------------------------

    async def _install(self, host: Host, ssh: asyncssh.SSHClientConnection, packages: Packages) -> None:
        self.installed[host.name] = await installation.install(ssh, host, packages)
        self.reached_from[host.name] = ssh.get_extra_info("sockname")[0]

    def _folder(self, name: str) -> str:
        return posixpath.join(self.installed[name].folder, "runs", self.run_id, name)

    def _place(self, name: str) -> dict[str, Any]:
        """The entry of run.json from which the run can be found on this host."""
        reach = asdict(self.hosts[name])
        reach |= {key: str(Path(reach[key]).expanduser().resolve()) for key in ("key", "known_hosts") if reach[key]}
        nodes = [node for node, host in self.placed.items() if host == name]
        nodes += [ROUTER] if self.hosts_file.router_on == name else []
        return {
            "reach": reach | {"nodes": [], "roles": []},
            "run_folder": self._folder(name),
            "python": self.installed[name].python,
            "release": self.installed[name].release,
            "nodes": nodes,
        }

    async def _start_warden(self, host: Host, ssh: asyncssh.SSHClientConnection) -> None:
        installed = self.installed[host.name]
        words = ["env", f"PYTHONPATH={installed.release}", installed.python, "-m", "mast_zenoh.deploy.ssh.warden"]
        patience_s = self.hosts_file.patience_s + _LATER_S
        await connection.run(ssh, host, [*words, self._folder(host.name), str(patience_s)])

    def _attach(self) -> None:
        for name, host in self.hosts.items():
            command = attaching(self.context.record["deployment"]["hosts"][name])
            self.attachments[name] = Attachment(host, command, self.changed, self._log)
            self.loop.begin(self.attachments[name].stay())

    def _log(self, name: str, offset: int, piece: bytes) -> None:
        """Append to a log, in the event loop.

        A name with a path is ignored: hosts must not choose where to write.
        """
        if posixpath.basename(name) != name:
            return
        path = self.context.folder / "logs" / f"{name}.log"
        with path.open("r+b" if path.exists() else "xb") as file:
            file.seek(offset)
            file.write(piece)

    async def _copy_credentials(self, host: Host, ssh: asyncssh.SSHClientConnection) -> None:
        import asyncssh

        deployment = self.deployment
        if deployment is None or deployment.folder is None:
            return
        target = posixpath.join(self._folder(host.name), "credentials")
        try:
            async with ssh.start_sftp_client() as sftp:
                await make_folder(sftp, target)
                for node in (node for node, on in self.placed.items() if on == host.name):
                    own = deployment.of(node)
                    assert own is not None
                    await make_folder(sftp, posixpath.join(target, node))
                    for file in own.iterdir():
                        await write_file(sftp, posixpath.join(target, node, file.name), file.read_bytes())
        except (asyncssh.Error, OSError) as error:
            raise EngineError(f"{host.called}: {target}: {error}") from None

    async def _reach_router(self, host: Host, ssh: asyncssh.SSHClientConnection) -> None:
        endpoint = self.endpoints[host.name]
        address, _, port = endpoint.partition("/")[2].rpartition(":")
        answer = await connection.ask(ssh, host, "reach", address.strip("[]"), port)
        if answer["refused"]:
            raise EngineError(
                f"{host.called}: cannot reach the router at {endpoint}: {answer['refused']}; name an address that it "
                "can reach, or a host for the router to be on, in hosts.toml (router.address, router.on)"
            )

    def _leave(self) -> None:
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
        deadline = time.monotonic() + _LEAVE_S
        unreachable = [a.host.called for a in attachments if not a.has_left(deadline - time.monotonic())]
        if unreachable:
            self.context.show(
                f"[yellow]out of reach at the end: {', '.join(unreachable)}: all is removed there after "
                f"{self.hosts_file.patience_s + _LATER_S:.0f} s, or `mast deploy down {self.context.folder}`"
            )

    # -- the router ----------------------------------------------------------------------------------------------

    def _route(self) -> zenoh.Session:
        """Start the router, here or on its host, and open the launcher's session."""
        on, context = self.hosts_file.router_on, self.context
        if on == LAUNCHER:
            addresses = {n: self.hosts_file.address or self.reached_from[n] for n in self.hosts}
        else:
            addresses = dict.fromkeys(self.hosts, self.hosts_file.address or self.hosts[on].address)
        port = self.hosts_file.port or free_port()
        sockets = {n: f"tcp/{bracketed(address)}:{port}" for n, address in addresses.items()}
        self.endpoints = {n: levels.endpoint(context.secure, socket) for n, socket in sockets.items()}
        endpoints = list(dict.fromkeys(self.endpoints.values()))
        context.record["endpoint"] = endpoints[0]
        deployment = self.deployment = self.stack.enter_context(context.make_deployment(levels.hosts(endpoints)))
        if on != LAUNCHER:
            return self.stack.enter_context(self._router_on(self.hosts[on], port, deployment, endpoints[0]))
        if self.hosts_file.address and not is_local(self.hosts_file.address):  # such as a gateway's
            endpoints = [levels.endpoint(context.secure, f"tcp/0.0.0.0:{port}")]
        try:
            session, _ = open_router(*endpoints, security=deployment.router)
        except (zenoh.ZError, OSError) as error:
            raise EngineError(f"the router cannot listen at {', '.join(endpoints)}: {error} (router.port)") from None
        return self.stack.enter_context(session)

    def _router_on(self, host: Host, port: int, deployment: Deployment, endpoint: str) -> zenoh.Session:
        attachment, listen = self.attachments[host.name], levels.endpoint(self.context.secure, f"tcp/0.0.0.0:{port}")
        argv = [*self._mast_node(host.name), "--router", "--listen", listen]
        if deployment.router:
            settings = posixpath.join(self._folder(host.name), _SETTINGS)
            argv += ["--settings", settings]

            async def settle(to: Host, ssh: asyncssh.SSHClientConnection) -> None:
                if to is host:
                    async with ssh.start_sftp_client() as sftp:
                        await write_file(sftp, settings, json.dumps(deployment.router).encode())

            self._on_all(settle)
        start = attachment.tell("start", name=ROUTER, argv=argv, env=self._environment(host.name))
        self.router = attachment, start

        def ended() -> bool:
            return exit_of(attachment, ROUTER, start) is not None

        log = self.context.folder / "logs" / f"{ROUTER}.log"
        self._until(lambda: ended() or (log.is_file() and b"router at" in log.read_bytes()), _ROUTER_S, lambda: "")
        if ended():
            lines = log.read_text(errors="replace").strip().splitlines() if log.is_file() else []
            raise EngineError(f"{host.called}: the router did not start: {lines[-1] if lines else 'no output'}")
        return join(endpoint, deployment.launcher, _ROUTER_S, lambda: bool(self.context.signals))

    # -- nodes ---------------------------------------------------------------------------------------------------

    def _command(self, node: str, name: str) -> tuple[Sequence[str], dict[str, str]]:
        """The command that starts a node on its host, and its environment."""
        endpoint = self.context.detours.get(node, self.endpoints[name])
        argv = [*self._mast_node(name), "--name", node, "--endpoint", endpoint]
        if self.deployment is not None and self.context.secure != "open":
            argv += ["--credentials", posixpath.join(self._folder(name), "credentials", node)]
        return argv, self._environment(name)

    def _mast_node(self, name: str) -> list[str]:
        patience = ["--patience", str(self.hosts_file.patience_s)]
        return [self.installed[name].python, "-m", "mast_zenoh.deploy.remote_node", "--run", self.run_id, *patience]

    def _environment(self, name: str) -> dict[str, str]:
        return {"PYTHONPATH": self.installed[name].release, **ENVIRONMENT, **numeric_environment.environment()}

    # -- waiting -------------------------------------------------------------------------------------------------

    def _not_attached(self) -> str:
        return "; ".join(a.trouble or a.host.called for a in self.attachments.values() if not a.attached)

    def _until(self, condition: Callable[[], bool], seconds: float, pending: Callable[[], str]) -> None:
        deadline = time.monotonic() + seconds
        with self.changed:
            while not condition():
                if self.context.signals:
                    raise Interrupted("stopped by Ctrl-C or SIGTERM")
                if time.monotonic() > deadline:
                    raise EngineError(f"not ready within {seconds:.0f} s: {pending()}")
                self.changed.wait(0.1)
