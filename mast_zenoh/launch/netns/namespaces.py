"""Network namespaces that belong to one launcher, and commands inside them.

A namespace's name identifies its launcher, so that a killed launcher's namespaces can be removed. The machine's own
namespace is not changed.
"""

from __future__ import annotations

import itertools
import os
import re
import shutil
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path

NAMESPACES = Path("/run/netns")

_NAME = re.compile(r"mast-(?P<pid>\d+)-(?P<started>\d+)-\d+-.*")
_COUNTER = itertools.count()


@dataclass(frozen=True, slots=True)
class Owner:
    """The owner of a set of namespaces: a process and one of its runs."""

    prefix: str

    @classmethod
    def this_process(cls) -> Owner:
        """A new owner with unique names."""
        pid = os.getpid()
        return cls(f"mast-{pid}-{_started(pid)}-{next(_COUNTER)}-")

    def name(self, which: str) -> str:
        """A name for a namespace of this owner."""
        return self.prefix + which

    def folder(self) -> Path:
        """Create a folder for sockets, whose paths must be short."""
        return Path(tempfile.mkdtemp(prefix=self.prefix))


class Namespace:
    """A network namespace by its name."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.path = NAMESPACES / name

    @classmethod
    def make(cls, name: str) -> Namespace:
        """Create a namespace. Raises CalledProcessError if that fails."""
        _run(["ip", "netns", "add", name])
        namespace = cls(name)
        namespace.ip("link", "set", "lo", "up")
        return namespace

    def command(self) -> list[str]:
        """Command prefix that runs a command inside, under the same process id."""
        return ["ip", "netns", "exec", self.name]

    def ip(self, *arguments: str) -> None:
        """Run `ip` inside."""
        _run(["ip", "-n", self.name, *arguments])

    def tc(self, arguments: list[str]) -> None:
        """Run `tc` inside."""
        _run(["tc", "-n", self.name, *arguments])

    def nft(self, rules: str) -> None:
        """Apply rules inside with `nft`, all or none of them."""
        if not shutil.which("nft"):
            raise FileNotFoundError(2, "No such file or directory", "nft")
        _run([*self.command(), "nft", "-f", "-"], rules)

    def remove(self) -> None:
        """Delete the name; the namespace itself ends with its last process."""
        subprocess.run(["ip", "netns", "del", self.name], capture_output=True, check=False)


def sweep() -> list[str]:
    """Remove namespaces and folders of killed launchers; return their names."""
    parents = NAMESPACES, Path(tempfile.gettempdir())
    paths = [(path.name, path) for parent in parents for path in parent.glob("mast-*")]
    stale = [(name, path) for name, path in paths if (match := _NAME.fullmatch(name)) and not _is_alive(match)]
    for name, path in stale:
        if path.parent == NAMESPACES:
            Namespace(name).remove()
        else:
            shutil.rmtree(path, ignore_errors=True)
    return [name for name, _ in stale]


def _is_alive(match: re.Match[str]) -> bool:
    return _started(int(match["pid"])) == int(match["started"])


def _started(pid: int) -> int:
    """Start time of a process in ticks since boot; -1 if there is none.

    Field 22 of stat, see proc(5). It identifies a process, since process ids are reused.
    """
    try:
        stat = Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return -1
    return int(stat.rpartition(")")[2].split()[19])


def _run(command: list[str], stdin: str | None = None) -> None:
    subprocess.run(command, input=stdin, capture_output=True, text=True, check=True)
