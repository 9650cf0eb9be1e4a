"""The `docker` command, with errors that say what to do if it is missing or fails."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Sequence

from mast_zenoh.errors import EngineError

_TIMEOUT_S = 120.0


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
        # Docker names each failure on a line, followed by "exit status 1".
        lines = [line for line in done.stderr.splitlines() if line.strip() and not line.startswith("exit status")]
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
