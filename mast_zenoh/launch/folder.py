"""The run folder: what a run leaves behind, and in which files."""

from __future__ import annotations

import json
import math
import os
import platform
import re
import tempfile
from collections.abc import Mapping
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from mast_zenoh import kernels
from mast_zenoh.errors import RunFolderError
from mast_zenoh.runtime import churn
from mast_zenoh.runtime.results import EVALUATOR

_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,63}")
_EXPECTED_NAME = "expected a name of at most 64 letters, digits, dots, hyphens and underscores that begins with no dot"


def create(out: Path | None, name: str) -> Path:
    """A new, empty run folder: `out`, or one under runs/ named after the scenario and the time.

    Raises RunFolderError when it holds something already, or cannot be made.
    """
    try:
        if out is None:
            out = _unused(Path("runs") / f"{name}-{datetime.now(UTC).strftime('%Y%m%d-%H%M%S')}")
        out.mkdir(parents=True, exist_ok=True)
        occupied = any(out.iterdir())
    except OSError as error:
        raise RunFolderError(f"{out}: cannot be made a run folder: {error.strerror or error}") from None
    if occupied:
        raise RunFolderError(f"{out}: is not empty; name a new folder with --out, or remove what is there")
    for part in ("logs", "figures"):
        (out / part).mkdir()
    return out.resolve()


def _unused(path: Path) -> Path:
    """A folder of this name, or of this name and a number, that was not there before; two runs never get the same."""
    for candidate in (path, *(path.with_name(f"{path.name}-{i}") for i in range(2, 1000))):
        try:
            candidate.mkdir(parents=True)
        except FileExistsError:
            continue
        return candidate
    raise FileExistsError(f"{path}-2 to {path}-999 are all there")


def write_json(path: Path, content: Any) -> None:
    """Write a JSON file so that whoever reads it finds the old one or the new one, whole."""
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    with os.fdopen(handle, "w", encoding="utf-8") as file:
        json.dump(content, file, indent=2, allow_nan=False)
        file.write("\n")
    os.chmod(name, 0o644)
    os.replace(name, path)


def read_json(path: Path) -> Any:
    """The content of a JSON file of a run folder; raises RunFolderError when it is missing or broken."""
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise RunFolderError(f"{path}: missing; is {path.parent} a run folder?") from None
    except (OSError, ValueError) as error:
        raise RunFolderError(f"{path}: {error}") from None


def json_or_empty(path: Path) -> dict[str, Any]:
    """The object in a JSON file; {} if there is none that can be read."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}


def versions() -> dict[str, str]:
    """What the run ran on."""
    packages = ("mast-zenoh", "eclipse-zenoh", "numpy", "scipy", "msgpack", "filterpy", "mcap")
    here = {"python": platform.python_version(), "platform": platform.platform(), "kernels": kernels.USED}
    return here | {package: version(package) for package in packages}


def write_results(folder: Path, results: Mapping[str, Mapping[str, Any]], measured: Mapping[str, Any]) -> list[str]:
    """Write what nodes returned from `finish`; returns a sentence for each part that was refused.

    The `metrics` and `tables` of the evaluator become metrics.json and Parquet files at the top of the run folder.
    Everything else goes to results/<node>/: `tables` as <table>.parquet, the rest as results.json.

    measured: what goes into metrics.json beside the evaluator's metrics, or, being of the wall clock, in their place
    """
    refused: list[str] = []
    for node, result in results.items():
        own, rest = folder / "results" / node, dict(result)
        top = folder if node == EVALUATOR else own
        tables = rest.pop("tables", {})
        if not _NAME.fullmatch(node):
            refused.append(f"{node!r:.80}: {_EXPECTED_NAME}")
            continue
        if node == EVALUATOR and isinstance(rest.get("metrics"), Mapping):
            write_json(folder / "metrics.json", finite({**rest.pop("metrics"), **measured}))
        if not isinstance(tables, Mapping):
            refused.append(f"{node}: tables: found a {type(tables).__name__}, expected a dict of tables")
            tables = {}
        for name, table in tables.items():
            if problem := _write_named(top, name, table):
                refused.append(f"{node}: table {name!r:.80}: {problem}")
        if rest:
            own.mkdir(parents=True, exist_ok=True)
            write_json(own / "results.json", finite(rest))
    return refused


def _write_named(folder: Path, name: object, table: object) -> str:
    """Write a node's table; returns why it is refused, or nothing."""
    if not isinstance(name, str) or not _NAME.fullmatch(name):
        return _EXPECTED_NAME
    if not isinstance(table, Mapping):
        return f"found a {type(table).__name__}, expected a dict of columns"
    from mast_zenoh.tables import write_table  # only the launcher writes tables; nodes must not pay for the import

    folder.mkdir(parents=True, exist_ok=True)
    try:
        write_table(folder / f"{name}.parquet", table)
    except (ValueError, TypeError, RuntimeError) as error:  # Arrow's own are among them
        return " ".join(str(error).split())[:200]
    return ""


def finite(value: Any) -> Any:
    """Plain JSON values: a number that is not finite becomes null, an array a list."""
    if isinstance(value, Mapping):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return finite((value.astype(str) if value.dtype.kind in "OU" else value).tolist())
    if isinstance(value, (list, tuple)):
        return [finite(item) for item in value]
    if isinstance(value, (float, np.floating)):
        return float(value) if math.isfinite(value) else None
    return value.item() if isinstance(value, np.generic) else value


def note_recording(record: dict[str, Any], handed_in: Mapping[str, Mapping[str, Any]]) -> None:
    """How many messages were recorded goes to run.json, and whether they are all; a note if some could not be."""
    recorder = next((name for name, node in record["nodes"].items() if node["role"] == "recorder"), None)
    if recorder is not None:
        record["recording"] = churn.recording(record.get("churn", ()), recorder)
    for outcome in handed_in.values():
        if "recorded" in outcome:
            record["recorded"] = outcome["recorded"]
            if lost := outcome["recorded"]["lost"]:
                said = [record["message"]] if record["message"] else []
                record["message"] = "; ".join([*said, f"{lost} messages could not be recorded"])


def rates(frames: int, wall_s: float) -> dict[str, Any]:
    """How fast a run went, for its `timings`."""
    return {"run_s": round(wall_s, 4), "frames_per_second": round(frames / wall_s, 2) if wall_s else None}
