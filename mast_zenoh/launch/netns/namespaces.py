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
from pathlib import Path

from mast_zenoh.launch.process_stat import began

NAMESPACES = Path("/run/netns")

_NAME = re.compile(r"mast-(?P<pid>\d+)-(?P<started>\d+)-\d+-.*")
_COUNTER = itertools.count()


def own_prefix() -> str:
    """Begins the names of a set of namespaces of this process; a new one at each call."""
    pid = os.getpid()
    return f"mast-{pid}-{began(pid)}-{next(_COUNTER)}-"


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
    paths = [path for parent in parents for path in parent.glob("mast-*")]
    owned = [(path, match) for path in paths if (match := _NAME.fullmatch(path.name))]
    stale = [path for path, match in owned if began(int(match["pid"])) != match["started"]]
    for path in stale:
        if path.parent == NAMESPACES:
            Namespace(path.name).remove()
        else:
            shutil.rmtree(path, ignore_errors=True)
    return [path.name for path in stale]


def _run(command: list[str], stdin: str | None = None) -> None:
    subprocess.run(command, input=stdin, capture_output=True, text=True, check=True)
