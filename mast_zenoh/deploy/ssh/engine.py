"""`mast deploy up --engine ssh`: the nodes of a run on hosts with an SSH server and a Python."""

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
from mast_zenoh.deploy.ssh.bringing import Bringing
from mast_zenoh.deploy.ssh.connection import Loop, connected, heard, together
from mast_zenoh.deploy.ssh.hostsfile import Host
from mast_zenoh.deploy.ssh.installation import Cargo
from mast_zenoh.errors import EngineError
from mast_zenoh.launch.context import Mesh, RunContext
from mast_zenoh.launch.engine import Engine
from mast_zenoh.security import levels

_LEAVE_S = 20.0  # for a host to end what it still runs and to remove its folder


class Ssh(Engine):
    """Hosts with an SSH server.

    hosts:      a file such as deploy/hosts.toml
    patience_s: how long nodes stay when the launcher has gone, s; None: as the file says
    """

    name = "ssh"

    def __init__(self, hosts: Path = Path("deploy/hosts.toml"), patience_s: float | None = None) -> None:
        told = hostsfile.read(hosts)
        self.hosts = told if patience_s is None else replace(told, patience_s=patience_s)

    def check(self, resolved: Resolved, secure: str) -> None:
        """See Engine. Every host that gets nodes, or the router, is asked: whether it lets us in, and what it has."""
        levels.check(secure)
        used = self._used(resolved)

        async def probed(host: Host, cargo: Cargo) -> None:
            async with connected(host) as ssh:
                await installation.probe(ssh, host, cargo)

        with tempfile.TemporaryDirectory(prefix="mast-wheel-") as folder, Loop() as loop:
            cargo = Cargo(Path(folder))
            loop.run(together(*(probed(host, cargo) for host in used.values())))

    def join(self, context: RunContext, stack: ExitStack) -> Mesh:
        """See Engine."""
        return Bringing(self.hosts, self._used(context.resolved), context, stack).bring()

    def _used(self, resolved: Resolved) -> dict[str, Host]:
        names = {*self.hosts.placed(resolved.nodes).values(), self.hosts.router_on}
        return {name: host for name, host in self.hosts.hosts.items() if name in names}

    @classmethod
    def status(cls, folder: Path, record: dict[str, Any]) -> list[dict[str, str]]:
        """See Engine. A host that is out of reach is said to be."""
        places = _places(record)

        async def states(host: Host, place: dict[str, Any]) -> list[dict[str, str]]:
            try:
                answer = await _ask_warden(host, place, "state")
            except EngineError as error:
                return [{"node": name, "state": str(error), "where": host.name} for name in place["nodes"]]
            known = {node["node"]: node for node in (answer or {}).get("nodes", [])}
            return [_stated(name, known.get(name), host) for name in {**dict.fromkeys(place["nodes"]), **known}]

        with Loop() as loop:
            found = loop.run(together(*(states(host, place) for host, place in places.values())))
        return sorted((entry for entries in found for entry in entries), key=lambda entry: entry["node"])

    @classmethod
    def logs(cls, folder: Path, record: dict[str, Any], node: str | None, *, follow: bool) -> None:
        """See Engine. What the run folder has, which the launcher writes, then what only the host has."""
        wanted = [node] if node else sorted({name for _, place in _places(record).values() for name in place["nodes"]})
        printing = threading.Lock()
        offsets = {}
        for name in wanted:
            path = folder / "logs" / f"{name}.log"
            content = path.read_bytes() if path.is_file() else b""
            offsets[name] = len(content)
            _print(name, content, printing)

        async def more(host: Host, place: dict[str, Any]) -> None:
            mine = {name: offsets[name] for name in place["nodes"] if name in offsets}
            if not mine:
                return
            async with connected(host) as ssh, ssh.create_process(attaching(place)) as process:
                # Logs come before the answer, as much of them as there is.
                process.stdin.write(json.dumps({"as": "reader", "logs": mine}) + "\n")
                if not follow:
                    process.stdin.write(json.dumps({"id": os.urandom(8).hex(), "do": "state"}) + "\n")
                async for said in heard(process):
                    if "log" in said and said["log"] in mine:
                        _print(said["log"], said["text"].encode("latin-1"), printing)
                    elif "answer" in said and not follow:
                        return

        with Loop() as loop, contextlib.suppress(KeyboardInterrupt):
            loop.run(together(*(more(host, place) for host, place in _places(record).values())))

    @classmethod
    def down(cls, folder: Path, record: dict[str, Any]) -> None:
        """See Engine. Raises EngineError for hosts that are out of reach, when all others are done."""

        async def end(host: Host, place: dict[str, Any]) -> None:
            if await _ask_warden(host, place, "leave", grace_s=1.0) is None:
                async with connected(host) as ssh:
                    await connection.ask(ssh, host, "remove", place["run_folder"])

        with Loop() as loop:
            loop.run(together(*(end(host, place) for host, place in _places(record).values())))


def _places(record: Mapping[str, Any]) -> dict[str, tuple[Host, dict[str, Any]]]:
    return {name: (Host(**place["reach"]), place) for name, place in record["deployment"]["hosts"].items()}


async def _ask_warden(host: Host, place: Mapping[str, Any], do: str, **more: Any) -> dict[str, Any] | None:
    """What the warden answers; None where there is none, or no installation either. Raises EngineError."""
    import asyncssh

    answer: dict[str, Any] | None = None
    try:
        async with connected(host) as ssh, ssh.create_process(attaching(place)) as process:
            process.stdin.write(json.dumps({"id": os.urandom(8).hex(), "do": do, **more}) + "\n")
            async with asyncio.timeout(_LEAVE_S):
                async for said in heard(process):
                    answer = said if "answer" in said else answer
                    if answer and do != "leave":  # who leaves ends the connection, when nothing is left
                        break
                else:
                    await process.wait()
                    if process.exit_status is None:
                        raise EngineError(f"{host.called}: the connection was lost")
            return answer
    except (asyncssh.Error, OSError, TimeoutError) as error:
        raise EngineError(f"{host.called}: {error or type(error).__name__}") from None


def _stated(name: str, found: Mapping[str, Any] | None, host: Host) -> dict[str, str]:
    if found is None:
        return {"node": name, "state": "not there", "where": host.name}
    state = "running" if found["exit"] is None else f"ended ({found['exit']})"
    return {"node": name, "state": state, "where": f"{host.name}, process {found['pid']}"}


def _print(name: str, content: bytes, printing: threading.Lock) -> None:
    with printing:
        sys.stdout.writelines(f"{name}  {line}\n" for line in content.decode(errors="replace").splitlines())
        sys.stdout.flush()
