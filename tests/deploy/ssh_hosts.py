"""Three hosts as network namespaces with SSH servers, and a launcher."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path

import psutil
import pytest

from mast_zenoh.errors import BackendError
from mast_zenoh.launch.netns import namespaces
from mast_zenoh.launch.netns.namespaces import Namespace, own_prefix

NAMES = ("alpha", "beta", "gamma")
LAUNCHER = "10.78.0.1"
SSHD = "/usr/sbin/sshd"
_PRIVILEGES = Path("/run/sshd")  # sshd needs this empty folder


def require() -> None:
    """Skip without namespaces or an SSH server; fail if MAST_TEST_NETWORK is set."""
    reason = "" if Path(SSHD).exists() else f"{SSHD} is missing: install openssh-server"
    try:
        namespaces.delays_by({"partition": ["this test"]})
    except BackendError as error:
        reason = str(error)
    if reason:
        assert not os.environ.get("MAST_TEST_NETWORK"), reason
        pytest.skip(reason)


class SshHosts:
    """Three hosts; inside: command prefix that runs on the launcher's host.

    folder: holds all files of the hosts; full: a file system with almost no free space
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.full = folder / "full"
        self.address = {name: f"10.78.0.{number}" for number, name in enumerate(NAMES, 2)}
        self.spaces: dict[str, Namespace] = {}
        self.servers: dict[str, subprocess.Popen[bytes]] = {}
        self._stack = ExitStack()

    def __enter__(self) -> SshHosts:
        with ExitStack() as stack:
            if not _PRIVILEGES.exists():
                _PRIVILEGES.mkdir(mode=0o755)
                stack.callback(shutil.rmtree, _PRIVILEGES, ignore_errors=True)
            self.full.mkdir()  # hosts see mounts made before they start
            subprocess.run(["mount", "-t", "tmpfs", "-o", "size=1m", "tmpfs", str(self.full)], check=True)
            stack.callback(subprocess.run, ["umount", str(self.full)], check=True)
            prefix = own_prefix()
            for name in ("launcher", *NAMES):
                self.spaces[name] = Namespace.make(prefix + name)
                stack.callback(self.spaces[name].remove)
            self.inside = self.spaces["launcher"].command()
            self.spaces["launcher"].ip("address", "add", f"{LAUNCHER}/32", "dev", "lo")
            forwarding = ["sh", "-c", "echo 1 > /proc/sys/net/ipv4/ip_forward"]
            subprocess.run([*self.inside, *forwarding], check=True)
            self._key("user")
            for name in NAMES:
                self._link(name)
                self._key(f"{name}_host")
                self.servers[name] = self._serve(name)
                stack.callback(self._end, name)
            self.known_hosts = self.folder / "known_hosts"
            self.known_hosts.write_text("".join(self._known(name, name) for name in NAMES))
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def hosts_toml(self, name: str, text: str = "", **of: str) -> Path:
        """Write a hosts file; text: at its start; of: settings by host."""
        lines = [f'{text}\n[defaults]\nuser = "root"\nkey = "{self.folder}/user"\nknown_hosts = "{self.known_hosts}"']
        lines += [f'python = "{sys.executable}"']
        for host in NAMES:
            more = of.get(host, "")
            own = "" if "folder" in more else f'folder = "{self.home(host)}"'
            lines += [f"[hosts.{host}]", f'address = "{self.address[host]}"', own, more]
        path = self.folder / name
        path.write_text("\n".join(lines) + "\n")
        return path

    def home(self, host: str) -> Path:
        """The folder of a host for files of the package and of runs."""
        return self.folder / f"{host}_home"

    def swap_keys(self, host: str, other: str) -> Path:
        """Write a known_hosts with another host's key for this host."""
        path = self.folder / "swapped"
        path.write_text("".join(self._known(name, other if name == host else name) for name in NAMES))
        return path

    def run(self, *words: str, seconds: float = 60.0) -> subprocess.CompletedProcess[str]:
        """Run a command on the launcher's host."""
        command = [*self.inside, *words]
        return subprocess.run(
            command, capture_output=True, text=True, timeout=seconds, check=False, stdin=subprocess.DEVNULL
        )

    def link(self, host: str, state: str) -> None:
        """Set the link of a host "up" or "down"."""
        self.spaces[host].ip("link", "set", "wire", state)
        if state == "up":
            self._route(host)

    def processes(self, host: str) -> list[psutil.Process]:
        """Processes inside a host, except its SSH server."""
        here = os.stat(self.spaces[host].path).st_ino
        return [p for p in psutil.process_iter(["cmdline"]) if _network(p) == here and p.pid != self.servers[host].pid]

    def drop_connections(self, host: str) -> int:
        """Kill SSH connections, return their number; new connections are accepted."""
        serving = self.servers[host]
        children = psutil.Process(serving.pid).children(recursive=False)
        for child in children:
            child.kill()
        return len(children)

    def _key(self, name: str) -> None:
        command = ["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", str(self.folder / name)]
        subprocess.run(command, check=True, capture_output=True)

    def _known(self, name: str, of: str) -> str:
        kind, key, *_ = (self.folder / f"{of}_host.pub").read_text().split()
        return f"{self.address[name]} {kind} {key}\n"

    def _link(self, name: str) -> None:
        launcher, host = self.spaces["launcher"], self.spaces[name]
        launcher.ip("link", "add", name, "type", "veth", "peer", "name", "wire", "netns", host.name)
        for space, device, own, peer in (
            (launcher, name, LAUNCHER, self.address[name]),
            (host, "wire", self.address[name], LAUNCHER),
        ):
            space.ip("address", "add", own, "peer", peer, "dev", device)
            space.ip("link", "set", device, "up")
        self._route(name)

    def _route(self, name: str) -> None:
        """Connect the hosts through the launcher."""
        self.spaces[name].ip("route", "replace", "default", "via", LAUNCHER, "dev", "wire")

    def _serve(self, name: str) -> subprocess.Popen[bytes]:
        settings = {
            "ListenAddress": self.address[name],
            "HostKey": self.folder / f"{name}_host",
            "AuthorizedKeysFile": self.folder / "user.pub",
            "PidFile": "none",
            "UsePAM": "no",
            "StrictModes": "no",
            "PasswordAuthentication": "no",
            "KbdInteractiveAuthentication": "no",
            "PermitRootLogin": "prohibit-password",
            "Subsystem": "sftp internal-sftp",
        }
        config = self.folder / f"{name}_sshd"
        config.write_text("".join(f"{key} {value}\n" for key, value in settings.items()))
        log = (self.folder / f"{name}_sshd.log").open("wb")
        with log:
            command = [*self.spaces[name].command(), SSHD, "-D", "-e", "-f", str(config)]
            return subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=log, stderr=log, start_new_session=True)

    def _end(self, name: str) -> None:
        for process in self.processes(name):
            process.kill()
        self.servers[name].kill()
        self.servers[name].wait()


def _network(process: psutil.Process) -> int:
    try:
        return os.stat(f"/proc/{process.pid}/ns/net").st_ino if process.status() != psutil.STATUS_ZOMBIE else 0
    except (OSError, psutil.NoSuchProcess):
        return 0
