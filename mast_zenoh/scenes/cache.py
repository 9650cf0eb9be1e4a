"""Prepared scenes on disk: a scene is made once per (configuration, seed, frames, code, data) and replayed."""

from __future__ import annotations

import contextlib
import hashlib
import os
import sys
import tempfile
from functools import cache
from pathlib import Path

from mast_zenoh import sensing, streams
from mast_zenoh.arrays import geometry, states
from mast_zenoh.errors import SceneError
from mast_zenoh.scenes.base import Scene
from mast_zenoh.scenes.recording import Recording
from mast_zenoh.version import __version__

#: Bytes that the cache may hold; what was used longest ago goes first.
LIMIT = 2_000_000_000


def prepare(scene: Scene, seed: int, frames: int | None, cache_key: str | None) -> Recording:
    """The recording of a scene, from the disk cache if it is there, else made and put there.

    cache_key: the scene's configuration as text, the same for equal scenes; None: do not cache.
    A scene of which a notebook defines a part is not cached either: nothing says whether its code has changed.

    The cache lies in $XDG_CACHE_HOME/mast-zenoh/scenes (or ~/.cache/...). Files appear whole or not at all, so two
    processes may prepare one scene at the same time; a broken or missing file means that the scene is made again.
    A cache that cannot be written is no error. Raises what `Scene.record` raises.
    """
    if cache_key is None or _of_session(scene):
        return scene.record(seed, frames)
    path = cache_folder() / f"{_digest(scene, seed, frames, cache_key)}.npz"
    try:
        recording = Recording.load(path)
        with contextlib.suppress(OSError):
            os.utime(path)
        return recording
    except SceneError:
        recording = scene.record(seed, frames)
    with contextlib.suppress(OSError):
        _store(recording, path)
    return recording


def cache_folder() -> Path:
    """Where prepared scenes lie."""
    base = os.environ.get("XDG_CACHE_HOME", "")
    # The XDG specification has relative paths ignored.
    root = Path(base) if base and Path(base).is_absolute() else Path.home() / ".cache"
    return root / "mast-zenoh" / "scenes"


def _store(recording: Recording, path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(dir=path.parent, suffix=".tmp")
    os.close(handle)
    try:
        recording.save(Path(name))
        os.replace(name, path)
    finally:
        Path(name).unlink(missing_ok=True)
    _prune(path.parent)


def _prune(folder: Path) -> None:
    entries = []
    for path in folder.iterdir():
        with contextlib.suppress(OSError):  # another process may have removed it just now
            stat = path.stat()
            entries.append((stat.st_mtime_ns, stat.st_size, path))
    held = sum(size for _, size, _ in entries)
    for _, size, path in sorted(entries):
        if held <= LIMIT:
            return
        path.unlink(missing_ok=True)
        held -= size


def _digest(scene: Scene, seed: int, frames: int | None, cache_key: str) -> str:
    digest = hashlib.blake2b(digest_size=20)
    for part in (__version__, _code(), _own_code(scene), cache_key, str(seed), str(frames)):
        digest.update(part.encode() + b"\0")
    for path in scene.inputs():
        for line in _identity(path):
            digest.update(line.encode(errors="surrogateescape") + b"\0")
    return digest.hexdigest()


def _identity(path: Path) -> list[str]:
    """Path, size and time of change of a file, or of everything below a folder."""
    found = [str(path.absolute())]
    if path.is_file():
        return [*found, _line(path, path.stat())]
    # Every run of a scene comes by here, and a data set has thousands of files: no Path is made of any.
    folders = [str(path)]
    while folders:
        with contextlib.suppress(OSError), os.scandir(folders.pop()) as entries:
            for entry in entries:
                with contextlib.suppress(OSError):
                    found.append(_line(entry.path, entry.stat()))
                if entry.is_dir(follow_symlinks=False):
                    folders.append(entry.path)
    return sorted(found)


def _line(path: Path | str, stat: os.stat_result) -> str:
    return f"{path} {stat.st_size} {stat.st_mtime_ns}"


@cache
def _code() -> str:
    """A hash of the code that makes scenes: a change of it makes every prepared scene stale."""
    files = [Path(module.__file__ or "") for module in (geometry, states, streams)]
    for file in (__file__, sensing.__file__):
        files += Path(file or "").parent.glob("*.py")
    return _hash_of(files)


def _of_session(scene: Scene) -> bool:
    """Whether a class of the scene or of its parts has no file: it is defined in a notebook or at a prompt."""
    parts = [scene, *vars(scene).values()]
    file = getattr(sys.modules["__main__"], "__file__", None)  # <stdin>, where a session reads its code from there
    return not (file and Path(file).is_file()) and any(type(part).__module__ == "__main__" for part in parts)


def _own_code(scene: Scene) -> str:
    """A hash of the modules that the scene and its parts, a detector say, are written in: they may be a user's own."""
    modules = {type(part).__module__ for part in (scene, *vars(scene).values())}
    names = [getattr(sys.modules.get(module), "__file__", None) for module in sorted(modules)]
    return _hash_of([Path(name) for name in names if name])


def _hash_of(files: list[Path]) -> str:
    return hashlib.blake2b(b"\0".join(file.read_bytes() for file in sorted(files)), digest_size=20).hexdigest()
