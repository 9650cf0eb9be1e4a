"""A resolved scenario as a compose file: services for the router and every node.

Nodes have no access to the host except to their credentials. They are on one of two networks without external access:
`wired` for static nodes, and `wireless` for mobile agents and interposers on their wires. The router is on both.

With a `Launcher`, a compose file is complete: `docker-compose up` plays the run. One more service makes the
certificates and waits, so that the file systems in memory that hold them stay; the launcher starts last. No container
ends before the launcher, or `--exit-code-from launcher` would end the run with it. Pure functions.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import yaml

from mast_zenoh.config.resolved import NodeSpec, Resolved
from mast_zenoh.deploy.docker import BASE, USER, launcher_tag
from mast_zenoh.deploy.engine import CREDENTIALS, NUMERIC_VARIABLES, ROUTER_SETTINGS
from mast_zenoh.errors import ConfigurationError
from mast_zenoh.runtime.mesh.hosting import UP
from mast_zenoh.security import levels
from mast_zenoh.security.credentials import AUTHORITY, CERTIFICATE, CONTROL, KEY

COMPOSE_FILE = "compose.yml"
ROUTER = "router"
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


# -- YAML --------------------------------------------------------------------------------------------------------


class _Interpolated(str):
    """Text in which Compose replaces `${VARIABLE:-default}`."""


class _Merge(str):
    """The key whose mapping is merged into the one that has it."""


class _Anchored(dict[str, Any]):
    """The settings of all services: written once, with an anchor."""


_MERGE = _Merge("<<")


class _Dumper(yaml.SafeDumper):  # type: ignore[misc]
    def ignore_aliases(self, data: Any) -> bool:
        return not isinstance(data, _Anchored)

    def generate_anchor(self, node: Any) -> str:
        return "node"

    def text(self, value: str) -> Any:
        """A scalar, on one line; `$` is doubled, for Compose."""
        doubled = value if isinstance(value, _Interpolated) else value.replace("$", "$$")
        return self.represent_scalar("tag:yaml.org,2002:str", doubled, style=None if value.isprintable() else '"')

    def merge(self, value: str) -> Any:
        return self.represent_scalar("tag:yaml.org,2002:merge", value)

    def sequence(self, items: list[Any]) -> Any:
        return self.represent_sequence("tag:yaml.org,2002:seq", items, flow_style=not _nested(items))

    def mapping(self, items: dict[str, Any]) -> Any:
        return self.represent_mapping("tag:yaml.org,2002:map", items, flow_style=not _nested(items.values()))


def _nested(items: Iterable[Any]) -> bool:
    return any(isinstance(item, (dict, list)) for item in items)


_Dumper.add_representer(str, _Dumper.text)
_Dumper.add_representer(_Interpolated, _Dumper.text)
_Dumper.add_representer(_Merge, _Dumper.merge)
_Dumper.add_representer(list, _Dumper.sequence)
_Dumper.add_representer(dict, _Dumper.mapping)
_Dumper.add_representer(_Anchored, _Dumper.mapping)


def dump(content: Mapping[str, Any]) -> str:
    """The YAML text; lists and mappings of plain values are on one line."""
    options = {"sort_keys": False, "width": float("inf"), "allow_unicode": True}
    return str(yaml.dump(dict(content), Dumper=_Dumper, **options))


# -- compose files -----------------------------------------------------------------------------------------------


def project(run: str) -> str:
    """The Compose project of a run: lower case letters, digits, `_` and `-`."""
    return "mast-" + re.sub(r"[^a-z0-9_-]", "-", run.lower())


def container(run: str, node: str) -> str:
    """The name of a node's container."""
    return f"{project(run)}-{node}"


def compose(
    resolved: Resolved,
    run: str,
    *,
    image: str,
    secure: str = "open",
    user: str = USER,
    environment: Mapping[str, str] | None = None,
    patience_s: float = 10.0,
    launcher: Launcher | None = None,
) -> dict[str, Any]:
    """The compose file of a run as plain values.

    user:     UID:GID of all processes inside; on a secure mesh it must own the credentials
    environment: variables of all processes inside, besides the image's own; with the launcher inside, also those of
             `NUMERIC_VARIABLES` that are set where Compose runs
    patience_s: how long nodes run without a launcher, s; extended by the longest disconnection of each node
    launcher: the launcher inside; None: it is outside

    Raises ConfigurationError for a node's name that Compose does not allow.
    """
    check_names(resolved, inside=launcher is not None)
    endpoint = levels.endpoint(secure, f"tcp/{ROUTER}:{PORT}")
    common = _Anchored(
        image=image if launcher is None else _Interpolated(f"${{MAST_IMAGE:-{image}}}"),
        **_build(launcher, "node"),
        user=user,
        **_environment(environment, inside=launcher is not None),
        init=True,
        read_only=True,
        tmpfs=["/tmp:mode=1777"],
        cap_drop=["ALL"],
        security_opt=["no-new-privileges:true"],
        restart="no",
        cpus=1.0,
        mem_limit="1g",
        pids_limit=200,
        healthcheck={
            "test": ["CMD", "test", "-e", f"/tmp/{UP}"],
            "interval": "10s",
            "timeout": "10s",
            "retries": 3,
            "start_period": "60s",
        },
    )
    credential_files = (AUTHORITY, CONTROL) if secure == "tls" else (AUTHORITY, CERTIFICATE, KEY, CONTROL)
    files: dict[str, Any] = {}

    def service(name: str, words: list[str], networks: list[str], option: str, secrets: tuple[str, ...]) -> Any:
        options: dict[str, Any] = {"container_name": container(run, name), "labels": {LABEL: run}, "networks": networks}
        if secure == "open":
            return {_MERGE: common, **options, "command": words}
        if launcher is None:
            files.update({f"{name}_{file}": {"file": f"./{CREDENTIALS}/{name}/{file}"} for file in secrets})
            options["secrets"] = [{"source": f"{name}_{file}", "target": file} for file in secrets]
        return {_MERGE: common, **options, "command": [*words, *option.split()]}

    listen = levels.endpoint(secure, f"tcp/0.0.0.0:{PORT}")
    words = ["--router", "--run", run, "--listen", listen, "--patience", f"{patience_s:g}"]
    settings = f"--settings {_SECRETS}/{ROUTER_SETTINGS}"
    services = {ROUTER: service(ROUTER, words, ["launcher", "wired", "wireless"], settings, (ROUTER_SETTINGS,))}
    services[ROUTER]["ports"] = [f"127.0.0.1::{PORT}"]
    for name in resolved.nodes:
        patience = patience_s + longest_disconnection_s(resolved, name)
        words = ["--name", name, "--run", run, "--endpoint", endpoint, "--patience", f"{patience:g}"]
        network = "wireless" if is_mobile(resolved, name) else "wired"
        services[name] = service(name, words, [network], f"--credentials {_SECRETS}", credential_files)
        services[name]["depends_on"] = [ROUTER]
    networks: dict[str, Any] = {"launcher": {"labels": {LABEL: run}}}
    networks |= {name: {"internal": True, "labels": {LABEL: run}} for name in ("wired", "wireless")}
    content: dict[str, Any] = {"x-node": common, "services": services, "networks": networks}
    if launcher is not None:
        return _with_launcher(content, resolved, run, launcher, secure, endpoint)
    return content | ({"secrets": files} if files else {})


def _with_launcher(
    content: dict[str, Any], resolved: Resolved, run: str, launcher: Launcher, secure: str, endpoint: str
) -> dict[str, Any]:
    """A compose file with the launcher inside, and with the maker of the credentials."""
    services, networks, common = content["services"], content["networks"], content["x-node"]
    name = project(run)
    labels = {"labels": {LABEL: run}}
    volumes: dict[str, Any] = {"results": {"name": f"{name}-results", **labels}}
    del networks["launcher"], services[ROUTER]["ports"]
    for network, options in networks.items():
        options["name"] = f"{name}-{network}"
    services[ROUTER]["networks"] = [*networks]
    what = [launcher.scenario, *(word for setting in launcher.settings for word in ("--set", setting))]
    what += ["--run", run, "--secure", secure]
    own_files = [f"{launcher.folder}:{launcher.folder}:ro"] if launcher.folder else []

    def service(name: str, command: list[str], volumes: list[str], **more: Any) -> dict[str, Any]:
        image = {"image": _Interpolated(launcher_tag(common["image"])), **_build(launcher, LAUNCHER)}
        volumes = [*volumes, *own_files]
        own = {"container_name": container(run, name), **labels, "command": command, "volumes": volumes}
        return {_MERGE: common, **image, **own, **more}

    for node in resolved.nodes:
        services[node]["command"] = [*services[node]["command"], "--again"]
    frames = ["--frames", _Interpolated(f"${{MAST_FRAMES:-{resolved.frames}}}")]
    services[LAUNCHER] = service(
        LAUNCHER,
        ["deploy", "join", *what, "--endpoint", endpoint, *frames],
        ["results:/results"],
        depends_on={node: {"condition": "service_started"} for node in services},
        networks=["wired"],
        working_dir="/results",
        mem_limit="2g",
        stop_grace_period="30s",
        healthcheck={"disable": True},
    )
    if secure != "open":
        uid, gid = common["user"].split(":")
        tmpfs = {"type": "tmpfs", "device": "tmpfs", "o": f"size=1m,mode=0700,uid={uid},gid={gid}"}
        for node, options in services.items():
            volumes[f"keys-{node}"] = {"name": f"{name}-keys-{node}", **labels, "driver_opts": tmpfs}
            options["volumes"] = [*options.get("volumes", ()), f"keys-{node}:{_SECRETS}:ro"]
            if node != LAUNCHER:
                needs = {ROUTER: {"condition": "service_started"}} if node != ROUTER else {}
                options["depends_on"] = needs | {HOLDER: {"condition": "service_healthy"}}
        services[LAUNCHER]["command"] += ["--credentials", _SECRETS]
        first = service(
            HOLDER,
            ["deploy", HOLDER, *what],
            [f"keys-{node}:{KEYS}/{node}" for node in services],
            network_mode="none",
            healthcheck={"test": common["healthcheck"]["test"], **_AT_ONCE},
        )
        content["services"] = {HOLDER: first, **services}
    return {**content, "volumes": volumes}


def _environment(values: Mapping[str, str] | None, *, inside: bool) -> dict[str, Any]:
    passed: dict[str, str | None] = {**(dict.fromkeys(NUMERIC_VARIABLES) if inside else {}), **(values or {})}
    return {"environment": passed} if passed else {}


def _build(launcher: Launcher | None, target: str) -> dict[str, Any]:
    if launcher is None or launcher.sources is None:
        return {}
    base = _Interpolated(f"${{MAST_BASE:-{BASE}}}")
    build = {"context": launcher.sources, "dockerfile": "deploy/Dockerfile", "target": target, "args": {"BASE": base}}
    return {"build": build}


def compose_text(resolved: Resolved, run: str, **options: Any) -> str:
    """The compose file of a run; the options are the same as for `compose`."""
    launcher: Launcher | None = options.get("launcher")
    if launcher is None:
        usage = (
            "`mast deploy up` wrote this file\n"
            "# and starts its services. Nodes get their configuration and return their results over the mesh.\n"
        )
    else:
        usage = (
            "`mast deploy write` wrote it. Play it:\n"
            "#     docker-compose -f FILE up            (or: docker compose -f FILE up --exit-code-from launcher)\n"
            f"#     docker cp {container(run, LAUNCHER)}:/results/. results\n"
            "#     docker-compose -f FILE down          (with --volumes the results go, too)\n"
            "# MAST_FRAMES: number of frames; MAST_IMAGE: image of the nodes (the launcher's: MAST_IMAGE-launcher).\n"
            "# Images: `mast deploy image --launcher` builds them from the packages that are installed. Without a\n"
            "# registry, add --base IMAGE: one that this machine has, with Python 3.11 and venv (docs/deploy.md).\n"
        )
        if launcher.sources:
            usage += "# Compose builds missing images, with downloads, on MAST_BASE.\n"
    return f"{_heading(resolved, run, options)}. {usage}{dump(compose(resolved, run, **options))}"


def _heading(resolved: Resolved, run: str, options: Mapping[str, Any]) -> str:
    secure = options.get("secure", "open")
    names = json.dumps(run), json.dumps(resolved.name)  # without line breaks
    return f"# The run {names[0]} of the scenario {names[1]}, security level {secure}"


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


def _is_mobile_agent(spec: NodeSpec) -> bool:
    return spec.role == "agent" and bool(spec.config.get("mobile"))


def longest_disconnection_s(resolved: Resolved, name: str) -> float:
    """The longest disconnection of a node in the scenario, s of wall-clock time."""
    steps = [step for step in resolved.steps if step.node == name]
    pairs = [pair for pair in pairwise(steps) if pair[0].action == "disconnect"]
    frames = max((after.frame - before.frame for before, after in pairs), default=0)
    return frames * resolved.period_ns * 1e-9 / resolved.rate
