"""A resolved scenario as a compose file: services for the router and every node.

Nodes have no access to the host except to their credentials. They are on one of two networks without external access:
`wired` for static nodes, and `wireless` for mobile agents and interposers on their wires. The router is on both.
Pure functions.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from itertools import pairwise
from typing import Any

from mast_zenoh.config.resolved import NodeSpec, Resolved
from mast_zenoh.deploy.image import USER
from mast_zenoh.deploy.yamltext import Anchored, Merged, dump
from mast_zenoh.errors import ConfigurationError
from mast_zenoh.runtime.mesh.launcher_watch import UP
from mast_zenoh.security import levels
from mast_zenoh.security.credentials import AUTHORITY, CERTIFICATE, CONTROL, KEY

FILE = "compose.yml"
CREDENTIALS = "credentials"  # folder next to the file
ROUTER = "router"
ROUTER_SETTINGS = "router.json"
PORT = 7447
LABEL = "org.mast-zenoh.run"  # on everything that belongs to a run

_SECRETS = "/run/secrets"
_NAME = re.compile(r"[A-Za-z0-9][\w.-]*")


def project(run: str) -> str:
    """The Compose project of a run: lower case letters, digits, `_` and `-`."""
    return "mast-" + re.sub(r"[^a-z0-9_-]", "-", run.lower())


def container(run: str, node: str) -> str:
    """The name of a node's container."""
    return f"{project(run)}-{node}"


def document(
    resolved: Resolved,
    run: str,
    *,
    image: str,
    secure: str = "open",
    user: str = USER,
    environment: Mapping[str, str] | None = None,
    patience_s: float = 10.0,
    cpus: float = 1.0,
    memory: str = "1g",
) -> dict[str, Any]:
    """The compose file of a run as plain values.

    user:     UID:GID of all processes inside; on a secure mesh it must own the credentials
    environment: variables of all processes inside, besides the image's own
    patience_s: how long nodes run without a launcher, s; extended by the longest disconnection of each node
    cpus, memory: limits of each container

    Raises ConfigurationError for a node's name that Compose does not allow.
    """
    check_names(resolved)
    endpoint = levels.endpoint(secure, f"tcp/{ROUTER}:{PORT}")
    common = Anchored(
        "node",
        {
            "image": image,
            "user": user,
            **({"environment": dict(environment)} if environment else {}),
            "init": True,
            "read_only": True,
            "tmpfs": ["/tmp:mode=1777"],
            "cap_drop": ["ALL"],
            "security_opt": ["no-new-privileges:true"],
            "restart": "no",
            "cpus": cpus,
            "mem_limit": memory,
            "pids_limit": 200,
            "healthcheck": {
                "test": ["CMD", "test", "-e", f"/tmp/{UP}"],
                "interval": "10s",
                "timeout": "10s",
                "retries": 3,
                "start_period": "60s",
            },
        },
    )
    patience = ["--patience", f"{patience_s:g}"]
    listen = levels.endpoint(secure, f"tcp/0.0.0.0:{PORT}")
    command = ["--router", "--run", run, "--listen", listen, *patience]
    services: dict[str, Any] = {}
    files: dict[str, str] = {}

    def secrets(service: str, names: tuple[str, ...]) -> list[dict[str, str]]:
        entries = []
        for name in names:
            files[f"{service}_{name}"] = f"./{CREDENTIALS}/{service}/{name}"
            entries.append({"source": f"{service}_{name}", "target": name})
        return entries

    services[ROUTER] = {
        "<<": Merged("node"),
        "container_name": container(run, ROUTER),
        "labels": {LABEL: run},
        "command": command if secure == "open" else [*command, "--settings", f"{_SECRETS}/{ROUTER_SETTINGS}"],
        "ports": [f"127.0.0.1::{PORT}"],
        "networks": ["launcher", "wired", "wireless"],
    }
    if secure != "open":
        services[ROUTER]["secrets"] = secrets(ROUTER, (ROUTER_SETTINGS,))
    credential_files = (AUTHORITY, CONTROL) if secure == "tls" else (AUTHORITY, CERTIFICATE, KEY, CONTROL)
    for name in resolved.nodes:
        patience = ["--patience", f"{patience_s + longest_disconnection_s(resolved, name):g}"]
        command = ["--name", name, "--run", run, "--endpoint", endpoint, *patience]
        services[name] = {
            "<<": Merged("node"),
            "container_name": container(run, name),
            "labels": {LABEL: run},
            "depends_on": [ROUTER],
            "command": command if secure == "open" else [*command, "--credentials", _SECRETS],
            "networks": ["wireless" if is_mobile(resolved, name) else "wired"],
        }
        if secure != "open":
            services[name]["secrets"] = secrets(name, credential_files)
    networks = {name: {"internal": True, "labels": {LABEL: run}} for name in ("wired", "wireless")}
    content = {
        "x-node": common,
        "services": services,
        "networks": {"launcher": {"labels": {LABEL: run}}, **networks},
    }
    return content | ({"secrets": {name: {"file": file} for name, file in files.items()}} if files else {})


def text(resolved: Resolved, run: str, **options: Any) -> str:
    """The compose file of a run; the options are the same as for `document`."""
    secure = options.get("secure", "open")
    comment = (
        f"# The run {run} of the scenario {resolved.name}, security level {secure}. `mast deploy up` wrote this file\n"
        "# and starts its services. Nodes get their configuration and return their results over the mesh.\n"
    )
    return comment + dump(document(resolved, run, **options))


def check_names(resolved: Resolved) -> None:
    """Raise ConfigurationError for a node whose name is not a valid service name."""
    for name in resolved.nodes:
        if not _NAME.fullmatch(name) or name == ROUTER:
            problem = "the router's name" if name == ROUTER else "not a valid name for a container"
            raise ConfigurationError(f"node {name!r}: {problem}; expected letters, digits, `_`, `.` and `-`")


def is_mobile(resolved: Resolved, name: str) -> bool:
    """Whether a node is a mobile agent, or an interposer on the wires of one."""
    spec = resolved.nodes[name]
    agents = [resolved.nodes[agent] for agent in spec.agents if agent in resolved.nodes]
    return any(map(_is_mobile_agent, [spec, *agents]))


def longest_disconnection_s(resolved: Resolved, name: str) -> float:
    """The longest disconnection of a node in the scenario, s of wall-clock time."""
    steps = [step for step in resolved.steps if step.node == name]
    pairs = [pair for pair in pairwise(steps) if pair[0].action == "disconnect"]
    frames = max((after.frame - before.frame for before, after in pairs), default=0)
    return frames * resolved.period_ns * 1e-9 / resolved.rate


def _is_mobile_agent(spec: NodeSpec) -> bool:
    return spec.role == "agent" and bool(spec.config.get("mobile"))
