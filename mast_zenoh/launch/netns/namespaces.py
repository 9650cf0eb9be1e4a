"""Network namespaces that belong to one launcher, and what is done inside them. The machine's own is not touched.

A namespace's name says who has made it, so that what a killed launcher has left can be told from what is in use.
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
    """Who makes a set of namespaces: this process, and which of its runs it is."""

    prefix: str

    @classmethod
    def this_process(cls) -> Owner:
        """An owner whose names nobody else has had."""
        pid = os.getpid()
        return cls(f"mast-{pid}-{_started(pid)}-{next(_COUNTER)}-")

    def name(self, which: str) -> str:
        """A name for something that this owner makes."""
        return self.prefix + which

    def folder(self) -> Path:
        """A new folder for sockets: their paths must be short."""
        return Path(tempfile.mkdtemp(prefix=self.prefix))


class Namespace:
    """A network namespace by its name."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.path = NAMESPACES / name

    @classmethod
    def make(cls, name: str) -> Namespace:
        """A new one. Raises CalledProcessError if this machine makes none."""
        _run(["ip", "netns", "add", name])
        made = cls(name)
        made.ip("link", "set", "lo", "up")
        return made

    def command(self) -> list[str]:
        """What to put before a command that is to run inside: it becomes that command, its process id stays."""
        return ["ip", "netns", "exec", self.name]

    def ip(self, *arguments: str) -> None:
        """Run `ip` inside."""
        _run(["ip", "-n", self.name, *arguments])

    def tc(self, arguments: list[str]) -> None:
        """Run `tc` inside."""
        _run(["tc", "-n", self.name, *arguments])

    def nft(self, rules: str) -> None:
        """Have `nft` carry out rules inside, all or none of them."""
        if not shutil.which("nft"):
            raise FileNotFoundError(2, "No such file or directory", "nft")
        _run([*self.command(), "nft", "-f", "-"], rules)

    def remove(self) -> None:
        """Take the name away; what is inside ends with its last process."""
        subprocess.run(["ip", "netns", "del", self.name], capture_output=True, check=False)


def sweep() -> list[str]:
    """Remove what launchers that have gone without an end have left; the names of it."""
    places = [(path.name, path) for place in (NAMESPACES, Path(tempfile.gettempdir())) for path in place.glob("mast-*")]
    left = [(name, path) for name, path in places if (found := _NAME.fullmatch(name)) and not _lives(found)]
    for name, path in left:
        if path.parent == NAMESPACES:
            Namespace(name).remove()
        else:
            shutil.rmtree(path, ignore_errors=True)
    return [name for name, _ in left]


def _lives(found: re.Match[str]) -> bool:
    return _started(int(found["pid"])) == int(found["started"])


def _started(pid: int) -> int:
    """When a process was started, in ticks since the machine was (proc(5), field 22 of stat): an id comes again."""
    try:
        stat = Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return -1
    return int(stat.rpartition(")")[2].split()[19])


def _run(command: list[str], given: str | None = None) -> None:
    subprocess.run(command, input=given, capture_output=True, text=True, check=True)
