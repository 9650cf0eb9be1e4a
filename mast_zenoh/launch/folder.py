"""The run folder: creates it, and writes and reads its files."""

from __future__ import annotations

import json
import math
import os
import platform
import re
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import version
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from mast_zenoh import kernels
from mast_zenoh.config.resolved import NodeSpec, driver_of
from mast_zenoh.control.results import EVALUATOR, TABLES, counts_of
from mast_zenoh.errors import DiskFull, RunFolderError, is_disk_full
from mast_zenoh.messagelog import churn, script
from mast_zenoh.messagelog.completeness import first_incomplete_frame, first_missing_frame
from mast_zenoh.run_files import read_object, replacing, subfolder

#: Reserves room for the final run.json, so a run that filled the disk can still write it.
_RESERVE, _RESERVE_BYTES = ".reserve", 1 << 16

_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,63}")
_MAX_PROBLEM_CHARS = 300  # of a problem as a node describes it
MAX_TABLES = 100  #: that one node may write
MAX_COLUMNS = 1000  #: of one table
_EXPECTED_NAME = "expected a name of at most 64 letters, digits, dots, hyphens and underscores that begins with no dot"


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
        (folder / _RESERVE).write_bytes(os.urandom(_RESERVE_BYTES))  # random bytes cannot be compressed
        yield
    except BaseException as error:
        for path in folder.iterdir():
            shutil.rmtree(path) if path.is_dir() else path.unlink()
        if isinstance(error, OSError) and is_disk_full(error):
            free = shutil.disk_usage(folder).free >> 20
            raise DiskFull(f"{folder}: {error.strerror}: a run cannot begin there ({free} MiB are free)") from error
        raise


def finish(folder: Path, record: Mapping[str, Any]) -> None:
    """Write the final run.json, on a full disk in the reserved room."""
    (folder / _RESERVE).unlink(missing_ok=True)
    write_json(folder / "run.json", record)


def discard_scripts(folder: Path) -> None:
    """Remove what the played nodes of a replay have sent: it is in both recordings."""
    shutil.rmtree(folder / script.FOLDER, ignore_errors=True)


def _unused(path: Path) -> Path:
    """Create a new folder of this name, with a number if it exists; safe between runs."""
    for candidate in (path, *(path.with_name(f"{path.name}-{i}") for i in range(2, 1000))):
        try:
            candidate.mkdir(parents=True)
        except FileExistsError:
            continue
        return candidate
    raise FileExistsError(f"{path}-2 to {path}-999 all exist")


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


def versions() -> dict[str, str]:
    """Versions of Python, platform, kernels and packages."""
    host = {"python": platform.python_version(), "platform": platform.platform(), "kernels": kernels.USED}
    return host | _package_versions()


@cache
def _package_versions() -> dict[str, str]:
    packages = ("mast-zenoh", "eclipse-zenoh", "numpy", "scipy", "msgpack", "filterpy", "mcap")
    return {package: version(package) for package in packages}


def write_results(folder: Path, results: Mapping[str, Mapping[str, Any]], measured: Mapping[str, Any]) -> list[str]:
    """Write what nodes returned from `finish`; return a sentence per refused part.

    The evaluator's `metrics`, and those of its `tables` that are in `results.TABLES`, become metrics.json and Parquet
    files at the top of the run folder. Everything else goes to results/<node>/: `tables` as <table>.parquet, the rest
    as results.json.

    measured: entries of metrics.json in addition to the evaluator's metrics; wall-clock values replace the evaluator's
    """
    refused: list[str] = []
    for node, result in results.items():
        other_parts = dict(result)
        tables = other_parts.pop("tables", {})
        if not _NAME.fullmatch(node):
            refused.append(f"{node!r:.80}: {_EXPECTED_NAME}")
            continue
        if node == EVALUATOR and isinstance(other_parts.get("metrics"), Mapping):
            write_json(folder / "metrics.json", finite({**other_parts.pop("metrics"), **measured}))
        if not isinstance(tables, Mapping):
            refused.append(f"{node}: tables: found a {type(tables).__name__}, expected a dict of tables")
            tables = {}
        if len(tables) > MAX_TABLES:
            refused.append(
                f"{node}: tables: found {len(tables)}, expected at most {MAX_TABLES}; "
                f"only the first {MAX_TABLES} are written"
            )
        for name, table in islice(tables.items(), MAX_TABLES):
            place = () if node == EVALUATOR and name in TABLES else ("results", node)
            if problem := _write_named(folder, place, name, table):
                refused.append(f"{node}: table {name!r:.80}: {problem}")
        if other_parts:
            write_json(subfolder(folder, "results", node) / "results.json", finite(other_parts))
    return refused


def _write_named(folder: Path, place: tuple[str, ...], name: object, table: object) -> str:
    """Write a node's table into a subfolder; return why it is refused, or an empty string."""
    if not isinstance(name, str) or not _NAME.fullmatch(name):
        return _EXPECTED_NAME
    if not isinstance(table, Mapping):
        return f"found a {type(table).__name__}, expected a dict of columns"
    if len(table) > MAX_COLUMNS:
        return f"found {len(table)} columns, expected at most {MAX_COLUMNS}"
    from mast_zenoh.launch.tables import (
        write_table,  # only the launcher writes tables; nodes must not pay for the import
    )

    try:
        write_table(subfolder(folder, *place) / f"{name}.parquet", table)
    except (OSError, MemoryError, ImportError, RunFolderError):  # not the table's fault: the run lacks a file
        raise
    except Exception as error:  # Arrow has many error classes, and users write tables
        return " ".join(str(error).split())[:200]
    return ""


def finite(value: Any) -> Any:
    """Plain JSON values: a number that is not finite becomes null, an array a list."""
    if isinstance(value, Mapping):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return [str(item) for item in value.tolist()] if value.dtype.kind in "OU" else finite(value.tolist())
    if isinstance(value, (list, tuple)):
        return [finite(item) for item in value]
    if isinstance(value, (float, np.floating)):
        return float(value) if math.isfinite(value) else None
    return value.item() if isinstance(value, np.generic) else value


def note_recording(
    folder: Path, record: dict[str, Any], handed_in: Mapping[str, Mapping[str, Any]], nodes: Mapping[str, NodeSpec]
) -> None:
    """Note in run.json how many messages were recorded, and whether some are missing.

    Only recorders know the number. The first frame with missing messages is measured from the recording in `folder`:
    in real time always, because the router drops messages for a recorder that does not read; in lock-step nodes wait.
    """
    recorder = next((name for name, spec in nodes.items() if spec.role == "recorder"), None)
    if recorder is not None:
        gaps = churn.first_frames(record.get("churn", ()), recorder)
        lost = counts_of(handed_in.get(recorder, {}).get("recorded")).get("lost")
        if record.get("mode") == "realtime" and (gap := _gap(folder, nodes)) is not None:
            gaps.append(gap)
        complete = recorder in handed_in and not lost and not gaps
        from_frame = {} if complete else {"from_frame": min([first_incomplete_frame(folder), *gaps])}
        record["recording"] = {"complete": complete} | from_frame
    for node, outcome in handed_in.items():
        if node in nodes and nodes[node].role == "recorder" and (recorded := counts_of(outcome.get("recorded"))):
            record["recorded"] = recorded | _failure(outcome["recorded"])
            if lost := recorded.get("lost", 0):
                messages = [record["message"]] if record["message"] else []
                record["message"] = "; ".join([*messages, f"{lost} messages could not be recorded"])


def _gap(folder: Path, nodes: Mapping[str, NodeSpec]) -> int | None:
    """The first frame of which the recording lacks a message of the driver; else None."""
    driver = driver_of(nodes)
    return first_missing_frame(folder, driver) if driver else None


def _failure(recorded: Mapping[str, Any]) -> dict[str, Any]:
    """Why a recorder stopped, if it did, and whether the disk was full."""
    problem = recorded.get("problem")
    if not isinstance(problem, str) or not problem:
        return {}
    return {"problem": problem[:_MAX_PROBLEM_CHARS], "disk_full": recorded.get("disk_full") is True}


def rates(frames: int, wall_s: float) -> dict[str, Any]:
    """Duration and speed of a run, for its `timings`."""
    return {
        "frames": frames,
        "run_s": round(wall_s, 4),
        "frames_per_second": round(frames / wall_s, 2) if wall_s else None,
    }
