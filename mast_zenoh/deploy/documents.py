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
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, partial
from itertools import pairwise
from typing import Any

import yaml
from jinja2 import Environment, PackageLoader, StrictUndefined, Template

from mast_zenoh.config.resolved import Resolved
from mast_zenoh.deploy.docker import BASE, USER, launcher_tag
from mast_zenoh.deploy.engine import CREDENTIALS, NUMERIC_VARIABLES, ROUTER_SETTINGS
from mast_zenoh.errors import ConfigurationError
from mast_zenoh.mesh.hosting import UP
from mast_zenoh.mesh.security import levels
from mast_zenoh.mesh.security.credentials import AUTHORITY, CERTIFICATE, CONTROL, KEY

COMPOSE_FILE = "compose.yml"
ROUTER = "router"
PORT = 7447
LABEL = "org.mast-zenoh.run"  # on everything that belongs to a run

LAUNCHER = "launcher"
HOLDER = "certificates"  # the service that makes the credentials and keeps them in memory
KEYS = "/keys"  # where it has the credentials of all

_SECRETS = "/run/secrets"
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


class _Interpolated(str):
    """Text in which Compose replaces `${VARIABLE:-default}`."""


class _Dumper(yaml.SafeDumper):  # type: ignore[misc]
    def ignore_aliases(self, data: Any) -> bool:
        return True

    def text(self, value: str) -> Any:
        """A scalar, on one line; `$` is doubled, for Compose."""
        doubled = value if isinstance(value, _Interpolated) else value.replace("$", "$$")
        return self.represent_scalar("tag:yaml.org,2002:str", doubled, style=None if value.isprintable() else '"')


_Dumper.add_representer(str, _Dumper.text)
_Dumper.add_representer(_Interpolated, _Dumper.text)


def on_one_line(value: Any) -> str:
    """A plain value as YAML."""
    options = {"sort_keys": False, "width": float("inf"), "allow_unicode": True, "default_flow_style": True}
    return str(yaml.dump(value, Dumper=_Dumper, **options)).removesuffix("\n").removesuffix("\n...")


@cache
def _template() -> Template:
    environment = Environment(
        loader=PackageLoader("mast_zenoh.deploy"),
        undefined=StrictUndefined,
        trim_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters |= {"yaml": on_one_line, "json": json.dumps}
    return environment.get_template("compose.yml.j2")


def project(run: str) -> str:
    """The Compose project of a run: lower case letters, digits, `_` and `-`."""
    return "mast-" + re.sub(r"[^a-z0-9_-]", "-", run.lower())


def container(run: str, node: str) -> str:
    """The name of a node's container."""
    return f"{project(run)}-{node}"


def compose_text(
    resolved: Resolved,
    run: str,
    *,
    image: str,
    secure: str = "open",
    user: str = USER,
    environment: Mapping[str, str] | None = None,
    patience_s: float = 10.0,
    launcher: Launcher | None = None,
) -> str:
    """The compose file of a run.

    user:     UID:GID of all processes inside; on a secure mesh it must own the credentials
    environment: variables of all processes inside, besides the image's own; with the launcher inside, also those of
             `NUMERIC_VARIABLES` that are set where Compose runs
    patience_s: how long nodes run without a launcher, s; extended by the longest disconnection of each node
    launcher: the launcher inside; None: it is outside

    Raises ConfigurationError for a node's name that Compose does not allow.
    """
    inside = launcher is not None
    check_names(resolved, inside=inside)
    endpoint = levels.endpoint(secure, f"tcp/{ROUTER}:{PORT}")
    listen = levels.endpoint(secure, f"tcp/0.0.0.0:{PORT}")
    settings, credentials = (
        ([], []) if secure == "open" else (["--settings", f"{_SECRETS}/{ROUTER_SETTINGS}"], ["--credentials", _SECRETS])
    )
    commands = {ROUTER: ["--router", "--run", run, "--listen", listen, "--patience", f"{patience_s:g}", *settings]}
    for name in resolved.nodes:
        patience = f"{patience_s + longest_disconnection_s(resolved, name):g}"
        words = ["--name", name, "--run", run, "--endpoint", endpoint, "--patience", patience, *credentials]
        commands[name] = words + ["--again"] * inside
    files = (AUTHORITY, CONTROL) if secure == "tls" else (AUTHORITY, CERTIFICATE, KEY, CONTROL)
    content: dict[str, Any] = {
        "run": run,
        "scenario": resolved.name,
        "project": project(run),
        "container": partial(container, run),
        "labels": on_one_line({LABEL: run}),
        "secure": secure,
        "image": image,
        "user": user,
        "environment": dict(environment or {}),
        "networks": {name: "wireless" if is_mobile(resolved, name) else "wired" for name in resolved.nodes},
        "commands": commands,
        "credentials": {ROUTER: [ROUTER_SETTINGS], **dict.fromkeys(resolved.nodes, files)},
        "launcher": launcher,
        "base": BASE,
        "folder": CREDENTIALS,
        "secrets": _SECRETS,
        "port": PORT,
        "up": UP,
    }
    if launcher is not None:
        what = [launcher.scenario, *(word for setting in launcher.settings for word in ("--set", setting))]
        what += ["--run", run, "--secure", secure]
        image = f"${{MAST_IMAGE:-{image}}}"
        keyed = [] if secure == "open" else [*commands, LAUNCHER]
        frames = ["--frames", _Interpolated(f"${{MAST_FRAMES:-{resolved.frames}}}")]
        commands[LAUNCHER] = ["deploy", "join", *what, "--endpoint", endpoint, *frames, *credentials]
        uid, gid = user.split(":")
        content |= {
            "what": what,
            "image": _Interpolated(image),
            "image_of_launcher": _Interpolated(launcher_tag(image)),
            "environment": {**dict.fromkeys(NUMERIC_VARIABLES), **content["environment"]},
            "own_files": [f"{launcher.folder}:{launcher.folder}:ro"] if launcher.folder else [],
            "keyed": keyed,
            "key_folders": [f"keys-{name}:{KEYS}/{name}" for name in keyed],
            "launcher_volumes": ["results:/results", *([f"keys-{LAUNCHER}:{_SECRETS}:ro"] if keyed else [])],
            "tmpfs": {"type": "tmpfs", "device": "tmpfs", "o": f"size=1m,mode=0700,uid={uid},gid={gid}"},
        }
    return re.sub(r"\n\n+", "\n", _template().render(content))


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
    return any(each.role == "agent" and each.config.get("mobile") for each in [spec, *agents])


def longest_disconnection_s(resolved: Resolved, name: str) -> float:
    """The longest disconnection of a node in the scenario, s of wall-clock time."""
    steps = [step for step in resolved.steps if step.node == name]
    pairs = [pair for pair in pairwise(steps) if pair[0].action == "disconnect"]
    frames = max((after.frame - before.frame for before, after in pairs), default=0)
    return frames * resolved.period_ns * 1e-9 / resolved.rate
