"""File descriptors of a run: raises the limit, or raises ResourcesExhausted."""

from __future__ import annotations

import resource

from mast_zenoh.errors import ResourcesExhausted

#: Descriptors that any run needs, and for each process of a mesh: a pipe, a log, its connection to the router.
BASE, PER_NODE = 64, 16


def ensure(processes: int) -> None:
    """Raise this process's limit to what a run needs; its nodes inherit it.

    processes: number of nodes that are processes of their own
    Raises ResourcesExhausted if the system does not allow as many.
    """
    needed = BASE + PER_NODE * processes
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft == resource.RLIM_INFINITY or soft >= needed:
        return
    if hard != resource.RLIM_INFINITY and hard < needed:
        raise ResourcesExhausted(
            f"found a limit of {hard} file descriptors, expected at least {needed} for this run: raise it (ulimit -n)"
        )
    resource.setrlimit(resource.RLIMIT_NOFILE, (needed, hard))
