"""Which mast-zenoh this is: nodes of a run must be of the same, wherever they run."""

from __future__ import annotations

import hashlib
import platform
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from mast_zenoh import __version__, kernels

_PACKAGE = Path(__file__).resolve().parent

#: What no node runs, or what is given to each node with the run.
_OUTSIDE = {"bundled", "study", "report", "launch", "deploy", "checks"}
_OUTSIDE |= {"cli.py", "options.py", "deploying.py", "live_commands.py", "documentation.py", "__main__.py"}


@cache
def fingerprint() -> str:
    """Of the sources that nodes run: twelve hexadecimal digits. Two checkouts of one version may differ."""
    found = hashlib.blake2b(digest_size=6)
    for path in sorted(_PACKAGE.rglob("*.py")):
        name = path.relative_to(_PACKAGE)
        if name.parts[0] not in _OUTSIDE:
            found.update(name.as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    return found.hexdigest()


def named() -> str:
    """Version and sources, for people and to compare."""
    return f"{__version__} (sources {fingerprint()})"


def versions() -> dict[str, str]:
    """What a node runs on: the interpreter and the packages that decide over numbers and messages."""
    found = {"python": platform.python_version(), "mast-zenoh": named(), "kernels": kernels.USED}
    for package in ("eclipse-zenoh", "numpy", "scipy", "msgpack"):
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "not installed"
    return found
