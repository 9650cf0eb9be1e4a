"""hosts.toml: the hosts, how to reach them, and the placement of a run's nodes.

Pure, except for reading the file.
"""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from itertools import cycle
from pathlib import Path
from typing import Any

from mast_zenoh.config import registry
from mast_zenoh.config.resolved import NodeSpec
from mast_zenoh.errors import ConfigurationError, nearest
from mast_zenoh.wiring.endpoints import ROLES

#: The value of `router.on` for the machine on which `mast deploy` runs.
LAUNCHER = "launcher"

_WILD = re.compile(r"[*?\[]")
_NAME = re.compile(r"[A-Za-z0-9_-]+")


def check_port(port: int, least: int) -> None:
    """Raise ValueError for an impossible port."""
    if not least <= port <= 65535:
        raise ValueError(f"port: found {port}, expected {least} to 65535")


@dataclass(frozen=True, kw_only=True)
class SshAddress:
    """How to reach a host.

    user:        login name; empty: the name of the user who runs `mast`
    port:        of its SSH server
    key:         file of the private key; empty: keys of the SSH agent and the usual files
    known_hosts: file with the keys of known hosts; a host whose key is not in it is refused
    python:      its Python, 3.11 or newer; folder: for installed files, below the home directory unless absolute
    """

    user: str = ""
    port: int = 22
    key: str = ""
    known_hosts: str = "~/.ssh/known_hosts"
    python: str = "python3"
    folder: str = ".mast-zenoh"

    def __post_init__(self) -> None:
        check_port(self.port, 1)
        for name in ("folder", "python", "known_hosts"):
            value = getattr(self, name)
            if not value or "\0" in value:
                raise ValueError(f"{name}: found {value!r}, expected a path or a program")


@dataclass(frozen=True, kw_only=True)
class SshHost(SshAddress):
    """A host, and which nodes run there.

    name: by which this file names it;  address: name or address, by which it is reached
    nodes: names of nodes, with * and ?; roles: it runs a share of the nodes with these roles; an empty list: none
    spread: whether it also runs a share of the remaining nodes
    """

    name: str
    address: str
    nodes: tuple[str, ...] | None = None
    roles: tuple[str, ...] | None = None
    spread: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if not _NAME.fullmatch(self.name) or self.name == LAUNCHER:
            raise ValueError(f"expected a name of letters, digits, - and _ other than {LAUNCHER!r}")
        if not self.address:
            raise ValueError("address: missing; expected a name or an address")

    @property
    def called(self) -> str:
        """The host's name and address, for error messages."""
        return f"host {self.name} ({self.user + '@' if self.user else ''}{self.address}:{self.port})"


@dataclass(frozen=True)
class Router:
    """Where the router is.

    on: name of a host, or `launcher`: where `mast` runs
    address: as seen from the hosts, empty: detected;  port: on which it listens; 0: any
    """

    on: str = LAUNCHER
    address: str = ""
    port: int = 7447

    def __post_init__(self) -> None:
        check_port(self.port, 0 if self.on == LAUNCHER else 1)


@dataclass(frozen=True)
class HostsFile:
    """The content of hosts.toml.

    place: of the file;  hosts: by name;  router: where it is
    patience_s: s, how long nodes and the host's supervisor run without a launcher
    """

    place: str
    hosts: dict[str, SshHost] = field(default_factory=dict)
    router: Router = Router()
    patience_s: float = 30.0

    def placed(self, nodes: Mapping[str, NodeSpec]) -> dict[str, str]:
        """The host of every node.

        A node runs on the host that names it, otherwise on one of the hosts that list its role, otherwise on one of the
        spread hosts; hosts take turns. Spread hosts are those with `spread`; if there are none, those without nodes and
        roles; if there are none of these either, all that name some.

        Raises ConfigurationError for a name that is not in the scenario or is on two hosts, and for an unknown role.
        Patterns and roles that match no node are allowed: a hosts file serves many scenarios.
        """
        host_of: dict[str, str] = {}
        for host in self.hosts.values():
            for index, pattern in enumerate(host.nodes or ()):
                where = f"{self.place}: hosts.{host.name}.nodes[{index}]"
                matching = [name for name in nodes if fnmatchcase(name, pattern)]
                if not matching and not _WILD.search(pattern):
                    raise ConfigurationError(f"{where}: no node {pattern!r}{nearest(pattern, nodes)}")
                for name in matching:
                    if host_of.setdefault(name, host.name) != host.name:
                        raise ConfigurationError(f"{where}: {name} is already on {host_of[name]}, expected one host")
        by_role = {role: cycle(hosts) for role, hosts in self._claims(nodes).items()}
        named = [h.name for h in self.hosts.values() if h.nodes or h.roles]
        spread = [h.name for h in self.hosts.values() if h.spread]
        unassigned = [h.name for h in self.hosts.values() if h.nodes is None and h.roles is None]
        if not (taking := spread or unassigned or named):
            raise ConfigurationError(f"{self.place}: hosts: all lists are empty, expected a host that runs nodes")
        remaining_hosts = cycle(taking)
        for name, spec in nodes.items():
            if name not in host_of:
                host_of[name] = next(by_role.get(spec.role, remaining_hosts))
        return {name: host_of[name] for name in nodes}

    def used(self, nodes: Mapping[str, NodeSpec]) -> dict[str, SshHost]:
        """The hosts that run nodes or the router."""
        names = {*self.placed(nodes).values(), self.router.on}
        return {name: host for name, host in self.hosts.items() if name in names}

    def _claims(self, nodes: Mapping[str, NodeSpec]) -> dict[str, list[str]]:
        roles = {*ROLES, *(spec.role for spec in nodes.values())}
        claims: dict[str, list[str]] = {}
        for host in self.hosts.values():
            for index, role in enumerate(host.roles or ()):
                if role not in roles:
                    where = f"{self.place}: hosts.{host.name}.roles[{index}]"
                    raise ConfigurationError(f"{where}: there is no role {role!r}{nearest(role, roles)}")
                claims.setdefault(role, []).append(host.name)
        return claims


def read(path: Path) -> HostsFile:
    """Read a hosts file; a ConfigurationError names the file and the path inside it."""
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "is not UTF-8"
        raise ConfigurationError(f"{path}: {reason}; docs/how-to-hosts.md describes this file") from None
    return parse(text, str(path))


def parse(text: str, place: str) -> HostsFile:
    """Parse a hosts file's text; a ConfigurationError names `place` and the path inside."""
    try:
        data = tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise ConfigurationError(f"{place}: {error}") from None
    known = ("hosts", "defaults", "router", "patience_s")
    for key in data:
        if key not in known:
            raise ConfigurationError(f"{place}: {key}: unknown{nearest(key, known)}")

    def table(key: str) -> dict[str, Any]:
        values: dict[str, Any] = registry.built(data.get(key, {}), dict[str, Any], f"{place}: {key}")
        return values

    if not table("hosts"):
        raise ConfigurationError(f"{place}: hosts: found none, expected a table for each: [hosts.NAME]")
    defaults = table("defaults")
    registry.construct(SshAddress, defaults, f"{place}: defaults")
    hosts = {}
    for name, settings in table("hosts").items():
        path = f"{place}: hosts.{name}"
        own = registry.built(settings, dict[str, Any], path)
        hosts[name] = registry.construct(SshHost, {**defaults, "address": "", **own, "name": name}, path)
    router = registry.construct(Router, table("router"), f"{place}: router")
    if router.on not in (LAUNCHER, *hosts):
        raise ConfigurationError(f"{place}: router.on: no host {router.on!r}{nearest(router.on, [LAUNCHER, *hosts])}")
    patience_s = registry.built(data.get("patience_s", HostsFile.patience_s), float, f"{place}: patience_s")
    if not (math.isfinite(patience_s) and patience_s > 0):
        raise ConfigurationError(f"{place}: patience_s: found {patience_s}, expected seconds > 0")
    return HostsFile(place, hosts, router, patience_s)
