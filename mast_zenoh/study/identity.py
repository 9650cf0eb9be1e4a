"""Digests of a trial's inputs: trials with equal digests have equal outcomes."""

from __future__ import annotations

import hashlib
import json
import platform
import re
from collections.abc import Iterable, Mapping
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

from mast_zenoh import kernels, scenes
from mast_zenoh.config import bundle
from mast_zenoh.version import fingerprint

#: Packages whose versions affect the results.
_PACKAGES = ("mast-zenoh", "numpy", "scipy", "filterpy", "msgpack")


@cache
def environment() -> dict[str, str]:
    """Versions of Python, kernels and packages, and hashes of our code and files."""
    versions = {"python": platform.python_version(), "kernels": kernels.USED} | {
        name: version(name) for name in _PACKAGES
    }
    folders = [bundle.ROOT / kind for kind in ("nodes", "keyexpr_maps", "scenarios")]
    files = sorted(path for folder in folders for path in folder.iterdir() if path.suffix in (".py", ".toml"))
    return versions | {"code": fingerprint(), "files": _hash(path.read_bytes() for path in files)}


def scene_key(scene: scenes.Scene) -> str:
    """A key that is equal for scenes with equal recordings; ignores the seed."""
    description = json.dumps([type(scene).__qualname__, vars(scene)], sort_keys=True, default=repr)
    return re.sub(r" at 0x[0-9a-f]+", "", description)  # addresses differ between equal objects


@cache
def files_key(paths: tuple[Path, ...]) -> str:
    """A hash of files or folders: names, sizes and modification times of all files."""
    lines = []
    for path in paths:
        for file in [path] if path.is_file() else sorted(path.rglob("*")):
            stat = file.stat()
            lines.append(f"{file.relative_to(path.parent)} {stat.st_size} {stat.st_mtime_ns}".encode())
    return _hash(lines)


def input_files(scene: scenes.Scene) -> tuple[Path, ...]:
    """The files that a scene reads."""
    return tuple(scene.inputs())


def user_files(path: Path, loaded: Mapping[str, Any], modules: Iterable[str] = ()) -> tuple[Path, ...]:
    """Python files in a user's scenario folder, which the scenario may import, and in those of its classes.

    modules: files of classes that the scenario uses
    """
    folders = {path.parent, *(Path(file).parent for file in modules)} - {bundle.ROOT / "scenarios"}
    return tuple(file for folder in sorted(folders) for file in sorted(folder.glob("*.py")))


def digest(
    loaded: Mapping[str, Any], files: str, seed: int, frames: int | None, runtime: str, *, evaluation: str = ""
) -> str:
    """Digest of a scenario's content, files and run options; 40 hexadecimal digits.

    evaluation: kind of study of defences for which the trial is evaluated (`defences.kinds`); "": none
    """
    parts = {
        "scenario": loaded,
        "files": files,
        "seed": seed,
        "frames": frames,
        "runtime": runtime,
        "environment": environment(),
        **({"evaluation": evaluation} if evaluation else {}),
    }
    return _hash([json.dumps(parts, sort_keys=True, default=repr).encode()])


def _hash(parts: Iterable[bytes]) -> str:
    hasher = hashlib.blake2b(digest_size=20)
    for part in parts:
        hasher.update(len(part).to_bytes(8, "little") + part)
    return hasher.hexdigest()
