"""Who was lost in a run, and who came back, though nothing in the scenario said so."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from mast_zenoh.errors import NodeLost

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

    handed_in: whether the recorder has handed in its results; if not, and the driver has not noticed, the frame is
    unknown
    """
    missed = [max(0, each["frame"] - 1) for each in churn if each["node"] == recorder]
    return {"complete": False, "from_frame": min(missed)} if missed else {"complete": handed_in}
