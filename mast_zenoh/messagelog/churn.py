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
    hint = "the results are kept; --allow-churn makes this a warning"
    return NodeLost(f"{sentence(churn)}: in lock-step a run without it is another run\n{hint}")


def recording(churn: Churn, recorder: str, *, handed_in: bool = True) -> dict[str, Any]:
    """What run.json says of the recording: whether it has everything, and if not, from which frame on it has not.

    handed_in: whether the recorder has handed in its results; if not, and nobody has noticed, the frame is unknown
    """
    missed = [_first_affected(each) for each in churn if each["node"] == recorder]
    return {"complete": False, "from_frame": min(missed)} if missed else {"complete": handed_in}


def comparable(*paths: Path) -> tuple[int | None, str]:
    """The first frame of which the recordings of some runs say nothing about each other, and why; None: there is none.

    paths: of run folders, or of recordings, of which nothing more is known. Raises RunFolderError for a run.json that
    cannot be read.
    """
    found = [(_first_affected(event), event["node"], path) for path in paths for event in _lost(path)]
    if not found:
        return None, ""
    frame, node, path = min(found)
    return frame, f"{node} was lost in {path}"


def _first_affected(event: Mapping[str, Any]) -> int:
    """The first frame that may lack something: a node may be lost while the frame before is still going on."""
    frame: int = event["frame"]
    return max(0, frame - 1)


def _lost(path: Path) -> list[dict[str, Any]]:
    """What run.json says of nodes that were lost."""
    file = path / "run.json"
    if not file.is_file():
        return []
    try:
        record = json.loads(file.read_text(encoding="utf-8"))
        return [event for event in record.get("churn", ()) if event["what"] == LOST] if record else []
    except (ValueError, AttributeError, KeyError, TypeError) as error:
        raise RunFolderError(f"{file}: cannot be read: {error}") from error
