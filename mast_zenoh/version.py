"""Which mast-zenoh this is: nodes of a run must be of the same, wherever they run."""

from __future__ import annotations

import hashlib
import platform
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from mast_zenoh import kernels
from mast_zenoh.layers import run_by_nodes

__version__ = "0.1.0"

_PACKAGE = Path(__file__).resolve().parent

#: Sources, compiled or not.
_SUFFIXES = (".py", ".pyx", ".pxd")


@cache
def fingerprint() -> str:
    """A digest of the sources that decide what nodes do: twelve hexadecimal digits."""
    digest = hashlib.blake2b(digest_size=6)
    for path in sorted(path for path in _PACKAGE.rglob("*") if path.suffix in _SUFFIXES):
        name = path.relative_to(_PACKAGE)
        if name.parts[0].removesuffix(".py") in run_by_nodes():
            digest.update(name.as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()


def version_string() -> str:
    """Version and sources, for people and to compare."""
    return f"{__version__} (sources {fingerprint()})"


def versions() -> dict[str, str]:
    """What a node runs on: the interpreter and the packages that decide over numbers and messages."""
    found = {"python": platform.python_version(), "mast-zenoh": version_string(), "kernels": kernels.USED}
    for package in ("eclipse-zenoh", "numpy", "scipy", "msgpack"):
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "not installed"
    return found
