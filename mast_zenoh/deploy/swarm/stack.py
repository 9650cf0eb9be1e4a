"""Lists and removes everything that belongs to a run in a swarm."""

from __future__ import annotations

import threading
import time

from mast_zenoh.deploy.docker import docker
from mast_zenoh.errors import EngineError

_NAMESPACE = "com.docker.stack.namespace"  # Docker's own label, on everything in a stack
_REMOVAL_TIMEOUT_S = 90.0
_OF_SWARM = ("service", "network", "secret", "config")
_OF_MACHINE = ("container", "network")


def remaining_parts(stack: str) -> dict[str, list[str]]:
    """Ids of a stack's remaining parts by kind; containers of this machine only.

    Raises EngineError.
    """
    active = docker("info", "--format", "{{.Swarm.LocalNodeState}}").strip() != "inactive"
    parts = {}
    for kind in dict.fromkeys((*(_OF_SWARM if active else ()), *_OF_MACHINE)):
        options = ("--all",) if kind == "container" else ()
        parts[kind] = docker(kind, "ls", "--quiet", *options, "--filter", f"label={_NAMESPACE}={stack}").split()
    return {kind: ids for kind, ids in parts.items() if ids}


def remove(stack: str, seconds: float = _REMOVAL_TIMEOUT_S) -> None:
    """Remove a stack if it exists, and wait until it is gone; raises EngineError."""
    deadline = time.monotonic() + seconds
    while parts := remaining_parts(stack):
        if time.monotonic() > deadline:
            remaining = ", ".join(f"{len(ids)} {kind}(s)" for kind, ids in parts.items())
            raise EngineError(f"the stack {stack} still exists after {seconds:.0f} s: {remaining} left")
        if parts.keys() != {"container"}:  # they end by themselves, after their services
            docker("stack", "rm", stack, check=False)  # repeatedly, as a network in use is not removed
        threading.Event().wait(0.3)
