"""Opens the launcher's session on a mesh whose router may still be starting."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

import zenoh

from mast_zenoh.errors import CredentialsError, EngineError, Interrupted
from mast_zenoh.launch.supervisor import how_ended
from mast_zenoh.runtime.mesh.session import open_client
from mast_zenoh.security import explain
from mast_zenoh.security.credentials import UNREACHED, Credentials

_TRY_MS = 2000


def join(
    endpoint: str, credentials: Credentials | None, seconds: float, stopped: Callable[[], object] = lambda: False
) -> zenoh.Session:
    """Connect to the router at an endpoint as soon as it answers.

    stopped: whether the run has been interrupted

    Raises Interrupted, EngineError if the router does not answer in time, CredentialsError if authentication fails.
    """
    deadline = time.monotonic() + seconds
    while True:
        if stopped():
            raise Interrupted("stopped by Ctrl-C or SIGTERM")
        try:
            return open_client(endpoint, credentials, try_ms=_TRY_MS)
        except zenoh.ZError as error:
            why = str(error)
        if credentials is not None:
            reasons = explain(credentials, endpoint)
            if any(UNREACHED not in reason for reason in reasons) and time.monotonic() > deadline:
                raise CredentialsError("; ".join(reasons))
            why = "; ".join(reasons) or why
        if time.monotonic() > deadline:
            raise EngineError(f"the router at {endpoint} cannot be reached within {seconds:.0f} s: {why}")
        threading.Event().wait(0.1)


def router_ended(router: str, code: int | None, name: str) -> EngineError:
    """The error of a run whose router has ended.

    router: description; code: exit code; name: name of its log
    """
    return EngineError(f"{router} has ended: {how_ended(code)}; see logs/{name}.log")
