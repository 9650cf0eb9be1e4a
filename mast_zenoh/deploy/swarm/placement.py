"""The machines of a swarm, and the placement of nodes on them."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable, Mapping
from fnmatch import fnmatchcase
from typing import NamedTuple

from mast_zenoh.deploy.docker import docker
from mast_zenoh.deploy.swarm.document import HOST_LABEL
from mast_zenoh.errors import ConfigurationError, EngineError, nearest

#: Actions that Docker can do only through the engine of the process's own machine.
_LOCAL_ACTIONS = ("kill", "pause", "resume")


class Machine(NamedTuple):
    """A machine of the swarm: id, host name, whether it accepts tasks, and labels."""

    id: str
    name: str
    usable: bool
    labels: Mapping[str, str]


def machines() -> list[Machine]:
    """All machines of the swarm, this one first. Raises EngineError."""
    here = docker("info", "--format", "{{.Swarm.NodeID}}").strip()
    ids = docker("node", "ls", "--quiet").split()
    lines = docker("node", "inspect", "--format", "{{json .}}", *sorted(ids, key=lambda id_: id_ != here))
    return [_machine(json.loads(line)) for line in lines.splitlines() if line]


def _machine(data: Mapping[str, dict[str, object]]) -> Machine:
    spec, status = data["Spec"], data["Status"]
    usable = spec.get("Availability") == "active" and status.get("State") == "ready"
    labels = spec.get("Labels") or {}
    assert isinstance(labels, dict)
    return Machine(str(data["ID"]), str(data["Description"]["Hostname"]), usable, labels)


def resolve(wanted: Mapping[str, str], nodes: Collection[str]) -> dict[str, str]:
    """The host of each node, by the first pattern that matches its name.

    Raises ConfigurationError for a pattern that matches no node.
    """
    for pattern in wanted:
        if not any(fnmatchcase(node, pattern) for node in nodes):
            raise ConfigurationError(f"--place {pattern}: there is no such node{nearest(pattern, nodes)}")
    matches = (
        (node, next((candidate for candidate in wanted if fnmatchcase(node, candidate)), None)) for node in nodes
    )
    return {node: wanted[pattern] for node, pattern in matches if pattern is not None}


def pinned(steps: Iterable[tuple[int, str, str]]) -> frozenset[str]:
    """The nodes that their steps (frame, action, node) bind to the launcher's machine."""
    return frozenset(node for _, action, node in steps if action in _LOCAL_ACTIONS)


def check(machines: list[Machine], place: Mapping[str, str], pinned: Collection[str]) -> None:
    """Raise EngineError if a node has no machine, or a pinned node another one.

    machines: the launcher's machine first
    """
    here = machines[0]
    if not here.usable:
        raise EngineError(
            f"this machine takes no tasks, and the router has to be here: docker node update --availability active "
            f"{here.name}"
        )
    known = {machine.labels[HOST_LABEL] for machine in machines if machine.usable and HOST_LABEL in machine.labels}
    for node, host in place.items():
        if host not in known:
            hint = nearest(host, known) if known else ""
            raise EngineError(
                f"{node}: no machine of the swarm that takes tasks has the label {HOST_LABEL}={host}{hint}; "
                f"docker node update --label-add {HOST_LABEL}={host} MACHINE"
            )
        if node in pinned and here.labels.get(HOST_LABEL) != host:
            raise EngineError(
                f"{node}: the scenario kills or pauses it, and Docker does that only to containers of the launcher's "
                f"machine, {here.name}: expected it there, found it placed on {HOST_LABEL}={host}"
            )
