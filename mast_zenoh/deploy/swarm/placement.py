"""The machines of a swarm, and which of them a node may run on."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable, Mapping
from fnmatch import fnmatchcase
from typing import NamedTuple

from mast_zenoh.deploy.docker import docker
from mast_zenoh.deploy.swarm.document import HOST_LABEL
from mast_zenoh.errors import ConfigurationError, EngineError, nearest

#: What Docker does to a process only through the engine of its own machine.
_AT_HOME = ("kill", "pause", "resume")


class Machine(NamedTuple):
    """A machine of the swarm: its id there, its host name, whether tasks may be placed on it, and its labels."""

    id: str
    name: str
    usable: bool
    labels: Mapping[str, str]


def machines() -> list[Machine]:
    """All of the swarm, the one that is asked first. Raises EngineError."""
    here = docker("info", "--format", "{{.Swarm.NodeID}}").strip()
    ids = docker("node", "ls", "--quiet").split()
    told = docker("node", "inspect", "--format", "{{json .}}", *sorted(ids, key=lambda each: each != here))
    return [_machine(json.loads(line)) for line in told.splitlines() if line]


def _machine(told: Mapping[str, dict[str, object]]) -> Machine:
    spec, status = told["Spec"], told["Status"]
    usable = spec.get("Availability") == "active" and status.get("State") == "ready"
    labels = spec.get("Labels") or {}
    assert isinstance(labels, dict)
    return Machine(str(told["ID"]), str(told["Description"]["Hostname"]), usable, labels)


def resolve(wanted: Mapping[str, str], nodes: Collection[str]) -> dict[str, str]:
    """By node, the host that it is to be on: of the patterns that fit its name the first decides.

    Raises ConfigurationError for a pattern that fits nobody.
    """
    for pattern in wanted:
        if not any(fnmatchcase(node, pattern) for node in nodes):
            raise ConfigurationError(f"--place {pattern}: there is no such node{nearest(pattern, nodes)}")
    fitting = ((node, next((p for p in wanted if fnmatchcase(node, p)), None)) for node in nodes)
    return {node: wanted[pattern] for node, pattern in fitting if pattern is not None}


def pinned(steps: Iterable[tuple[int, str, str]]) -> frozenset[str]:
    """The nodes that must be on the launcher's machine for what the scenario does to them: (frame, action, node)."""
    return frozenset(node for _, action, node in steps if action in _AT_HOME)


def check(found: list[Machine], place: Mapping[str, str], pinned: Collection[str]) -> None:
    """Raise EngineError where no machine can take a node, or the only one that can be asked may not have it.

    found: the launcher's machine first
    """
    here = found[0]
    if not here.usable:
        raise EngineError(
            f"this machine takes no tasks, and the router has to be here: docker node update --availability active "
            f"{here.name}"
        )
    known = {machine.labels[HOST_LABEL] for machine in found if machine.usable and HOST_LABEL in machine.labels}
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
