"""Disk cache of prepared scenes.

One file per (configuration, seed, frames, code, data).
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from pathlib import Path

from mast_zenoh import sensing, streams
from mast_zenoh.arrays import geometry, states
from mast_zenoh.errors import MastError, SceneError, is_out_of_resources, place_of
from mast_zenoh.scenes.base import Scene
from mast_zenoh.scenes.making.observe import with_sweeps
from mast_zenoh.scenes.recording import Recording
from mast_zenoh.version import __version__

#: Maximum size of the cache, bytes; the least recently used files are removed first.
LIMIT = 2_000_000_000


def prepare(scene: Scene, seed: int, frames: int | None, cache_key: str | None) -> Recording:
    """The recording of a scene, from the disk cache or else recorded and cached.

    cache_key: the scene's configuration as text, the same for equal scenes; None: do not cache
    Scenes with parts defined in a notebook are not cached, because changes of their code cannot be detected.

    The cache is in $XDG_CACHE_HOME/mast-zenoh/scenes (or ~/.cache/...). Files are written atomically, so two processes
    may prepare the same scene at the same time. If a file is broken or missing, the scene is recorded again. A cache
    that cannot be written is not an error. Raises what `Scene.record` raises; SceneError, with file and line, for
    exceptions of a user's scene or its parts.
    """
    return _cached(scene, seed, frames, cache_key, "", lambda: _recorded(scene, seed, frames))


def prepare_sweeps(
    recording: Recording, scene: Scene, seed: int, frames: int | None, cache_key: str | None
) -> Recording:
    """A prepared recording with the free space around every sensor, see `with_sweeps`; cached, too.

    The other parameters are those with which it was prepared.
    """
    return _cached(scene, seed, frames, cache_key, ".sweeps", lambda: with_sweeps(recording))


def _recorded(scene: Scene, seed: int, frames: int | None) -> Recording:
    """The recording of a scene; raises SceneError, with file and line, where code of a user raises anything else."""
    try:
        recording = scene.record(seed, frames)
        if not isinstance(recording, Recording):
            found = f"{type(scene).__name__}.record: found a {type(recording).__name__}"
            raise SceneError(f"{found}, expected a Recording, such as another scene's `record` returns")
        return recording
    except Exception as error:
        users = {type(part).__module__ for part in _parts(scene) if _is_of_user(type(part))}
        place = place_of(error, users)
        if isinstance(error, MastError) or is_out_of_resources(error) or not place:
            raise
        raise SceneError(f"{place}: {type(error).__name__}: {error}") from error


def _is_of_user(cls: type) -> bool:
    """Whether a class outside of this package derives from one of it."""
    home, *bases = (each.__module__.startswith("mast_zenoh.") for each in cls.__mro__)
    return any(bases) and not home


def _cached(
    scene: Scene, seed: int, frames: int | None, cache_key: str | None, kind: str, make: Callable[[], Recording]
) -> Recording:
    """The recording of a kind, from the cache or else made and cached."""
    if cache_key is None or _defined_in_session(scene):
        return make()
    path = cache_folder() / f"{_digest(scene, seed, frames, cache_key)}{kind}.npz"
    try:
        recording = Recording.load(path)
        with contextlib.suppress(OSError):
            os.utime(path)
        return recording
    except SceneError:
        pass  # recorded outside of the handler, so that errors of the scene do not begin with this one
    recording = make()
    with contextlib.suppress(OSError):
        _store(recording, path)
    return recording


def cache_folder() -> Path:
    """The folder of the prepared scenes."""
    base = os.environ.get("XDG_CACHE_HOME", "")
    # The XDG specification says to ignore relative paths.
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
    total = sum(size for _, size, _ in entries)
    for _, size, path in sorted(entries):
        if total <= LIMIT:
            return
        path.unlink(missing_ok=True)
        total -= size


def _digest(scene: Scene, seed: int, frames: int | None, cache_key: str) -> str:
    digest = hashlib.blake2b(digest_size=20)
    for part in (__version__, _code(), _own_code(scene), cache_key, str(seed), str(frames)):
        digest.update(part.encode() + b"\0")
    for path in scene.inputs():
        for line in _identity(path):
            digest.update(line.encode(errors="surrogateescape") + b"\0")
    return digest.hexdigest()


def _identity(path: Path) -> list[str]:
    """Path, size and modification time of a file, or of everything below a folder."""
    lines = [str(path.absolute())]
    if path.is_file():
        return [*lines, _line(path, path.stat())]
    # Called in every run, and a data set has thousands of files: creating Path objects would be slow.
    folders = [str(path)]
    while folders:
        with contextlib.suppress(OSError), os.scandir(folders.pop()) as entries:
            for entry in entries:
                with contextlib.suppress(OSError):
                    lines.append(_line(entry.path, entry.stat()))
                if entry.is_dir(follow_symlinks=False):
                    folders.append(entry.path)
    return sorted(lines)


def _line(path: Path | str, stat: os.stat_result) -> str:
    return f"{path} {stat.st_size} {stat.st_mtime_ns}"


@cache
def _code() -> str:
    """Hash of the code that prepares scenes; a change invalidates all of them."""
    files = [Path(module.__file__ or "") for module in (geometry, states, streams)]
    for file in (__file__, sensing.__file__):
        files += Path(file or "").parent.rglob("*.py")
    return _hash_of(files)


def _defined_in_session(scene: Scene) -> bool:
    """Whether a class of the scene or its parts is defined in a notebook or a prompt."""
    parts = list(_parts(scene))
    file = getattr(sys.modules["__main__"], "__file__", None)  # <stdin> if the code is read from there
    return not (file and Path(file).is_file()) and any(type(part).__module__ == "__main__" for part in parts)


def _parts(scene: Scene) -> Iterator[object]:
    """A scene, and all objects that it consists of: detectors, sensors of agents and their detectors."""
    waiting: list[object] = [scene]
    known: set[int] = set()
    while waiting:
        part = waiting.pop()
        if id(part) in known:
            continue
        known.add(id(part))
        yield part
        if isinstance(part, Mapping):
            waiting += part.values()
        elif isinstance(part, (list, tuple)):
            waiting += part
        elif hasattr(part, "__dict__"):
            waiting += vars(part).values()


def _own_code(scene: Scene) -> str:
    """Hash of the modules that define the scene and its parts.

    They may be user code, such as a detector.
    """
    modules = {type(part).__module__ for part in _parts(scene)}
    names = [getattr(sys.modules.get(module), "__file__", None) for module in sorted(modules)]
    return _hash_of([Path(name) for name in names if name])


def _hash_of(files: list[Path]) -> str:
    return hashlib.blake2b(b"\0".join(file.read_bytes() for file in sorted(files)), digest_size=20).hexdigest()
