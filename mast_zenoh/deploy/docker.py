"""The `docker` command, and the image of the nodes."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path

from mast_zenoh import kernels, version
from mast_zenoh.config import bundle
from mast_zenoh.deploy import wheel
from mast_zenoh.errors import EngineError

BASE = "python:3.12-slim"
TAG = f"mast-zenoh:{version.__version__}"

#: The default user (UID:GID) of processes in containers of the image.
USER = "10001:10001"

#: The label with the fingerprint of the sources in an image.
LABEL = "org.mast-zenoh.code"

#: Beginnings of the lines that Docker writes after the one with the reason of a failure.
_NO_REASON = ("exit status", "See 'docker", "Run 'docker")

_TIMEOUT_S = 120.0
_BUILD_S = 1200.0


def docker(*words: str, timeout: float = _TIMEOUT_S, check: bool = True) -> str:
    """The standard output of `docker WORDS`; raises EngineError when it fails."""
    return run(["docker", *words], timeout=timeout, check=check)


def run(command: Sequence[str], *, timeout: float = _TIMEOUT_S, check: bool = True) -> str:
    """Run a command in its own session, so that Ctrl-C does not interrupt it."""
    try:
        done = subprocess.run(
            command,
            capture_output=True,
            text=True,
            timeout=timeout,
            check=False,
            start_new_session=True,
            stdin=subprocess.DEVNULL,
        )
    except FileNotFoundError:
        raise EngineError(f"there is no `{command[0]}` on this machine: install docker.io and docker-compose") from None
    except subprocess.TimeoutExpired:
        raise EngineError(f"`{' '.join(command[:3])}` has not ended within {timeout:.0f} s") from None
    if done.returncode and check:
        lines = [line for line in done.stderr.splitlines() if line.strip() and not line.startswith(_NO_REASON)]
        raise EngineError(f"`{' '.join(command[:3])}` failed: {lines[-1] if lines else f'exit code {done.returncode}'}")
    return done.stdout


def check() -> str:
    """The version of the Docker engine; raises EngineError if none can be reached."""
    if shutil.which("docker") is None:
        raise EngineError("there is no `docker` on this machine: install docker.io")
    try:
        return docker("version", "--format", "{{.Server.Version}}", timeout=20.0).strip()
    except EngineError as error:
        raise EngineError(
            f"the Docker engine cannot be reached ({error}): start it, or get permission to use it"
        ) from None


def exit_code(code: int) -> int:
    """Docker's exit code in Python's form: negative for a signal instead of plus 128."""
    return code if code <= 128 else 128 - code


def launcher_tag(tag: str = TAG) -> str:
    """The image of the launcher that belongs to an image of nodes."""
    return f"{tag}-launcher"


def build_image(tag: str = TAG, base: str = BASE, *, launcher: bool = False) -> str:
    """Build the image of the nodes; returns its tag. Raises EngineError.

    base: an image that has Python 3.11 or newer with venv
    launcher: whether to build the image of the launcher instead, `launcher_tag(tag)`
    """
    program = "import sys, platform; print(*sys.version_info[:2], platform.machine())"
    answer = docker("run", "--rm", "--network=none", "--entrypoint=python3", base, "-c", program, timeout=_BUILD_S)
    major, minor, machine = answer.split()
    python = f"{major}.{minor}"
    target, tag = ("launcher", launcher_tag(tag)) if launcher else ("node", tag)
    with tempfile.TemporaryDirectory(prefix="mast-image-") as folder:
        context = Path(folder)
        wheels = {"third_party": wheel.requirements()}
        if launcher:
            wheels["launcher_party"] = wheel.launcher_requirements()
        for part, required in wheels.items():
            (context / part).mkdir()
            for path in wheel.third_party(wheel.cache(python, machine), python, machine, required):
                shutil.copyfile(path, context / part / path.name)
        wheel.build(context)
        wheel.build_plugins(context)
        (context / "deploy").mkdir()
        for name in ("Dockerfile", wheel.REQUIREMENTS):
            shutil.copyfile(bundle.ROOT / "deploy" / name, context / "deploy" / name)
        options = ["--tag", tag, "--build-arg", f"BASE={base}", "--build-arg", f"CODE={_code()}", "--target", target]
        before = docker("image", "ls", "--quiet", tag).strip()
        dockerfile = context / "deploy" / "Dockerfile"
        docker("build", "--quiet", *options, "--file", str(dockerfile), str(context), timeout=_BUILD_S)
        if before and before != docker("image", "ls", "--quiet", tag).strip():
            docker("image", "rm", before, check=False)  # now untagged; running containers keep using it
    return tag


def check_image(tag: str = TAG) -> None:
    """Raise EngineError if the image is missing or was built from other sources."""
    ids = docker("image", "ls", "--format", "{{.ID}}", tag)
    if not ids.strip():
        raise EngineError(f"there is no image {tag}: build it with `mast deploy image`")
    code = docker("image", "inspect", "--format", f'{{{{index .Config.Labels "{LABEL}"}}}}', tag).strip()
    if code != _code():
        raise EngineError(
            f"the image {tag} holds mast-zenoh {version.__version__} (sources {code or 'unknown'}), expected "
            f"{version.version_string()}: rebuild it with `mast deploy image`"
        )


def _code() -> str:
    """The value of LABEL: the sources' fingerprint, and whether kernels are compiled."""
    return version.fingerprint() + ("+kernels" if kernels.COMPILED else "")


def size_over_base(tag: str = TAG, base: str = BASE) -> int:
    """Size of the image minus the size of its base, bytes."""
    sizes = [int(docker("image", "inspect", "--format", "{{.Size}}", name)) for name in (tag, base)]
    return sizes[0] - sizes[1]
