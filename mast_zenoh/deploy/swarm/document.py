"""A resolved scenario as a stack file: the compose file of the same run, told in the words that a swarm knows. Pure.

What Docker restarts follows from `on_exit`: a node that is to be restarted is, after a failure, so many times as any
launcher would; the others never are. Names are resolved by DNS alone (`dnsrr`): each service has one task, and a
kernel without IPVS, which virtual addresses need, does as well.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from typing import Any

from mast_zenoh.config.resolved import Resolved
from mast_zenoh.deploy.compose import document as compose
from mast_zenoh.deploy.image import USER
from mast_zenoh.deploy.yamltext import Anchored, dump
from mast_zenoh.errors import ConfigurationError
from mast_zenoh.launch.supervisor import MAX_RESTARTS

FILE = "stack.yml"
CREDENTIALS = compose.CREDENTIALS
ROUTER = compose.ROUTER
ROUTER_SETTINGS = compose.ROUTER_SETTINGS

#: The label of a machine that constraints name: docker node update --label-add mast.host=west MACHINE
HOST_LABEL = "mast.host"

#: Before Docker starts a node again, s: time to take back that it does, where the scenario has killed it.
RESTART_DELAY_S = 2

#: From being asked to end to being killed, s.
STOP_GRACE_S = 10

#: Largest secret and largest config that a swarm takes, bytes.
LARGEST_SECRET = 500_000

_VERSION = "3.9"
_NAME = re.compile(r"[A-Za-z0-9]([-_]*[A-Za-z0-9]+)*")
_LONGEST = 63  # a service's name is a label of a domain name

#: Others find the router only when it has become healthy. Launchers are patient: it leaves by itself without one.
_ROUTER_HEALTH = {"interval": "2s", "timeout": "10s", "retries": 15, "start_period": "60s"}

#: Of a compose file, what a stack has another word for, or none.
_OTHERWISE = {
    *("container_name", "depends_on", "restart", "security_opt", "tmpfs", "ports", "secrets"),
    *("cpus", "mem_limit", "pids_limit", "labels", "<<"),
}


def stack(run: str) -> str:
    """What Docker calls all of a run: short, because it is part of the services' names."""
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

    image:  what all services are made from: NAME@DIGEST, or the id of an image that every machine has
    port:   of the launcher's machine, where the router can be reached
    here:   id of that machine in the swarm: the router runs there, and so do the nodes `pinned`
    place:  by node, the value of the label `mast.host` that its machine must have
    absent: who is not there at the beginning
    options: further ones of the compose file: environment, patience_s, cpus, memory

    Raises ConfigurationError for a node's name that is none in a swarm.
    """
    check_names(resolved)
    composed = compose.document(resolved, run, image=image, secure=secure, user=USER, **options)
    common = composed["x-node"]
    services = {}
    for name, given in composed["services"].items():
        spec = resolved.nodes.get(name)
        constraints = [f"node.id == {here}"] if spec is None or name in pinned else []
        if place and name in place:
            constraints.append(f"node.labels.{HOST_LABEL} == {place[name]}")
        own = {key: value for key, value in given.items() if key not in _OTHERWISE}
        services[name] = {"<<": given["<<"], **own}
        if spec is None:
            services[name]["healthcheck"] = common["healthcheck"] | _ROUTER_HEALTH
            services[name]["ports"] = [{"target": compose.PORT, "published": port, "protocol": "tcp", "mode": "host"}]
        if "secrets" in given:
            services[name]["secrets"] = [_readable(secret) for secret in given["secrets"]]
        services[name]["deploy"] = {
            "replicas": 0 if name in absent else 1,
            "endpoint_mode": "dnsrr",
            "labels": given["labels"],
            **({"placement": {"constraints": constraints}} if constraints else {}),
            "restart_policy": _restart_policy(router_exit(resolved.mode) if spec is None else spec.on_exit),
            "resources": {"limits": _limits(common)},
        }
    told = {key: value for key, value in common.items() if key not in _OTHERWISE}
    told["volumes"] = [{"type": "tmpfs", "target": "/tmp"}]
    told["stop_grace_period"] = f"{STOP_GRACE_S}s"
    networks = {name: {"driver": "overlay", **settings} for name, settings in composed["networks"].items()}
    content = {"version": _VERSION, "x-node": Anchored("node", told), "services": services, "networks": networks}
    return content | ({"secrets": composed["secrets"]} if "secrets" in composed else {})


def text(resolved: Resolved, run: str, **options: Any) -> str:
    """The stack file of a run; the options are those of `document`."""
    secure = options.get("secure", "open")
    told = (
        f"# The run {run} of the scenario {resolved.name}, security level {secure}: written by `mast deploy up`,\n"
        f"# which deploys it as the stack {stack(run)}, gives every node what it needs over the mesh, and collects\n"
        "# what they have found. Docker places the nodes.\n"
    )
    return told + dump(document(resolved, run, **options))


def router_exit(mode: str) -> str:
    """What the router's end means: in lock-step the run's, because what was on its way is lost, and with it the order.

    Those who are cut off would be taken for gone, and the scene played on without them.
    """
    return "restart" if mode == "realtime" else "fail"


def check_names(resolved: Resolved) -> None:
    """Raise ConfigurationError for a node that cannot be a service of a swarm."""
    compose.check_names(resolved)
    most = _LONGEST - len(service("RUN-01234567", ""))
    for name in resolved.nodes:
        if not _NAME.fullmatch(name) or len(name) > most:
            raise ConfigurationError(
                f"node {name!r}: no name for a service of a swarm; expected at most {most} letters, digits, `_` and "
                "`-`, the first and the last neither `_` nor `-`"
            )


def _readable(secret: Mapping[str, str]) -> dict[str, Any]:
    """A secret that the processes' user may read, and nobody else."""
    uid, _, gid = USER.partition(":")
    return {**secret, "uid": uid, "gid": gid, "mode": 0o600}


def _restart_policy(on_exit: str) -> dict[str, Any]:
    if on_exit != "restart":
        return {"condition": "none"}
    return {"condition": "on-failure", "delay": f"{RESTART_DELAY_S}s", "max_attempts": MAX_RESTARTS}


def _limits(common: Mapping[str, Any]) -> dict[str, Any]:
    return {"cpus": f"{common['cpus']:g}", "memory": common["mem_limit"], "pids": common["pids_limit"]}
