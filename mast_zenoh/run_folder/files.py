"""A run folder: its beginning, its JSON and plain files, read within bounds and written whole, and their types."""

from __future__ import annotations

import json
import math
import os
import platform
import shutil
import stat
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import Any, BinaryIO

from mast_zenoh.errors import DiskFull, ExportError, RunFolderError, is_disk_full
from mast_zenoh.run_folder import finding
from mast_zenoh.wiring import model
from mast_zenoh.wiring.plain_shapes import ANY, NAMED, NUMBER, Name, check_shape

#: Limits of a JSON file. A run of a thousand agents needs a tenth of each; the largest content takes about 150 MB.
MAX_JSON_BYTES = 32 << 20
MAX_DEPTH = 64
MAX_CONTAINERS = 200_000
MAX_ITEMS = 2_000_000


def open_plain(path: Path) -> BinaryIO:
    """Open a plain file; raises RunFolderError for a link, a device, a pipe, a socket or a folder.

    A link may lead anywhere, and reading the others may never end. Raises FileNotFoundError if there is none.
    """
    try:
        file = os.fdopen(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOFOLLOW | os.O_CLOEXEC), "rb")
    except OSError:
        _check_plain(path, path.lstat().st_mode)
        raise
    try:
        _check_plain(path, os.fstat(file.fileno()).st_mode)
    except RunFolderError:
        file.close()
        raise
    return file


def check_plain(path: Path) -> Path:
    """Return the path of a plain file; raises as `open_plain` does. For readers that open files themselves."""
    open_plain(path).close()
    return path


def read_json(path: Path, *, shaped: bool = True) -> Any:
    """The content of a JSON file; that of run.json and of others in `shapes` has the types that they promise.

    shaped: whether these types are checked

    Raises RunFolderError for a file that is missing, is no plain file, is too large, or has another content.
    """
    try:
        content = parse_json(_json_bytes(path))
        if shaped:
            check_file(content, path.name)
    except FileNotFoundError:
        raise RunFolderError(f"{path}: missing; is {path.parent} a run folder?") from None
    except OSError as error:
        raise RunFolderError(f"{path}: cannot be read: {error.strerror or error}") from None
    except ValueError as error:
        raise RunFolderError(f"{path}: cannot be read: {error}") from None
    return content


def read_object(path: Path, *, shaped: bool = True) -> dict[str, Any]:
    """The object in a JSON file; raises RunFolderError as `read_json` does."""
    content = read_json(path, shaped=shaped)
    if not isinstance(content, dict):
        raise RunFolderError(f"{path}: cannot be read: found {type(content).__name__}, expected an object")
    return content


@contextmanager
def reading(folder: Path) -> Iterator[None]:
    """Turn errors that only contents of a run folder explain into RunFolderError.

    `shapes` has what every run has; nodes of users add what they like.
    """
    try:
        yield
    except (TypeError, ValueError, LookupError, AttributeError, ArithmeticError, RecursionError) as error:
        description = " ".join(f"{type(error).__name__}: {error}".split())
        raise RunFolderError(f"{folder}: its contents cannot be used: {description:.300}") from error


def parse_json(content: bytes | str) -> Any:
    """JSON of limited size and depth; raises ValueError for any other."""
    data = content.encode("utf-8", "surrogatepass") if isinstance(content, str) else content
    if len(data) > MAX_JSON_BYTES:
        raise ValueError(f"found {len(data)} bytes of JSON, expected at most {MAX_JSON_BYTES}")
    if data.count(b"[") + data.count(b"{") > MAX_CONTAINERS or data.count(b",") > MAX_ITEMS:
        raise ValueError(f"expected JSON with at most {MAX_CONTAINERS} objects and lists, and {MAX_ITEMS} items")
    try:
        value = json.loads(data)
    except RecursionError:
        value = None
        depth = MAX_DEPTH + 1
    else:
        depth = _depth(value)
    if depth > MAX_DEPTH:
        raise ValueError(f"found JSON that is nested more than {MAX_DEPTH} levels deep")
    if b"\\u" in data:  # a lone surrogate cannot be written anywhere; bytes of paths that are not UTF-8 can
        json.dumps(value, ensure_ascii=False).encode("utf-8", "surrogateescape")
    return value


def _json_bytes(path: Path) -> bytes:
    """The content of a plain file, unless it is too large."""
    with open_plain(path) as file:
        size = os.fstat(file.fileno()).st_size
        if size > MAX_JSON_BYTES:
            raise ValueError(f"found {size} bytes of JSON, expected at most {MAX_JSON_BYTES}")
        return file.read(MAX_JSON_BYTES + 1)


def _check_plain(path: Path, mode: int) -> None:
    """Raise RunFolderError unless a mode is that of a plain file."""
    if not stat.S_ISREG(mode):
        found = "a link" if stat.S_ISLNK(mode) else "a folder" if stat.S_ISDIR(mode) else "a special file"
        raise RunFolderError(f"{path}: found {'a pipe' if stat.S_ISFIFO(mode) else found}, expected a file")


def _depth(value: Any) -> int:
    """How many objects and lists are inside each other, up to one more than MAX_DEPTH."""
    depth, level = 0, [value] if isinstance(value, (dict, list)) else []
    while level and depth <= MAX_DEPTH:
        depth += 1
        level = [
            item
            for each in level
            for item in (each.values() if isinstance(each, dict) else each)
            if isinstance(item, (dict, list))
        ]
    return depth


def subfolder(folder: Path, *names: str) -> Path:
    """A folder inside a run folder, created if needed; raises RunFolderError if one of its parts is a link."""
    for name in names:
        folder = folder / name
        with suppress(FileExistsError):
            folder.mkdir(parents=True)
        if folder.is_symlink() or not folder.is_dir():
            found = "a link" if folder.is_symlink() else "a file"
            raise RunFolderError(f"{folder}: found {found}, expected a folder: remove it")
    return folder


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A new file that takes the place of `path`, whole or not at all, at the end of the block.

    A link there is replaced, and never followed. Raises RunFolderError if a folder is in the way.
    """
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=".new-", suffix=path.suffix)
    os.close(handle)
    try:
        yield Path(name)
        os.chmod(name, 0o644)
        os.replace(name, path)
    except BaseException as error:
        with suppress(FileNotFoundError):
            os.unlink(name)
        if isinstance(error, IsADirectoryError):
            raise RunFolderError(f"{path}: found a folder, expected a file: remove it") from None
        raise


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file of a run folder; see `replacing`."""
    with replacing(path) as new:
        new.write_bytes(content)


def write_json(path: Path, content: Any) -> None:
    """Write a JSON file atomically: a reader sees the old file or the new one."""
    with replacing(path) as new, new.open("w", encoding="utf-8") as file:
        json.dump(content, file, indent=2, allow_nan=False)
        file.write("\n")


def json_or_empty(path: Path) -> dict[str, Any]:
    """Read the object in a JSON file; {} if that fails."""
    try:
        return read_object(path)
    except RunFolderError:
        return {}


def finite(value: Any) -> Any:
    """Plain JSON values: a number that is not finite becomes null, an array a list."""
    if hasattr(value, "dtype"):  # of NumPy, which is slow to load
        plain = value.tolist()
        return [str(item) for item in plain] if value.dtype.kind in "OU" and value.shape else finite(plain)
    if isinstance(value, Mapping):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


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
    """Versions of Python, platform, kernels and packages, and a digest of the sources."""
    from importlib.metadata import version  # slow to load, as is NumPy

    from mast_zenoh import version as release

    others = {package: version(package) for package in ("filterpy", "mcap")}
    return release.versions() | {"platform": platform.platform()} | others


_NODE: dict[str, Any] = {
    **dict.fromkeys(("role", "ended", "log"), str),
    **dict.fromkeys(("last_frame", "restarts", "pid", "exit"), int),
    **{name: {} for name in ("rejected", "first_rejected", "foreign", "invalid_control")},
    "failures": [{}],
    "unaccepted": [str],
}
_REPLAY = {"run": str, "folder": str, "from": str, "played": [str], "live": [str], "changed": {ANY: [str]}}
_LAUNCHER = {"pid": int, "began": str, "machine": str, "boot": str, "pid_namespace": str}
_HOST = {"reach": {}, "nodes": [str], "run_folder": str}

#: By file, the types that readers rely on.
SHAPES: dict[str, Any] = {
    "run.json": {
        **dict.fromkeys(("id", "name", "status", "message", "runtime", "security", "mode", "started"), str),
        **dict.fromkeys(("endpoint", "viewer_credentials", "kernels_not_used", "engine_plugin"), str),
        **dict.fromkeys(("seed", "frames"), int),
        "rate": NUMBER,
        "command": (str, list),
        "launcher": _LAUNCHER,
        "versions": {ANY: str},
        "timings": {},
        "nodes": {NAMED: _NODE},
        "churn": [{"frame": int, "node": str, "what": str}],
        "steps": [{}],
        "recording": {"complete": bool, "from_frame": int},
        "recorded": {"messages": int, "malformed": int, "lost": int, "problem": str, "disk_full": bool},
        "notices": [finding.SHAPE | {"text": str}],
        "innovations": {ANY: {}},
        "replay": _REPLAY,
        "deployment": {"engine": str, "label": str, "stack": str, "hosts": {ANY: _HOST}},
    },
    "scenario.json": {
        "name": Name,
        "mode": str,
        "rate": NUMBER,
        **dict.fromkeys(("seed", "frames", "period_ns", "leeway_ns"), int),
        "scene": {},
        "modules": [str],
        "timeline": [{"label": str, "kind": str, "at_s": NUMBER, "until_s": NUMBER, "nodes": [str]}],
        "network": {},
        "origin": [NUMBER],
        "messages": [{}],
        "steps": [{"frame": int, "action": str, "node": str}],
        "nodes": {NAMED: {"role": str, "file": str, "type": str, "on_exit": str, "config": {}}},
    },
    "wiring.json": model.SHAPE,
    "metrics.json": {
        "agents": {ANY: {ANY: {}}},
        "same_as": {ANY: {ANY: str}},
        "scored_frames": [int],
        **{name: {ANY: {}} for name in ("latency_ms", "interposers", "achieved")},
        "messages": {ANY: {ANY: {"mean": NUMBER, "std": NUMBER}}},
        "own_metrics": {
            ANY: {"per": str, "heading": str, "unit": str, "digits": int, "whole": bool, "range": [NUMBER]}
        },
    },
    "study.json": {"name": str},
}


def check_file(content: Any, name: str) -> None:
    """Raise ValueError, with the place, unless the content of a file has the types that readers rely on."""
    if name in SHAPES:
        check_shape(content, SHAPES[name])
    for index, notice in enumerate(content.get("notices") or () if name == "run.json" else ()):
        finding.check(notice or {}, f"notices[{index}]")
        if not isinstance(notice.get("text"), str):
            raise ValueError(f"notices[{index}].text: found {notice.get('text')!r:.60}, expected a string")
