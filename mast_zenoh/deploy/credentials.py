"""Credentials of a run whose router is in a container, and its settings as a file."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

from mast_zenoh.deploy.compose.document import CREDENTIALS, ROUTER, ROUTER_SETTINGS
from mast_zenoh.launch.context import RunContext
from mast_zenoh.security.deployment import Deployment


def deployment(context: RunContext) -> Deployment:
    """Certificates for all nodes of a run, in its folder.

    Nodes reach the router by name, the launcher by 127.0.0.1.
    """
    return context.make_deployment([ROUTER, "127.0.0.1"], context.folder / CREDENTIALS)


def write_settings(folder: Path, router: dict[str, Any]) -> Path:
    """Write the router's settings, which hold its key, with modes 0700 and 0600.

    Their folder is next to the nodes' folders.
    """
    router_folder = folder / ROUTER
    router_folder.mkdir(mode=0o700, exist_ok=True)  # or a mounted one
    handle = os.open(router_folder / ROUTER_SETTINGS, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    with os.fdopen(handle, "w", encoding="utf-8") as file:
        json.dump(router, file, separators=(",", ":"))
    return router_folder / ROUTER_SETTINGS
