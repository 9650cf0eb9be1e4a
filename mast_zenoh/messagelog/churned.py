"""From which frame on a run cannot be compared with others, because a node was lost in it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from mast_zenoh.errors import RunFolderError


def comparable(*paths: Path) -> tuple[int | None, str]:
    """The first frame of which the recordings of some runs say nothing about each other, and why; None: there is none.

    paths: of run folders, or of recordings, of which nothing more is known. Raises RunFolderError for a run.json that
    cannot be read.
    """
    # It may have been lost while the frame before was still going on.
    found = [(max(0, event["frame"] - 1), event["node"], path) for path in paths for event in _lost(path)]
    if not found:
        return None, ""
    frame, node, path = min(found)
    return frame, f"{node} was lost in {path}"


def _lost(path: Path) -> list[dict[str, Any]]:
    """What run.json says of nodes that were lost."""
    file = path / "run.json"
    if not file.is_file():
        return []
    try:
        record = json.loads(file.read_text(encoding="utf-8"))
        return [event for event in record.get("churn", ()) if event["what"] == "lost"] if record else []
    except (ValueError, AttributeError, KeyError, TypeError) as error:
        raise RunFolderError(f"{file}: cannot be read: {error}") from error
