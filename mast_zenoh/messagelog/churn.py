"""Nodes that were lost in a run, or came back, though the scenario did not say so: what that means for its record."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from mast_zenoh.errors import NodeLost, RunFolderError

#: What can have happened to a node, and how a sentence says it.
LOST, BACK = "lost", "back"
_WORDS = {LOST: "was lost", BACK: "came back"}

#: As in run.json: {"frame": before which it happened, "node": its name, "what": LOST or BACK}.
Churn = Sequence[Mapping[str, Any]]


def sentence(churn: Churn) -> str:
    """What happened, in the order in which it did: `infra_2 was lost before frame 40`."""
    return "; ".join(f"{each['node']} {_WORDS[each['what']]} before frame {each['frame']}" for each in churn)


def error(churn: Churn) -> NodeLost:
    """The error of a lock-step run with churn that is not allowed."""
    hint = "the results are kept; `mast run --allow-churn` makes this a warning"
    return NodeLost(f"{sentence(churn)}: in lock-step a run without it is another run\n{hint}")


def first_frames(churn: Churn, node: str) -> list[int]:
    """Of each time that something happened to a node, the first frame that it may have missed."""
    return [_first_affected(each) for each in churn if each["node"] == node]


def comparable(*paths: Path) -> tuple[int | None, str]:
    """The first frame of which the recordings of some runs say nothing about each other, and why; None: there is none.

    paths: of run folders, or of recordings, of which nothing more is known. Raises RunFolderError for a run.json that
    cannot be read.
    """
    return min((reason for path in paths for reason in _reasons(path)), default=(None, ""))


def _first_affected(event: Mapping[str, Any]) -> int:
    """The first frame that may lack something: a node may be lost while the frame before is still going on."""
    frame: int = event["frame"]
    return max(0, frame - 1)


def _reasons(path: Path) -> list[tuple[int, str]]:
    """From which frames on a run cannot be compared, and why, as its run.json has it."""
    file = path / "run.json"
    if not file.is_file():
        return []
    try:
        record = json.loads(file.read_text(encoding="utf-8")) or {}
        lost = [event for event in record.get("churn", ()) if event["what"] == LOST]
        found = [(_first_affected(event), f"{event['node']} was lost in {path}") for event in lost]
        if "from_frame" in record.get("recording", {}):
            found.append((int(record["recording"]["from_frame"]), f"the recording of {path} is incomplete"))
    except (ValueError, AttributeError, KeyError, TypeError) as error:
        raise RunFolderError(f"{file}: cannot be read: {error}") from error
    return found
