"""A container engine and an image to test with, and what is left of them."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from mast_zenoh.deploy import docker, image
from mast_zenoh.errors import EngineError

TAG = "mast-zenoh:test"

#: Set where the tests with containers must run, so that they cannot be skipped: as in CI.
MUST = "MAST_TEST_DOCKER"
BASES = ("mast-base:bookworm", image.BASE)


def base() -> str:
    """An image to build on that is here; skips the test where there is no engine or none such."""
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


def built() -> str:
    """The image of these sources: built, unless it is here."""
    on = base()
    try:
        image.check(TAG)
    except EngineError:
        image.build(TAG, on)
    return TAG


def left(run: str) -> dict[str, list[str]]:
    """What there is of a run: containers, networks, volumes."""
    label = f"label=org.mast-zenoh.run={run}"
    found = {"containers": docker.docker("ps", "--all", "--quiet", "--filter", label).split()}
    for kind in ("network", "volume"):
        found[kind] = docker.docker(kind, "ls", "--quiet", "--filter", label).split()
        named = docker.docker(kind, "ls", "--format", "{{.Name}}").split()
        found[kind] += [name for name in named if re.sub(r"[^a-z0-9_-]", "-", run) in name]
    return {kind: names for kind, names in found.items() if names}


class Up:
    """`mast deploy up` as a user starts it, in a process of its own."""

    def __init__(self, out: Path, *words: str) -> None:
        self.out = out
        command = [sys.executable, "-m", "mast_zenoh", "deploy", "up", *words, "--no-report", "--out", str(out)]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)

    def record(self) -> dict[str, Any]:
        """run.json; empty while there is none."""
        path = self.out / "run.json"
        return json.loads(path.read_text()) if path.is_file() else {}

    def end(self, seconds: float = 240.0) -> tuple[int, str]:
        """(exit code, output) when it has ended by itself."""
        output, _ = self.process.communicate(timeout=seconds)
        return self.process.returncode, output


def mast(*words: str) -> subprocess.CompletedProcess[str]:
    """A command of ours."""
    command = [sys.executable, "-m", "mast_zenoh", *words]
    return subprocess.run(command, capture_output=True, text=True, timeout=240, check=False)
