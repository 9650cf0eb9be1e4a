"""Secures a mesh against outsiders, and restricts nodes to their own wires.

docs/explanation-security.md has the threat model.

levels       open, tls, mtls, acl: the Zenoh settings of each
authority    one certificate authority per deployment, a certificate per node
credentials  certificates and keys of a process: a folder of files
control_keys keys that sign and verify control messages
access       the wiring as Zenoh's access control: default deny
deployment   all of these for one run
diagnosis    why a certificate is refused
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mast_zenoh.mesh.security.credentials import Credentials


def explain(credentials: Credentials | Path, endpoint: str | None = None) -> list[str]:
    """Reasons why these credentials would be refused; see `diagnosis.explain`."""
    from mast_zenoh.mesh.security import diagnosis  # slow to load, and seldom needed

    return diagnosis.explain(credentials, endpoint)
