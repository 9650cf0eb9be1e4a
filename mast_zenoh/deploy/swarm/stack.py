"""All that belongs to a run in a swarm: what there is of it, and its removal."""

from __future__ import annotations

import threading
import time

from mast_zenoh.deploy.docker import docker
from mast_zenoh.errors import EngineError

_NAMESPACE = "com.docker.stack.namespace"  # Docker's own label, on all that is in a stack
_REMOVED_S = 90.0
_OF_SWARM = ("service", "network", "secret", "config")
_OF_MACHINE = ("container", "network")


def left(stack: str) -> dict[str, list[str]]:
    """Ids of what there is of a stack, by kind; of containers, those of this machine. Raises EngineError."""
    active = docker("info", "--format", "{{.Swarm.LocalNodeState}}").strip() != "inactive"
    found = {}
    for kind in dict.fromkeys((*(_OF_SWARM if active else ()), *_OF_MACHINE)):
        more = ("--all",) if kind == "container" else ()
        found[kind] = docker(kind, "ls", "--quiet", *more, "--filter", f"label={_NAMESPACE}={stack}").split()
    return {kind: ids for kind, ids in found.items() if ids}


def remove(stack: str, seconds: float = _REMOVED_S) -> None:
    """Remove a stack, and wait until nothing is left of it; nothing happens where nothing is. Raises EngineError."""
    deadline = time.monotonic() + seconds
    while found := left(stack):
        if time.monotonic() > deadline:
            what = ", ".join(f"{len(ids)} {kind}(s)" for kind, ids in found.items())
            raise EngineError(f"the stack {stack} is not gone after {seconds:.0f} s: {what} left")
        if found.keys() != {"container"}:  # they end by themselves, after their services
            docker("stack", "rm", stack, check=False)  # again: a network in use is not removed
        threading.Event().wait(0.3)
