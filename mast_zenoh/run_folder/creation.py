"""A run folder, or what is exported beside it, begins: room for it, and what it is made with."""

from __future__ import annotations

import os
import platform
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

from mast_zenoh.errors import DiskFull, ExportError, RunFolderError, is_disk_full
from mast_zenoh.run_folder.files import write_json


def check_free(out: Path) -> None:
    """Raise ExportError unless something can be created at a path."""
    if out.exists() or out.is_symlink():
        raise ExportError(f"{out}: exists already: expected a new file or folder")
    if not out.absolute().parent.is_dir():
        raise ExportError(f"{out}: found no folder {str(out.absolute().parent)!r}, expected it to exist")


def write_new(out: Path, write: Callable[[Path], object]) -> tuple[Path, ...]:
    """Write a file or folder through a temporary folder next to it.

    write: gets a path of the same name there; it can write more files beside it, which are kept too

    Returns what is there now, in order of names. Raises ExportError if it cannot be written or something is
    in the way, DiskFull.
    """
    try:
        with tempfile.TemporaryDirectory(prefix=".unfinished-", dir=out.absolute().parent) as temporary:
            write(Path(temporary) / out.name)
            written = sorted(Path(temporary).iterdir())
            targets = tuple(out.with_name(path.name) for path in written)
            for target in targets:
                check_free(target)
            for path, target in zip(written, targets, strict=True):
                os.rename(path, target)
    except OSError as error:
        if is_disk_full(error):
            free = shutil.disk_usage(out.absolute().parent).free >> 20
            raise DiskFull(f"{out}: {error.strerror} ({free} MiB are free): nothing was written") from error
        raise ExportError(f"{out}: cannot be written: {error.strerror or error}") from error
    return targets


#: Reserves room for the final run.json or study.json, so that it can be written on a disk that has become full.
_RESERVE, _RESERVE_BYTES = ".reserve", 1 << 16


def create(out: Path | None, name: str) -> Path:
    """Create an empty run folder: `out`, or runs/<scenario>-<time>.

    Raises RunFolderError if it is not empty or cannot be created, and DiskFull.
    """
    requested = out or Path("runs") / f"{name}-{datetime.now(UTC).strftime('%Y%m%d-%H%M%S')}"
    occupied = RunFolderError(f"{requested}: is not empty; name a new folder with --out, or remove what is there")
    try:
        if out is None:
            out = _unused(requested)
        out.mkdir(parents=True, exist_ok=True)
        if any(out.iterdir()):
            raise occupied
        for part in ("logs", "figures"):
            (out / part).mkdir()
    except OSError as error:
        if out is not None and (out / "logs").is_dir():
            raise occupied from None  # by a run that started at the same moment
        message = f"{requested}: cannot be created as a run folder: {error.strerror or error}"
        raise DiskFull(message) if is_disk_full(error) else RunFolderError(message) from None
    return out.resolve()


@contextmanager
def reserved(folder: Path) -> Iterator[None]:
    """Reserve room for the final run.json; empty the folder again if the block raises.

    Raises DiskFull, with the folder and the free space, if the block fills the disk.
    """
    try:
        reserve(folder)
        yield
    except BaseException as error:
        for path in folder.iterdir():
            shutil.rmtree(path) if path.is_dir() else path.unlink()
        if isinstance(error, OSError) and is_disk_full(error):
            free = shutil.disk_usage(folder).free >> 20
            raise DiskFull(f"{folder}: {error.strerror}: a run cannot begin there ({free} MiB are free)") from error
        raise


def reserve(folder: Path, least: int = _RESERVE_BYTES) -> None:
    """Reserve room for a file of `least` bytes, which `release` gives back."""
    (folder / _RESERVE).write_bytes(os.urandom(max(least, _RESERVE_BYTES)))  # random bytes cannot be compressed


def release(folder: Path) -> None:
    """Give back the room that is reserved in a folder."""
    (folder / _RESERVE).unlink(missing_ok=True)


def finish(folder: Path, record: Mapping[str, Any]) -> None:
    """Write the final run.json, on a full disk in the reserved room."""
    release(folder)
    write_json(folder / "run.json", record)


def _unused(path: Path) -> Path:
    """Create a new folder of this name, with a number if it exists; safe between runs."""
    for candidate in (path, *(path.with_name(f"{path.name}-{i}") for i in range(2, 1000))):
        try:
            candidate.mkdir(parents=True)
        except FileExistsError:
            continue
        return candidate
    raise FileExistsError(f"{path}-2 to {path}-999 all exist")


@cache
def versions() -> dict[str, str]:
    """Versions of Python, platform, kernels and packages."""
    from mast_zenoh import kernels  # NumPy is slow to load

    packages = ("mast-zenoh", "eclipse-zenoh", "numpy", "scipy", "msgpack", "filterpy", "mcap")
    host = {"python": platform.python_version(), "platform": platform.platform(), "kernels": kernels.USED}
    return host | {package: version(package) for package in packages}
