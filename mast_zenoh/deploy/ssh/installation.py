"""What nodes need, on a host: an environment of other packages, made once for each set of versions, and our own wheel.

    FOLDER/environments/KEY/      a virtual environment with the wheels of third parties
    FOLDER/releases/KEY/          this package, as it is here
    FOLDER/runs/RUN/HOST/         a run's supervisor, while it lasts

The wheels come from here: a host needs no index, no pip and no compiler, and all have the versions that we have.
"""

from __future__ import annotations

import hashlib
import secrets
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mast_zenoh import version as release
from mast_zenoh.deploy import wheel
from mast_zenoh.deploy.ssh import connection
from mast_zenoh.deploy.ssh.hostsfile import Host
from mast_zenoh.errors import DiskFull, EngineError, VersionMismatch

if TYPE_CHECKING:
    import asyncssh

#: What an environment takes (250 MB were measured), a release, and what a run writes.
_NEEDED_BYTES = {"environment": 400 << 20, "release": 16 << 20, "run": 64 << 20}

_OLDEST = (3, 11)


@dataclass(frozen=True)
class Installed:
    """Where things are on a host: absolute paths there; python: of the environment."""

    folder: str
    python: str
    release: str


class Cargo:
    """What is brought: our own wheel, built into a folder, and the names of all others."""

    def __init__(self, folder: Path) -> None:
        self.version = release.version_string()  # of the very sources that are packed
        self.wheel = wheel.build(folder)
        self.release = hashlib.sha256(self.wheel.read_bytes()).hexdigest()[:12]
        self._requirements = wheel.requirements()

    def environment(self, python: str, machine: str) -> str:
        """The name of the environment for a host of this interpreter and processor."""
        digest = hashlib.sha256("\n".join(self._requirements).encode()).hexdigest()[:12]
        return f"{python}-{machine}-{digest}"


async def probe(ssh: asyncssh.SSHClientConnection, host: Host, cargo: Cargo) -> dict[str, Any]:
    """What the host is and has; raises EngineError, DiskFull or VersionMismatch for one that cannot take nodes."""
    said = await connection.run(ssh, host, [host.python, "-c", _WHICH])
    python, machine = said.split()
    if tuple(map(int, python.split("."))) < _OLDEST:
        wanted = ".".join(map(str, _OLDEST))
        raise EngineError(f"{host.called}: {host.python} is Python {python}, expected {wanted} or newer (python)")
    environment = cargo.environment(python, machine)
    found = await connection.ask(ssh, host, "probe", host.folder, environment, cargo.release)
    if found["system"] != "Linux":
        raise EngineError(f"{host.called}: runs {found['system']}, expected Linux")
    if found["refused"]:
        raise EngineError(f"{host.called}: {found['folder']}: {found['refused']} (folder)")
    lacks = [kind for kind in ("environment", "release") if not found[kind]]
    needed = sum(_NEEDED_BYTES[kind] for kind in (*lacks, "run"))
    if found["free"] < needed:
        raise DiskFull(f"{host.called}: {found['folder']} has {_mib(found['free'])} free, needs {_mib(needed)}")
    if not lacks:
        _compare(host, cargo, found["version"], found["folder"])
    return {**found, "python": python, "key": environment, "lacks": lacks}


async def install(ssh: asyncssh.SSHClientConnection, host: Host, cargo: Cargo) -> Installed:
    """All that nodes need, if it is not there yet; raises what `probe` raises."""
    found = await probe(ssh, host, cargo)
    base = found["folder"]
    environment = f"{base}/environments/{found['key']}"
    target = f"{base}/releases/{cargo.release}"
    if "environment" in found["lacks"]:
        wheels = wheel.third_party(
            wheel.cache(found["python"], found["machine"]), python=found["python"], machine=found["machine"]
        )
        await _bring(ssh, host, wheels, environment, venv=True)
    if "release" in found["lacks"]:
        await _bring(ssh, host, [cargo.wheel], target, venv=False)
    if found["lacks"]:
        said = await connection.ask(ssh, host, "verify", environment, target)
        _compare(host, cargo, said["version"], base)
    return Installed(base, f"{environment}/bin/python", target)


async def _bring(ssh: asyncssh.SSHClientConnection, host: Host, wheels: list[Path], target: str, *, venv: bool) -> None:
    import asyncssh

    new = f"{target}.{secrets.token_hex(4)}"
    try:
        async with ssh.start_sftp_client() as sftp:
            await connection.make_folder(sftp, new)  # or its wheels could be exchanged
            await sftp.put([str(each) for each in wheels], new)
        await connection.ask(ssh, host, "unpack", new, target, "1" if venv else "0")
    except (asyncssh.Error, OSError) as error:
        await connection.run(ssh, host, ["rm", "-rf", new])
        raise EngineError(f"{host.called}: {target}: {error}") from None


def _compare(host: Host, cargo: Cargo, theirs: str, folder: str) -> None:
    if theirs != cargo.version:
        raise VersionMismatch(
            f"{host.called}: its copy is mast-zenoh {theirs}, the launcher {cargo.version}: remove {folder} there"
        )


def _mib(count: int) -> str:
    return f"{count >> 20} MiB"


_WHICH = "import platform, sys; print('%d.%d' % sys.version_info[:2], platform.machine())"
