"""`mast deploy up --engine ssh`: nodes on hosts with an SSH server and Python."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import sys
import tempfile
import threading
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

from mast_zenoh.config.resolved import Resolved
from mast_zenoh.deploy.ssh import connection, hostsfile, installation
from mast_zenoh.deploy.ssh.attachment import attaching
from mast_zenoh.deploy.ssh.connection import Loop, connected, messages_of, together
from mast_zenoh.deploy.ssh.hostsfile import Host
from mast_zenoh.deploy.ssh.installation import Packages
from mast_zenoh.deploy.ssh.startup import Startup
from mast_zenoh.errors import EngineError
from mast_zenoh.launch.context import Mesh, RunContext
from mast_zenoh.launch.engine import Engine
from mast_zenoh.security import levels

_LEAVE_S = 20.0  # for a host to end what it still runs and to remove its folder


class Ssh(Engine):
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
        used = self._used(resolved)

        async def probe(host: Host, packages: Packages) -> None:
            async with connected(host) as ssh:
                await installation.probe(ssh, host, packages)

        with tempfile.TemporaryDirectory(prefix="mast-wheel-") as folder, Loop() as loop:
            packages = Packages(Path(folder))
            loop.run(together(*(probe(host, packages) for host in used.values())))

    def join(self, context: RunContext, stack: ExitStack) -> Mesh:
        return Startup(self.hosts, self._used(context.resolved), context, stack).run()

    def _used(self, resolved: Resolved) -> dict[str, Host]:
        names = {*self.hosts.placed(resolved.nodes).values(), self.hosts.router_on}
        return {name: host for name, host in self.hosts.hosts.items() if name in names}

    @classmethod
    def status(cls, folder: Path, record: dict[str, Any]) -> list[dict[str, str]]:
        """The state of every node; for an unreachable host, the reason."""
        places = _places(record)

        async def states(host: Host, place: dict[str, Any]) -> list[dict[str, str]]:
            try:
                answer = await _ask_warden(host, place, "state")
            except EngineError as error:
                return [{"node": name, "state": str(error), "where": host.name} for name in place["nodes"]]
            by_name = {node["node"]: node for node in (answer or {}).get("nodes", [])}
            return [_state_row(name, by_name.get(name), host) for name in {**dict.fromkeys(place["nodes"]), **by_name}]

        with Loop() as loop:
            states_by_host = loop.run(together(*(states(host, place) for host, place in places.values())))
        return sorted((entry for entries in states_by_host for entry in entries), key=lambda entry: entry["node"])

    @classmethod
    def logs(cls, folder: Path, record: dict[str, Any], node: str | None, *, follow: bool) -> None:
        """Print the run folder's logs, which the launcher writes, then logs only on the host."""
        names = [node] if node else sorted({name for _, place in _places(record).values() for name in place["nodes"]})
        printing = threading.Lock()
        offsets = {}
        for name in names:
            path = folder / "logs" / f"{name}.log"
            content = path.read_bytes() if path.is_file() else b""
            offsets[name] = len(content)
            _print(name, content, printing)

        async def more(host: Host, place: dict[str, Any]) -> None:
            host_offsets = {name: offsets[name] for name in place["nodes"] if name in offsets}
            if not host_offsets:
                return
            async with connected(host) as ssh, ssh.create_process(attaching(place)) as process:
                # All logs up to now come before the answer.
                process.stdin.write(json.dumps({"as": "reader", "logs": host_offsets}) + "\n")
                if not follow:
                    process.stdin.write(json.dumps({"id": os.urandom(8).hex(), "do": "state"}) + "\n")
                async for message in messages_of(process):
                    if "log" in message and message["log"] in host_offsets:
                        _print(message["log"], message["text"].encode("latin-1"), printing)
                    elif "answer" in message and not follow:
                        return

        with Loop() as loop, contextlib.suppress(KeyboardInterrupt):
            loop.run(together(*(more(host, place) for host, place in _places(record).values())))

    @classmethod
    def down(cls, folder: Path, record: dict[str, Any]) -> None:
        """End the run on all hosts; raises EngineError at the end for unreachable ones."""

        async def end(host: Host, place: dict[str, Any]) -> None:
            if await _ask_warden(host, place, "leave", grace_s=1.0) is None:
                async with connected(host) as ssh:
                    await connection.ask(ssh, host, "remove", place["run_folder"])

        with Loop() as loop:
            loop.run(together(*(end(host, place) for host, place in _places(record).values())))


def _places(record: Mapping[str, Any]) -> dict[str, tuple[Host, dict[str, Any]]]:
    return {name: (Host(**place["reach"]), place) for name, place in record["deployment"]["hosts"].items()}


async def _ask_warden(host: Host, place: Mapping[str, Any], do: str, **more: Any) -> dict[str, Any] | None:
    """The warden's answer; None without a warden or installation. Raises EngineError."""
    import asyncssh

    answer: dict[str, Any] | None = None
    try:
        async with connected(host) as ssh, ssh.create_process(attaching(place)) as process:
            process.stdin.write(json.dumps({"id": os.urandom(8).hex(), "do": do, **more}) + "\n")
            async with asyncio.timeout(_LEAVE_S):
                async for message in messages_of(process):
                    answer = message if "answer" in message else answer
                    if answer and do != "leave":  # a leaving warden ends the connection itself, at its end
                        break
                else:
                    await process.wait()
                    if process.exit_status is None:
                        raise EngineError(f"{host.called}: the connection was lost")
            return answer
    except (asyncssh.Error, OSError, TimeoutError) as error:
        raise EngineError(f"{host.called}: {error or type(error).__name__}") from None


def _state_row(name: str, node: Mapping[str, Any] | None, host: Host) -> dict[str, str]:
    if node is None:
        return {"node": name, "state": "not there", "where": host.name}
    state = "running" if node["exit"] is None else f"ended ({node['exit']})"
    return {"node": name, "state": state, "where": f"{host.name}, process {node['pid']}"}


def _print(name: str, content: bytes, printing: threading.Lock) -> None:
    with printing:
        sys.stdout.writelines(f"{name}  {line}\n" for line in content.decode(errors="replace").splitlines())
        sys.stdout.flush()
