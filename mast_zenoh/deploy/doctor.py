"""Checks what this machine can do; each check reports a finding and a fix."""

from __future__ import annotations

import platform
import shutil
import sys
from collections.abc import Callable, Iterator
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple

from mast_zenoh import kernels
from mast_zenoh import version as release
from mast_zenoh.deploy import docker as engine
from mast_zenoh.deploy.compose import command
from mast_zenoh.deploy.swarm import check_manager, machines
from mast_zenoh.errors import BackendError, EngineError
from mast_zenoh.launch.netns import shaping
from mast_zenoh.launch.netns.namespaces import Owner
from mast_zenoh.runtime.mesh.session import open_router
from mast_zenoh.security import explain


class Finding(NamedTuple):
    """The result of a check.

    ok: None for an optional part that is missing; fix: what to do, if anything
    """

    name: str
    ok: bool | None
    detail: str
    fix: str = ""


def examine(credentials: Path | None = None, endpoint: str | None = None) -> Iterator[Finding]:
    """Run all checks, and check a folder of credentials if one is named."""
    for check in CHECKS:
        yield check()
    if credentials is not None:
        reasons = explain(credentials, endpoint)
        where = f"{credentials}{f' at {endpoint}' if endpoint else ''}"
        yield Finding("certificates", not reasons, "; ".join(reasons) or f"{where}: valid")


def python() -> Finding:
    """The versions of Python and of this package."""
    return Finding(
        "python", sys.version_info >= (3, 11), f"{platform.python_version()}, mast-zenoh {release.version_string()}"
    )


def compiled_kernels() -> Finding:
    """Whether compiled kernels are in use."""
    reason = kernels.why_not()
    if reason:
        fix = "unset MAST_KERNELS" if kernels.COMPILED else kernels.HOW
        return Finding("kernels", None, f"not used, NumPy is slower: {reason}", fix)
    return Finding("kernels", True, "compiled")


def mesh() -> Finding:
    """Whether a router comes up on the loopback interface."""
    try:
        session, endpoint = open_router()
    except Exception as error:
        return Finding("zenoh", False, str(error), "reinstall eclipse-zenoh")
    session.close()  # type: ignore[no-untyped-call]
    return Finding("zenoh", True, f"{version('eclipse-zenoh')}, a router came up at {endpoint}")


def docker() -> Finding:
    """Whether this user can use a Docker engine."""
    try:
        return Finding("docker", True, f"engine {engine.check()}")
    except EngineError as error:
        return Finding("docker", None, str(error), "apt install docker.io; usermod -aG docker $USER")


def compose() -> Finding:
    """Whether docker-compose is installed."""
    try:
        words = command()
        version_text = engine.run([*words, "version", "--short"], timeout=30.0).strip()
    except EngineError as error:
        return Finding("compose", None, str(error), "apt install docker-compose")
    return Finding("compose", True, f"{' '.join(words)} {version_text}")


def swarm() -> Finding:
    """Whether this machine manages a swarm."""
    try:
        engine.check()
        check_manager()
        usable = [machine.name for machine in machines() if machine.usable]
    except EngineError as error:
        return Finding("swarm", None, str(error), "docker swarm init --advertise-addr 127.0.0.1")
    return Finding("swarm", True, f"{len(usable)} machine(s) take nodes: {', '.join(usable)}")


def node_image() -> Finding:
    """Whether the image exists and was built from these sources."""
    try:
        engine.check_image()
    except EngineError as error:
        return Finding("image", None, str(error), "mast deploy image")
    return Finding("image", True, engine.TAG)


def ssh() -> Finding:
    """Whether other hosts can be reached by SSH."""
    try:
        return Finding("ssh", True, f"asyncssh {version('asyncssh')}")
    except ModuleNotFoundError:
        return Finding("ssh", None, "asyncssh is not installed", "pip install 'mast-zenoh[deploy]'")


def namespaces() -> Finding:
    """Whether hosts of a scenario can be network namespaces of this machine."""
    try:
        wanted = {need: ["hosts"] for need in ("partition", "loss", "bandwidth", "delay")}
        means = shaping.delays_by(wanted, Owner.this_process())
    except BackendError as error:
        return Finding("namespaces", None, str(error), "see docs/network.md")
    return Finding("namespaces", True, f"yes, delays by {means}")


def disk_space() -> Finding:
    """The free disk space here."""
    free = shutil.disk_usage(Path.cwd()).free
    return Finding(
        "disk", free > 1 << 28, f"{free >> 30} GiB free in {Path.cwd()}", "" if free > 1 << 28 else "make room"
    )


CHECKS: list[Callable[[], Finding]] = [
    python,
    compiled_kernels,
    mesh,
    docker,
    compose,
    swarm,
    node_image,
    ssh,
    namespaces,
    disk_space,
]
