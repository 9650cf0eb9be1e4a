"""A swarm of this one machine for the duration of tests."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from containers import built

from mast_zenoh.deploy.docker import docker


@contextmanager
def swarm() -> Iterator[str]:
    """The tag of the image in a swarm; an existing swarm is kept.

    Skips the test without an engine, or fails if one is required: see containers.py.
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
