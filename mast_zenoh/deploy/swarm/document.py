"""A resolved scenario as a stack file: the compose file, converted for a swarm.

Docker restarts a node after a failure if its `on_exit` requests it, as often as a launcher would; other nodes are never
restarted. Names are resolved by DNS only (`dnsrr`): each service has one task, and virtual addresses would need a
kernel with IPVS. Pure functions.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from typing import Any

from mast_zenoh.config.resolved import Resolved
from mast_zenoh.deploy.compose import document as compose
from mast_zenoh.deploy.image import USER
from mast_zenoh.deploy.yamltext import Anchored, dump, quoted
from mast_zenoh.errors import ConfigurationError
from mast_zenoh.launch.supervisor import MAX_RESTARTS

FILE = "stack.yml"
CREDENTIALS = compose.CREDENTIALS
ROUTER = compose.ROUTER
ROUTER_SETTINGS = compose.ROUTER_SETTINGS

#: The label of a machine that constraints name: docker node update --label-add mast.host=west MACHINE
HOST_LABEL = "mast.host"

#: Delay before Docker restarts a node, s: time to cancel the restart if the scenario has killed the node.
RESTART_DELAY_S = 2

#: Time between SIGTERM and SIGKILL, s.
STOP_GRACE_S = 10

#: Largest secret and config that a swarm accepts, bytes.
LARGEST_SECRET = 500_000

_VERSION = "3.9"
_NAME = re.compile(r"[A-Za-z0-9]([-_]*[A-Za-z0-9]+)*")
_MAX_LABEL = 63  # a service's name is a label of a domain name

#: Other services can resolve the router only once it is healthy. Launchers wait; without one, the router leaves.
_ROUTER_HEALTH = {"interval": "2s", "timeout": "10s", "retries": 15, "start_period": "60s"}

#: Keys of a compose file that a stack file spells differently or lacks.
_COMPOSE_ONLY = {
    *("container_name", "depends_on", "restart", "security_opt", "tmpfs", "ports", "secrets"),
    *("cpus", "mem_limit", "pids_limit", "labels", "<<"),
}


def stack(run: str) -> str:
    """The stack name of a run: short, because it is part of the services' names."""
    return "mast-" + re.sub(r"[^a-z0-9]", "", run.rpartition("-")[2].lower())


def service(run: str, node: str) -> str:
    """The full name of a node's service."""
    return f"{stack(run)}_{node}"


def document(
    resolved: Resolved,
    run: str,
    *,
    image: str,
    port: int,
    here: str,
    secure: str = "open",
    place: Mapping[str, str] | None = None,
    pinned: Collection[str] = (),
    absent: Collection[str] = (),
    **options: Any,
) -> dict[str, Any]:
    """The stack file of a run as plain values.

    image:  image of all services: NAME@DIGEST, or the id of an image that every machine has
    port:   port of the router on the launcher's machine
    here:   id of that machine in the swarm: the router and the nodes `pinned` run there
    place:  by node, the value of the label `mast.host` that its machine must have
    absent: nodes that do not start with the run
    options: other settings of the compose file: environment, patience_s, cpus, memory

    Raises ConfigurationError for a node's name that a swarm does not allow.
    """
    check_names(resolved)
    composed = compose.document(resolved, run, image=image, secure=secure, user=USER, **options)
    common = composed["x-node"]
    services = {}
    for name, composed_service in composed["services"].items():
        spec = resolved.nodes.get(name)
        constraints = [f"node.id == {here}"] if spec is None or name in pinned else []
        if place and name in place:
            constraints.append(f"node.labels.{HOST_LABEL} == {place[name]}")
        kept = {key: value for key, value in composed_service.items() if key not in _COMPOSE_ONLY}
        services[name] = {"<<": composed_service["<<"], **kept}
        if spec is None:
            services[name]["healthcheck"] = common["healthcheck"] | _ROUTER_HEALTH
            services[name]["ports"] = [{"target": compose.PORT, "published": port, "protocol": "tcp", "mode": "host"}]
        if "secrets" in composed_service:
            services[name]["secrets"] = [_readable(secret) for secret in composed_service["secrets"]]
        services[name]["deploy"] = {
            "replicas": 0 if name in absent else 1,
            "endpoint_mode": "dnsrr",
            "labels": composed_service["labels"],
            **({"placement": {"constraints": constraints}} if constraints else {}),
            "restart_policy": _restart_policy(router_exit(resolved.mode) if spec is None else spec.on_exit),
            "resources": {"limits": _limits(common)},
        }
    node = {key: value for key, value in common.items() if key not in _COMPOSE_ONLY}
    node["volumes"] = [{"type": "tmpfs", "target": "/tmp"}]
    node["stop_grace_period"] = f"{STOP_GRACE_S}s"
    networks = {name: {"driver": "overlay", **settings} for name, settings in composed["networks"].items()}
    content = {"version": _VERSION, "x-node": Anchored("node", node), "services": services, "networks": networks}
    return content | ({"secrets": composed["secrets"]} if "secrets" in composed else {})


def text(resolved: Resolved, run: str, **options: Any) -> str:
    """The stack file of a run; the options are the same as for `document`."""
    secure = options.get("secure", "open")
    comment = (
        f"# The run {quoted(run)} of the scenario {quoted(resolved.name)}, security level {secure}: written by\n"
        f"# `mast deploy up`, which deploys it as the stack {stack(run)}, gives every node what it needs over the\n"
        "# mesh, and collects their results. Docker places the nodes.\n"
    )
    return comment + dump(document(resolved, run, **options))


def router_exit(mode: str) -> str:
    """The router's `on_exit`: in lock-step it ends the run, as messages are lost.

    The run would treat disconnected nodes as gone, and continue the scene without them.
    """
    return "restart" if mode == "realtime" else "fail"


def check_names(resolved: Resolved) -> None:
    """Raise ConfigurationError for a node that cannot be a service of a swarm."""
    compose.check_names(resolved)
    max_length = _MAX_LABEL - len(service("RUN-01234567", ""))
    for name in resolved.nodes:
        if not _NAME.fullmatch(name) or len(name) > max_length:
            raise ConfigurationError(
                f"node {name!r}: no name for a service of a swarm; expected at most {max_length} letters, digits, `_` "
                "and `-`, the first and the last neither `_` nor `-`"
            )


def _readable(secret: Mapping[str, str]) -> dict[str, Any]:
    """A secret that only the user of the processes may read."""
    uid, _, gid = USER.partition(":")
    return {**secret, "uid": uid, "gid": gid, "mode": 0o600}


def _restart_policy(on_exit: str) -> dict[str, Any]:
    if on_exit != "restart":
        return {"condition": "none"}
    return {"condition": "on-failure", "delay": f"{RESTART_DELAY_S}s", "max_attempts": MAX_RESTARTS}


def _limits(common: Mapping[str, Any]) -> dict[str, Any]:
    return {"cpus": f"{common['cpus']:g}", "memory": common["mem_limit"], "pids": common["pids_limit"]}
