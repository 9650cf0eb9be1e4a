"""What the outcome of a trial depends on, as a digest: a trial with the same one need not be run again."""

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

#: Packages whose versions decide over the numbers.
_PACKAGES = ("mast-zenoh", "numpy", "scipy", "filterpy", "msgpack")


@cache
def environment() -> dict[str, str]:
    """Python, the packages that decide over the numbers, the kernels, and hashes of this package's code and files."""
    found = {"python": platform.python_version(), "kernels": kernels.USED} | {name: version(name) for name in _PACKAGES}
    folders = [bundle.ROOT / kind for kind in ("nodes", "keyexpr_maps", "scenarios")]
    files = sorted(path for folder in folders for path in folder.iterdir() if path.suffix in (".py", ".toml"))
    return found | {"code": fingerprint(), "files": _hash(path.read_bytes() for path in files)}


def scene_key(scene: scenes.Scene) -> str:
    """The same for scenes that make the same recording, whether defaults are spelt out or not; without the seed."""
    told = json.dumps([type(scene).__qualname__, vars(scene)], sort_keys=True, default=repr)
    return re.sub(r" at 0x[0-9a-f]+", "", told)  # two objects of one kind are told apart by what can be seen of them


@cache
def files_key(paths: tuple[Path, ...]) -> str:
    """Of files, or of all files below folders: their names, sizes and times of change."""
    lines = []
    for path in paths:
        for file in [path] if path.is_file() else sorted(path.rglob("*")):
            stat = file.stat()
            lines.append(f"{file.relative_to(path.parent)} {stat.st_size} {stat.st_mtime_ns}".encode())
    return _hash(lines)


def input_files(scene: scenes.Scene) -> tuple[Path, ...]:
    """What a scene reads."""
    return tuple(scene.inputs())


def user_files(path: Path, loaded: Mapping[str, Any]) -> tuple[Path, ...]:
    """The Python files of the user that a scenario may be made of: its own folder's, unless they are ours."""
    if path.parent == bundle.ROOT / "scenarios":
        return ()
    return tuple(sorted(path.parent.glob("*.py")))


def digest(loaded: Mapping[str, Any], files: str, seed: int, frames: int | None, runtime: str) -> str:
    """Of a scenario's content, its files, and how it is run; 40 hexadecimal digits."""
    parts = {
        "scenario": loaded,
        "files": files,
        "seed": seed,
        "frames": frames,
        "runtime": runtime,
        "environment": environment(),
    }
    return _hash([json.dumps(parts, sort_keys=True, default=repr).encode()])


def _hash(parts: Iterable[bytes]) -> str:
    found = hashlib.blake2b(digest_size=20)
    for part in parts:
        found.update(len(part).to_bytes(8, "little") + part)
    return found.hexdigest()
