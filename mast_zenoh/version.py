"""The version of mast-zenoh; all nodes of a run must have the same one."""

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
def fingerprint(package: Path = _PACKAGE) -> str:
    """A digest of the sources that determine what nodes do: 12 hexadecimal digits."""
    digest = hashlib.blake2b(digest_size=6)
    for path in sorted(path for path in package.rglob("*") if path.suffix in _SUFFIXES):
        name = path.relative_to(package)
        if name.parts[0].removesuffix(".py") in run_by_nodes():
            digest.update(name.as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()


def version_string() -> str:
    """Version number and fingerprint, to show and to compare."""
    return f"{__version__} (sources {fingerprint()})"


def versions() -> dict[str, str]:
    """Versions of Python and of the packages that affect numbers and messages."""
    result = {"python": platform.python_version(), "mast-zenoh": version_string(), "kernels": kernels.USED}
    for package in ("eclipse-zenoh", "numpy", "scipy", "msgpack"):
        try:
            result[package] = version(package)
        except PackageNotFoundError:
            result[package] = "not installed"
    return result
