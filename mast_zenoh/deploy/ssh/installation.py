"""Installs packages on a host: this one, and others once per set of versions.

    FOLDER/environments/KEY/      a virtual environment with the wheels of third parties
    FOLDER/releases/KEY/          this package, as it is here
    FOLDER/runs/RUN/HOST/         a run's supervisor, while it lasts

The launcher sends the wheels: a host needs no index, no pip and no compiler, and all hosts have the same versions.
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

#: Disk space for an environment (250 MB were measured), a release, and the files of a run.
_NEEDED_BYTES = {"environment": 400 << 20, "release": 16 << 20, "run": 64 << 20}

_OLDEST = (3, 11)


@dataclass(frozen=True)
class Installed:
    """Absolute paths on a host; python: the environment's."""

    folder: str
    python: str
    release: str


class Packages:
    """The packages to install: our wheel, built into a folder, and the others' names."""

    def __init__(self, folder: Path) -> None:
        self.version = release.version_string()  # of the sources in the wheel
        self.wheel = wheel.build(folder)
        self.release = hashlib.sha256(self.wheel.read_bytes()).hexdigest()[:12]
        self._requirements = wheel.requirements()

    def environment(self, python: str, machine: str) -> str:
        """The name of the environment for a host of this interpreter and processor."""
        digest = hashlib.sha256("\n".join(self._requirements).encode()).hexdigest()[:12]
        return f"{python}-{machine}-{digest}"


async def probe(ssh: asyncssh.SSHClientConnection, host: Host, packages: Packages) -> dict[str, Any]:
    """Properties and installed packages of a host.

    Raises EngineError, DiskFull or VersionMismatch if it is unsuitable.
    """
    output = await connection.run(ssh, host, [host.python, "-c", _PRINT_PLATFORM])
    python, machine = output.split()
    if tuple(map(int, python.split("."))) < _OLDEST:
        oldest = ".".join(map(str, _OLDEST))
        raise EngineError(f"{host.called}: {host.python} is Python {python}, expected {oldest} or newer (python)")
    environment = packages.environment(python, machine)
    facts = await connection.ask(ssh, host, "probe", host.folder, environment, packages.release)
    if facts["system"] != "Linux":
        raise EngineError(f"{host.called}: runs {facts['system']}, expected Linux")
    if facts["refused"]:
        raise EngineError(f"{host.called}: {facts['folder']}: {facts['refused']} (folder)")
    missing = [kind for kind in ("environment", "release") if not facts[kind]]
    needed = sum(_NEEDED_BYTES[kind] for kind in (*missing, "run"))
    if facts["free"] < needed:
        raise DiskFull(f"{host.called}: {facts['folder']} has {_mib(facts['free'])} free, needs {_mib(needed)}")
    if not missing:
        _compare(host, packages, facts["version"], facts["folder"])
    return {**facts, "python": python, "key": environment, "lacks": missing}


async def install(ssh: asyncssh.SSHClientConnection, host: Host, packages: Packages) -> Installed:
    """Install missing packages; raises what `probe` raises."""
    facts = await probe(ssh, host, packages)
    folder = facts["folder"]
    environment = f"{folder}/environments/{facts['key']}"
    target = f"{folder}/releases/{packages.release}"
    if "environment" in facts["lacks"]:
        wheels = wheel.third_party(
            wheel.cache(facts["python"], facts["machine"]), python=facts["python"], machine=facts["machine"]
        )
        await _copy_and_unpack(ssh, host, wheels, environment, venv=True)
    if "release" in facts["lacks"]:
        await _copy_and_unpack(ssh, host, [packages.wheel], target, venv=False)
    if facts["lacks"]:
        answer = await connection.ask(ssh, host, "verify", environment, target)
        _compare(host, packages, answer["version"], folder)
    return Installed(folder, f"{environment}/bin/python", target)


async def _copy_and_unpack(
    ssh: asyncssh.SSHClientConnection, host: Host, wheels: list[Path], target: str, *, venv: bool
) -> None:
    import asyncssh

    new = f"{target}.{secrets.token_hex(4)}"
    try:
        async with ssh.start_sftp_client() as sftp:
            await connection.make_folder(sftp, new)  # otherwise its wheels could be replaced
            await sftp.put([str(path) for path in wheels], new)
        await connection.ask(ssh, host, "unpack", new, target, "1" if venv else "0")
    except (asyncssh.Error, OSError) as error:
        await connection.run(ssh, host, ["rm", "-rf", new])
        raise EngineError(f"{host.called}: {target}: {error}") from None


def _compare(host: Host, packages: Packages, remote: str, folder: str) -> None:
    if remote != packages.version:
        raise VersionMismatch(
            f"{host.called}: its copy is mast-zenoh {remote}, the launcher {packages.version}: remove {folder} there"
        )


def _mib(count: int) -> str:
    return f"{count >> 20} MiB"


_PRINT_PLATFORM = "import platform, sys; print('%d.%d' % sys.version_info[:2], platform.machine())"
