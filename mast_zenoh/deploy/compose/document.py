"""A resolved scenario as a compose file: services for the router and every node.

Nodes have no access to the host except to their credentials. They are on one of two networks without external access:
`wired` for static nodes, and `wireless` for mobile agents and interposers on their wires. The router is on both.

With a `Launcher`, the file is complete: `docker-compose up` plays the run. One more service makes the certificates and
waits, so that the file systems in memory that hold them stay; the launcher starts last. No container ends before the
launcher, or `--exit-code-from launcher` would end the run with it.
Pure functions.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from mast_zenoh.config.resolved import NodeSpec, Resolved
from mast_zenoh.deploy.image import BASE, USER, launcher_tag
from mast_zenoh.deploy.yamltext import Anchored, Interpolated, Merged, dump, quoted
from mast_zenoh.errors import ConfigurationError
from mast_zenoh.runtime.mesh.hosting import UP
from mast_zenoh.security import levels
from mast_zenoh.security.credentials import AUTHORITY, CERTIFICATE, CONTROL, KEY

FILE = "compose.yml"
CREDENTIALS = "credentials"  # folder next to the file
ROUTER = "router"
ROUTER_SETTINGS = "router.json"
PORT = 7447
LABEL = "org.mast-zenoh.run"  # on everything that belongs to a run

LAUNCHER = "launcher"
HOLDER = "certificates"  # the service that makes the credentials and keeps them in memory
KEYS = "/keys"  # where it has the credentials of all

_SECRETS = "/run/secrets"
_AT_ONCE = {"interval": "1s", "timeout": "10s", "retries": 60, "start_period": "60s"}
_NAME = re.compile(r"[A-Za-z0-9][\w.-]*")


@dataclass(frozen=True)
class Launcher:
    """The launcher inside a compose file.

    scenario: as for `mast run`, of a shipped scenario or of a file in `folder`
    settings: for `--set`
    folder:   a folder of this machine that the launcher sees under the same path, read only
    sources:  the checkout from which Compose builds missing images, relative to the file; None: it builds none
    """

    scenario: str
    settings: tuple[str, ...] = ()
    folder: str | None = None
    sources: str | None = None


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
    launcher: Launcher | None = None,
) -> dict[str, Any]:
    """The compose file of a run as plain values.

    user:     UID:GID of all processes inside; on a secure mesh it must own the credentials
    environment: variables of all processes inside, besides the image's own
    patience_s: how long nodes run without a launcher, s; extended by the longest disconnection of each node
    cpus, memory: limits of each container
    launcher: the launcher inside; None: it is outside

    Raises ConfigurationError for a node's name that Compose does not allow.
    """
    check_names(resolved, inside=launcher is not None)
    endpoint = levels.endpoint(secure, f"tcp/{ROUTER}:{PORT}")
    common = Anchored(
        "node",
        {
            "image": image if launcher is None else Interpolated(f"${{MAST_IMAGE:-{image}}}"),
            **(_build(launcher.sources, "node") if launcher and launcher.sources else {}),
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
    networks: dict[str, Any] = {"launcher": {"labels": {LABEL: run}}}
    networks |= {name: {"internal": True, "labels": {LABEL: run}} for name in ("wired", "wireless")}
    content = {"x-node": common, "services": services, "networks": networks}
    if launcher is not None:
        return _with_launcher(content, resolved, run, launcher, secure, endpoint)
    return content | ({"secrets": {name: {"file": file} for name, file in files.items()}} if files else {})


def _with_launcher(
    content: dict[str, Any], resolved: Resolved, run: str, launcher: Launcher, secure: str, endpoint: str
) -> dict[str, Any]:
    """A compose file with the launcher inside, and with the maker of the credentials."""
    services, networks = content["services"], content["networks"]
    name = project(run)
    volumes: dict[str, Any] = {"results": {"name": f"{name}-results", "labels": {LABEL: run}}}
    del networks["launcher"]
    for network, options in networks.items():
        options["name"] = f"{name}-{network}"
    services[ROUTER] |= {"networks": [*networks]}
    del services[ROUTER]["ports"]
    image = {
        "image": Interpolated(launcher_tag(content["x-node"]["image"])),
        **(_build(launcher.sources, LAUNCHER) if launcher.sources else {}),
    }
    what = [launcher.scenario, *(word for setting in launcher.settings for word in ("--set", setting))]
    what += ["--run", run, "--secure", secure]
    own_files = [f"{launcher.folder}:{launcher.folder}:ro"] if launcher.folder else []
    conditions: dict[str, Any] = {node: {"condition": "service_started"} for node in services}
    services[LAUNCHER] = {
        "<<": Merged("node"),
        **image,
        "container_name": container(run, LAUNCHER),
        "labels": {LABEL: run},
        "depends_on": conditions,
        "command": ["deploy", "join", *what, "--endpoint", endpoint],
        "networks": ["wired"],
        "volumes": ["results:/results", *own_files],
        "working_dir": "/results",
        "mem_limit": "2g",
        "stop_grace_period": "30s",
        "healthcheck": {"disable": True},
    }
    services[LAUNCHER]["command"] += ["--frames", Interpolated(f"${{MAST_FRAMES:-{resolved.frames}}}")]
    for node in resolved.nodes:
        services[node]["command"] = [*services[node]["command"], "--again"]
    if secure != "open":
        holders = [service for service in services if service != HOLDER]
        uid, gid = str(content["x-node"]["user"]).split(":")
        for service in holders:
            volume = f"keys-{service}"
            volumes[volume] = {
                "name": f"{name}-{volume}",
                "labels": {LABEL: run},
                "driver_opts": {
                    "type": "tmpfs",
                    "device": "tmpfs",
                    "o": f"size=1m,mode=0700,uid={uid},gid={gid}",
                },
            }
            services[service].pop("secrets", None)
            services[service]["volumes"] = [*services[service].get("volumes", ()), f"{volume}:{_SECRETS}:ro"]
            if service != LAUNCHER:
                services[service]["depends_on"] = {
                    **({ROUTER: {"condition": "service_started"}} if service != ROUTER else {}),
                    HOLDER: {"condition": "service_healthy"},
                }
        services[LAUNCHER]["command"] += ["--credentials", _SECRETS]
        first = {
            "<<": Merged("node"),
            **image,
            "container_name": container(run, HOLDER),
            "labels": {LABEL: run},
            "command": ["deploy", HOLDER, *what],
            "network_mode": "none",
            "volumes": [*(f"keys-{service}:{KEYS}/{service}" for service in holders), *own_files],
            "healthcheck": {"test": content["x-node"]["healthcheck"]["test"], **_AT_ONCE},
        }
        content["services"] = {HOLDER: first, **services}
    return {**content, "volumes": volumes}


def _build(sources: str, target: str) -> dict[str, Any]:
    base = Interpolated(f"${{MAST_BASE:-{BASE}}}")
    return {"build": {"context": sources, "dockerfile": "deploy/Dockerfile", "target": target, "args": {"BASE": base}}}


def text(resolved: Resolved, run: str, **options: Any) -> str:
    """The compose file of a run; the options are the same as for `document`."""
    secure = options.get("secure", "open")
    comment = f"# The run {quoted(run)} of the scenario {quoted(resolved.name)}, security level {secure}. "
    launcher: Launcher | None = options.get("launcher")
    if launcher is None:
        comment += (
            "`mast deploy up` wrote this file\n"
            "# and starts its services. Nodes get their configuration and return their results over the mesh.\n"
        )
        return comment + dump(document(resolved, run, **options))
    comment += (
        "`mast deploy write` wrote it. Play it:\n"
        "#     docker-compose -f FILE up            (or: docker compose -f FILE up --exit-code-from launcher)\n"
        f"#     docker cp {container(run, LAUNCHER)}:/results/. results\n"
        "#     docker-compose -f FILE down          (with --volumes the results go, too)\n"
        "# MAST_FRAMES: number of frames; MAST_IMAGE: image of the nodes (the launcher's: MAST_IMAGE-launcher).\n"
        "# Images: `mast deploy image --launcher` builds them from the packages that are installed. Without a\n"
        "# registry, add --base IMAGE: one that this machine has, with Python 3.11 and venv (docs/deploy.md).\n"
    )
    if launcher.sources:
        comment += "# Compose builds missing images, with downloads, on MAST_BASE.\n"
    return comment + dump(document(resolved, run, **options))


def check_names(resolved: Resolved, *, inside: bool = False) -> None:
    """Raise ConfigurationError for a node whose name is not a valid service name.

    inside: whether the launcher is a service, too
    """
    services = {ROUTER: "router", **({LAUNCHER: "launcher", HOLDER: "maker of certificates"} if inside else {})}
    for name in resolved.nodes:
        if not _NAME.fullmatch(name) or name in services:
            problem = f"the {services[name]}'s name" if name in services else "not a valid name for a container"
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
