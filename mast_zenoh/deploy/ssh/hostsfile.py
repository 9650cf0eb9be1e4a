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

from mast_zenoh.config.resolved import NodeSpec
from mast_zenoh.errors import ConfigurationError, nearest
from mast_zenoh.wiring.endpoints import ROLES

#: The value of `router.on` for the machine on which `mast deploy` runs.
LAUNCHER = "launcher"

_WILD = re.compile(r"[*?\[]")
_NAME = re.compile(r"[A-Za-z0-9_-]+")
_REACH: dict[str, type] = {"user": str, "port": int, "key": str, "known_hosts": str, "python": str, "folder": str}
_PLACE: dict[str, type] = {"nodes": list, "roles": list, "spread": bool}
_KINDS: dict[type, str] = {
    str: "a string",
    int: "a whole number",
    float: "a number",
    bool: "true or false",
    list: "a list of strings",
}


@dataclass(frozen=True)
class Host:
    """How to reach a host, and which nodes run there.

    address:     name or address, port: of its SSH server
    user:        login name; empty: the name of the user who runs `mast`
    key:         file of the private key; empty: keys of the SSH agent and the usual files
    known_hosts: file with the keys of known hosts; a host whose key is not in it is refused
    python:      its Python, 3.11 or newer; folder: for installed files, below the home directory unless absolute
    nodes: names of nodes, with * and ?; roles: it runs a share of the nodes with these roles; spread: whether it also
           runs a share of the remaining nodes
    """

    name: str
    address: str
    user: str = ""
    port: int = 22
    key: str = ""
    known_hosts: str = "~/.ssh/known_hosts"
    python: str = "python3"
    folder: str = ".mast-zenoh"
    nodes: tuple[str, ...] = ()
    roles: tuple[str, ...] = ()
    spread: bool = False

    @property
    def called(self) -> str:
        """The host's name and address, for error messages."""
        return f"host {self.name} ({self.user + '@' if self.user else ''}{self.address}:{self.port})"


@dataclass(frozen=True)
class Hosts:
    """The content of hosts.toml.

    router_on: name of a host, or LAUNCHER; address: the router's, as seen from the hosts, empty: detected; port: 0: any
    patience_s: how long nodes and the host's supervisor run without a launcher
    """

    place: str
    hosts: dict[str, Host] = field(default_factory=dict)
    router_on: str = LAUNCHER
    address: str = ""
    port: int = 7447
    patience_s: float = 30.0

    def placed(self, nodes: Mapping[str, NodeSpec]) -> dict[str, str]:
        """The host of every node.

        A node runs on the host that names it, otherwise on one of the hosts that list its role, otherwise on one of the
        spread hosts; hosts take turns. Spread hosts are those with `spread`; if there are none, those without nodes and
        roles; if there are none of these either, all.

        Raises ConfigurationError for a name that is not in the scenario or is on two hosts, and for an unknown role.
        Patterns and roles that match no node are allowed: a hosts file serves many scenarios.
        """
        host_of: dict[str, str] = {}
        for host in self.hosts.values():
            for index, pattern in enumerate(host.nodes):
                where = f"{self.place}: hosts.{host.name}.nodes[{index}]"
                matching = [name for name in nodes if fnmatchcase(name, pattern)]
                if not matching and not _WILD.search(pattern):
                    raise ConfigurationError(f"{where}: no node {pattern!r}{nearest(pattern, nodes)}")
                for name in matching:
                    if host_of.setdefault(name, host.name) != host.name:
                        raise ConfigurationError(f"{where}: {name} is already on {host_of[name]}, expected one host")
        by_role = {role: cycle(hosts) for role, hosts in self._claims(nodes).items()}
        all_hosts = list(self.hosts)
        spread = [h.name for h in self.hosts.values() if h.spread]
        unassigned = [h.name for h in self.hosts.values() if not (h.nodes or h.roles)]
        remaining_hosts = cycle(spread or unassigned or all_hosts)
        for name, spec in nodes.items():
            if name not in host_of:
                host_of[name] = next(by_role.get(spec.role, remaining_hosts))
        return {name: host_of[name] for name in nodes}

    def used(self, nodes: Mapping[str, NodeSpec]) -> dict[str, Host]:
        """The hosts that run nodes or the router."""
        names = {*self.placed(nodes).values(), self.router_on}
        return {name: host for name, host in self.hosts.items() if name in names}

    def _claims(self, nodes: Mapping[str, NodeSpec]) -> dict[str, list[str]]:
        roles = {*ROLES, *(spec.role for spec in nodes.values())}
        claims: dict[str, list[str]] = {}
        for host in self.hosts.values():
            for index, role in enumerate(host.roles):
                if role not in roles:
                    where = f"{self.place}: hosts.{host.name}.roles[{index}]"
                    raise ConfigurationError(f"{where}: there is no role {role!r}{nearest(role, roles)}")
                claims.setdefault(role, []).append(host.name)
        return claims


def read(path: Path) -> Hosts:
    """Read a hosts file; a ConfigurationError names the file and the path inside it."""
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "is not UTF-8"
        raise ConfigurationError(f"{path}: {reason}; docs/deploy.md describes this file") from None
    return parse(text, str(path))


def parse(text: str, place: str) -> Hosts:
    """Parse a hosts file's text; a ConfigurationError names `place` and the path inside."""
    try:
        data = tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise ConfigurationError(f"{place}: {error}") from None
    _known(data, {"hosts": dict, "defaults": dict, "router": dict, "patience_s": float}, place, "")
    hosts: dict[str, Any] = data.get("hosts", {})
    if not hosts:
        raise ConfigurationError(f"{place}: hosts: found none, expected a table for each: [hosts.NAME]")
    defaults = _known(data.get("defaults", {}), _REACH, place, "defaults.")
    router = _known(data.get("router", {}), {"on": str, "address": str, "port": int}, place, "router.")
    read_hosts = {name: _host(name, table, defaults, place) for name, table in hosts.items()}
    on = router.get("on", LAUNCHER)
    if on not in (LAUNCHER, *read_hosts):
        raise ConfigurationError(f"{place}: router.on: no host {on!r}{nearest(on, [LAUNCHER, *read_hosts])}")
    _port(router, place, "router.", least=0 if on == LAUNCHER else 1)
    patience_s = float(data.get("patience_s", Hosts.patience_s))
    if not (math.isfinite(patience_s) and patience_s > 0):
        raise ConfigurationError(f"{place}: patience_s: found {patience_s}, expected seconds > 0")
    return Hosts(
        place, read_hosts, on, router.get("address", ""), router.get("port", Hosts.port), patience_s=patience_s
    )


def _host(name: str, table: Any, defaults: Mapping[str, Any], place: str) -> Host:
    where = f"hosts.{name}."
    if not _NAME.fullmatch(name) or name == LAUNCHER:
        raise ConfigurationError(
            f"{place}: hosts.{name}: expected a name of letters, digits, - and _ other than {LAUNCHER!r}"
        )
    if not isinstance(table, dict):
        raise ConfigurationError(f"{place}: hosts.{name}: found {table!r}, expected a table: [hosts.{name}]")
    entries = _known(table, {"address": str, **_REACH, **_PLACE}, place, where)
    if not entries.get("address"):
        raise ConfigurationError(f"{place}: {where}address: missing; expected a name or an address")
    merged: dict[str, Any] = {**defaults, **entries}
    _port(merged, place, where, least=1)
    for key in ("folder", "python", "known_hosts"):
        if merged.get(key) == "" or "\0" in merged.get(key, ""):
            raise ConfigurationError(f"{place}: {where}{key}: found {merged[key]!r}, expected a path or a program")
    values: dict[str, Any] = {key: tuple(value) if isinstance(value, list) else value for key, value in merged.items()}
    return Host(name, **values)


def _known(table: Mapping[str, Any], kinds: Mapping[str, type], place: str, where: str) -> dict[str, Any]:
    for key, value in table.items():
        if key not in kinds:
            raise ConfigurationError(f"{place}: {where}{key}: unknown{nearest(key, kinds)}")
        kind = kinds[key]
        fits = isinstance(value, (int, float) if kind is float else kind) and (kind is bool or type(value) is not bool)
        if kind is list:
            fits = fits and all(isinstance(item, str) for item in value)
        if not fits:
            expected = _KINDS.get(kind, "a table")
            raise ConfigurationError(f"{place}: {where}{key}: found {value!r}, expected {expected}")
    return dict(table)


def _port(table: Mapping[str, Any], place: str, where: str, *, least: int) -> None:
    if not least <= (port := table.get("port", 22)) <= 65535:
        raise ConfigurationError(f"{place}: {where}port: found {port}, expected {least} to 65535")
