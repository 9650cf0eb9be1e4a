"""The security of one run: authority, certificates, the router's rules."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterable
from dataclasses import replace
from datetime import timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mast_zenoh.mesh.security import control_keys, levels
from mast_zenoh.mesh.security.access import access_control
from mast_zenoh.mesh.security.control_keys import ControlKeys
from mast_zenoh.mesh.security.credentials import LAUNCHER, LIFETIME, ROUTER, VIEWER, Credentials, common_name
from mast_zenoh.wiring.model import Wiring

if TYPE_CHECKING:
    from mast_zenoh.mesh.security.authority import Authority


#: What the names of folders with credentials begin with.
KEYS = "mast-keys-"


class Deployment:
    """Certificates and control keys of a run's processes, and the router's settings.

    level:  one of `levels.LEVELS`; "open" makes nothing
    run, prefix: id of the run, and the prefix of all its keys
    nodes:  names of all nodes; driver: the one that drives the scene
    hosts:  names and addresses of the router
    viewer: whether there are credentials for a viewer
    folder: for the nodes' credentials, a subfolder each; by default a new one that only this user may enter

    Keys of the authority, the router and the launcher stay in memory. `close` deletes the files.
    """

    def __init__(
        self,
        level: str,
        run: str,
        wiring: Wiring,
        nodes: Iterable[str],
        *,
        prefix: str,
        driver: str,
        hosts: Iterable[str],
        viewer: bool = False,
        folder: Path | None = None,
        lifetime: timedelta = LIFETIME,
    ) -> None:
        self.level = levels.check(level)
        self.folder: Path | None = None
        self.authority: Authority | None = None
        self.router: dict[str, Any] = {}
        self.launcher: Credentials | None = None
        self.control: ControlKeys | None = None  # the launcher's
        if level == "open":
            return
        from mast_zenoh.mesh.security.authority import Authority  # slow to load; an open run does not need it

        nodes = list(nodes)
        self.authority = Authority(run, lifetime)
        clients = [*nodes, *([VIEWER] if viewer else [])]
        names = {name: common_name(run, name) for name in (*clients, LAUNCHER)}
        access = access_control(wiring, names, prefix=prefix, driver=driver) if level == "acl" else None
        self.router = levels.router_settings(level, self.authority.issue(ROUTER, hosts), access)
        self.launcher = self._issue(LAUNCHER)
        control = control_keys.make()
        self.control = control[control_keys.LAUNCHER]
        self.folder = folder or Path(tempfile.mkdtemp(prefix=KEYS))
        self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        self.folder.chmod(0o700)
        for name in clients:
            keys = control[control_keys.DRIVER if name == driver else ""]
            replace(self._issue(name), control=keys.to_json()).write(self.folder / name)

    def of(self, name: str) -> Path | None:
        """The folder with a node's credentials; None on an open mesh."""
        return None if self.folder is None else self.folder / name

    def arguments(self, name: str) -> list[str]:
        """Command-line arguments of a node's process: a path, never a secret."""
        folder = self.of(name)
        return [] if folder is None else ["--credentials", str(folder)]

    def close(self) -> None:
        """Delete the nodes' keys."""
        if self.folder is not None:
            shutil.rmtree(self.folder, ignore_errors=True)

    def __enter__(self) -> Deployment:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _issue(self, name: str) -> Credentials:
        assert self.authority is not None
        issued = self.authority.issue(name)
        return issued.without_certificate() if self.level == "tls" else issued
