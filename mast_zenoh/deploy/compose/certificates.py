"""The service of a compose file that makes the credentials of all others, and keeps them in memory."""

from __future__ import annotations

import fcntl
import tempfile
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import IO

from mast_zenoh.config.resolved import Resolved, driver_of
from mast_zenoh.control import prefix
from mast_zenoh.deploy import credentials
from mast_zenoh.deploy.compose import document
from mast_zenoh.errors import EngineError
from mast_zenoh.runtime.mesh.hosting import UP
from mast_zenoh.security.credentials import Credentials
from mast_zenoh.security.deployment import Deployment
from mast_zenoh.wiring.model import Wiring

LOCK = "lock"  # next to the launcher's credentials: locked as long as its process lives

_LAUNCHER_S = 600.0  # for the launcher to come


def make_credentials(resolved: Resolved, run: str, secure: str, folder: Path) -> None:
    """Write the credentials of all services below a folder, and wait until the launcher has ended.

    folder: has a folder for each service, a file system in memory that lasts as long as a container uses it
    """
    nodes = resolved.nodes
    with tempfile.TemporaryDirectory() as made:
        deployment = Deployment(
            secure,
            run,
            Wiring.from_json(resolved.wiring),
            nodes,
            prefix=prefix(run),
            driver=driver_of(nodes),
            hosts=[document.ROUTER],
            folder=Path(made),
        )
        assert deployment.launcher is not None
        assert deployment.control is not None
        for name in nodes:
            Credentials.read(Path(made) / name).write(folder / name)
    credentials.write_settings(folder, deployment.router)
    own = folder / document.LAUNCHER
    replace(deployment.launcher, control=deployment.control.to_json()).write(own)
    with (own / LOCK).open("wb") as lock:
        (Path(tempfile.gettempdir()) / UP).touch()  # healthy: the others may start
        deadline = time.monotonic() + _LAUNCHER_S
        while _is_free(lock):
            if time.monotonic() > deadline:
                raise EngineError(f"the launcher has not come within {_LAUNCHER_S:.0f} s")
            threading.Event().wait(0.1)
        fcntl.flock(lock, fcntl.LOCK_EX)


def _is_free(lock: IO[bytes]) -> bool:
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    fcntl.flock(lock, fcntl.LOCK_UN)
    return True
