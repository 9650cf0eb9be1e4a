"""A container engine, a test image, and remnants of runs."""

import functools
import os
import re
import subprocess

import pytest
from launched import MAST

from mast_zenoh.deploy import docker
from mast_zenoh.errors import EngineError

TAG = "mast-zenoh:test"

#: Set where the container tests must not be skipped, as in CI.
MUST = "MAST_TEST_DOCKER"
BASES = ("mast-base:bookworm", docker.BASE)


def base() -> str:
    """A local base image; skips without an engine or such an image."""
    try:
        docker.check()
        here = docker.docker("image", "ls", "--format", "{{.Repository}}:{{.Tag}}").split()
        return next(name for name in BASES if name in here)
    except EngineError as error:
        why = str(error)
    except StopIteration:
        why = f"none of the images {', '.join(BASES)} is here"
    if os.environ.get(MUST):
        pytest.fail(f"{MUST} is set, but {why}")
    pytest.skip(why)


def built(*, launcher: bool = False) -> str:
    """The image of these sources, built if missing; with `launcher`, also that of the launcher."""
    on = base()
    try:
        docker.check_image(TAG)
    except EngineError:
        docker.build_image(TAG, on)
    if launcher:
        _launcher_built(on)
    return TAG


@functools.cache
def _launcher_built(on: str) -> str:
    """The launcher's image, built once: its label says nothing of the launcher's sources."""
    return docker.build_image(TAG, on, launcher=True)


def remnants_of(run: str) -> dict[str, list[str]]:
    """Remnants of a run: containers, networks, volumes."""
    label = f"label=org.mast-zenoh.run={run}"
    remnants = {"containers": docker.docker("ps", "--all", "--quiet", "--filter", label).split()}
    for kind in ("network", "volume"):
        remnants[kind] = docker.docker(kind, "ls", "--quiet", "--filter", label).split()
        named = docker.docker(kind, "ls", "--format", "{{.Name}}").split()
        whole = re.compile(rf"(^|[_-]){re.sub(r'[^a-z0-9_-]', '-', run)}(_|$)")  # not a run whose name begins like this
        remnants[kind] += [name for name in named if whole.search(name)]
    return {kind: names for kind, names in remnants.items() if names}


def mast(*words: str) -> subprocess.CompletedProcess[str]:
    """Run `mast` with these arguments."""
    return subprocess.run([*MAST, *words], capture_output=True, text=True, timeout=240, check=False)
