"""Why a run stops: a typed value, and its text in messages and results.

The driver reports it, and the launcher turns it into the run's error.

    end                      all frames have been played
    stall: TEXT              the mesh did not become quiet
    start: TEXT              not every node joined in time
    implausible: TEXT        a node's counters are impossible
    anything else            a stop request with this text
"""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple

MAX_TEXT = 2000  #: characters of the driver's own reason


class StopKind(Enum):
    """The kind of a reason; its value is the beginning of the text."""

    END = "end"
    STALL = "stall"
    START = "start"
    IMPLAUSIBLE = "implausible"
    REQUESTED = ""


class StopReason(NamedTuple):
    """Why a run stops; detail: as text, "" for END."""

    kind: StopKind
    detail: str = ""


END = StopReason(StopKind.END)


def encode_reason(reason: StopReason) -> str:
    """The text of a reason; see the module's docstring."""
    if reason.kind is StopKind.END:
        return str(reason.kind.value)
    return reason.detail if reason.kind is StopKind.REQUESTED else f"{reason.kind.value}: {reason.detail}"


def decode_reason(text: str) -> StopReason:
    """The reason in a text; never fails."""
    if text == StopKind.END.value:
        return END
    for kind in (StopKind.STALL, StopKind.START, StopKind.IMPLAUSIBLE):
        if text.startswith(f"{kind.value}: "):
            return StopReason(kind, text.removeprefix(f"{kind.value}: "))
    return StopReason(StopKind.REQUESTED, text)
