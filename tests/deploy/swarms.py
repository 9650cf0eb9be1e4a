"""A swarm of this one machine, for as long as tests need it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from containers import built

from mast_zenoh.deploy.docker import docker


@contextmanager
def swarm() -> Iterator[str]:
    """The tag of an image of these sources, while there is a swarm; one that is there already stays.

    Skips the test where there is no engine, and fails where there must be one: see containers.py.
    """
    tag = built()
    made = docker("info", "--format", "{{.Swarm.LocalNodeState}}").strip() == "inactive"
    if made:
        docker("swarm", "init", "--advertise-addr", "127.0.0.1")
    try:
        yield tag
    finally:
        if made:
            docker("swarm", "leave", "--force")
