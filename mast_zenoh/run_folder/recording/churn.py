"""Unplanned losses and returns of nodes, and their consequences for the recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from operator import itemgetter
from pathlib import Path
from typing import Any

from mast_zenoh.errors import NodeLost, RunFolderError
from mast_zenoh.run_folder import finding, read_object
from mast_zenoh.run_folder.finding import Finding

#: The events of a node.
LOST, BACK = "lost", "back"

#: As in run.json: {"frame": the frame before which it happened, "node": its name, "what": LOST or BACK}.
Churn = Sequence[Mapping[str, Any]]


def sentence(churn: Churn) -> str:
    """The events in their order, as text: `infra_2 was lost before frame 40`."""
    return "; ".join(map(finding.sentence, events(churn)))


def events(churn: Churn) -> tuple[Finding, ...]:
    """A finding for each event, in their order."""
    return tuple(Finding("presence", (each["node"],), each["what"], each["frame"], unit="frame") for each in churn)


def error(churn: Churn) -> NodeLost:
    """The error of a lock-step run with churn that is not allowed."""
    hint = "the results are kept; `mast run --allow-churn` makes this a warning"
    return NodeLost(f"{sentence(churn)}: in lock-step this makes it a different run\n{hint}")


def first_frames(churn: Churn, node: str) -> list[int]:
    """For each event of a node, the first frame that it may have missed."""
    return [_first_affected(event) for event in churn if event["node"] == node]


def comparable(*paths: Path) -> tuple[int | None, str]:
    """The first frame that cannot be compared between recordings, and why, or None.

    Where a recording is incomplete from the frame in which a node was lost, the recording is the reason.

    paths: run folders or recordings; nothing is known about the completeness of the latter. Raises RunFolderError for
    an unreadable run.json.
    """
    return min((reason for path in paths for reason in _reasons(path)), key=itemgetter(0), default=(None, ""))


def _first_affected(event: Mapping[str, Any]) -> int:
    """The first frame that may be incomplete: the one before a node was found lost."""
    frame: int = event["frame"]
    return max(0, frame - 1)


def _reasons(path: Path) -> list[tuple[int, str]]:
    """(first frame that cannot be compared, reason), from the run.json of a run."""
    file = path / "run.json"
    if not file.is_file():
        return []
    try:
        record = read_object(file)
        lost = [event for event in record.get("churn", ()) if event["what"] == LOST]
        reasons = []
        if "from_frame" in record.get("recording", {}):
            reasons.append((int(record["recording"]["from_frame"]), f"the recording of {path} is incomplete"))
        reasons.extend((_first_affected(event), f"{event['node']} was lost in {path}") for event in lost)
    except (ValueError, AttributeError, KeyError, TypeError) as error:
        raise RunFolderError(f"{file}: cannot be read: {error}") from error
    return reasons
