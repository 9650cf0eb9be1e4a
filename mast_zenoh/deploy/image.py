"""The image that every node of a containerised run is made from: built from what is installed here, and checked."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path

from mast_zenoh import kernels, version
from mast_zenoh.config import bundle
from mast_zenoh.deploy import wheel
from mast_zenoh.deploy.docker import docker
from mast_zenoh.errors import EngineError

BASE = "python:3.12-slim"
TAG = f"mast-zenoh:{version.__version__}"

#: The user of its processes, unless a container is told another one.
USER = "10001:10001"

#: Says which sources are in an image.
LABEL = "org.mast-zenoh.code"

_BUILD_S = 1200.0


def build(tag: str = TAG, base: str = BASE) -> str:
    """Build the image on a base that has Python 3.11 or newer with venv; returns its tag. Raises EngineError."""
    asked = "import sys, platform; print(*sys.version_info[:2], platform.machine())"
    said = docker("run", "--rm", "--network=none", "--entrypoint=python3", base, "-c", asked, timeout=_BUILD_S)
    major, minor, machine = said.split()
    python = f"{major}.{minor}"
    wheels = wheel.third_party(wheel.cache(python, machine), python, machine)
    with tempfile.TemporaryDirectory(prefix="mast-image-") as own:
        context = Path(own)
        (context / "third_party").mkdir()
        for path in wheels:
            shutil.copyfile(path, context / "third_party" / path.name)
        wheel.build(context)
        dockerfile = bundle.ROOT / "deploy" / "Dockerfile"
        words = ["--tag", tag, "--build-arg", f"BASE={base}", "--build-arg", f"CODE={_code()}"]
        before = docker("image", "ls", "--quiet", tag).strip()
        docker("build", "--quiet", *words, "--file", str(dockerfile), str(context), timeout=_BUILD_S)
        if before and before != docker("image", "ls", "--quiet", tag).strip():
            docker("image", "rm", before, check=False)  # nobody can name it any more; whoever runs it keeps it
    return tag


def check(tag: str = TAG) -> None:
    """Raise EngineError when the image is missing, or made from other sources than these."""
    said = docker("image", "ls", "--format", "{{.ID}}", tag)
    if not said.strip():
        raise EngineError(f"there is no image {tag}: build it by `mast deploy image`")
    code = docker("image", "inspect", "--format", f'{{{{index .Config.Labels "{LABEL}"}}}}', tag).strip()
    if code != _code():
        raise EngineError(
            f"the image {tag} holds mast-zenoh {version.__version__} (sources {code or 'unknown'}), this is "
            f"{version.version_string()}: build it again by `mast deploy image`"
        )


def _code() -> str:
    """What an image made here carries: these sources, and compiled kernels if there are any here."""
    return version.fingerprint() + ("+kernels" if kernels.COMPILED else "")


def size_over_base(tag: str = TAG, base: str = BASE) -> int:
    """Bytes that the image has more than its base."""
    sizes = [int(docker("image", "inspect", "--format", "{{.Size}}", each)) for each in (tag, base)]
    return sizes[0] - sizes[1]
