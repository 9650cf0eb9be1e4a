"""Why a run stops: a typed value, and its text in messages and results.

The driver says why it has stopped, and the launcher makes the run's error of it.

    end                      all frames have been played
    stall: TEXT              the mesh did not become quiet
    start: TEXT              not every node was there in time
    implausible: TEXT        a node's counters cannot be true
    anything else            the driver was told to stop, with this text
"""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple

MAX_TEXT = 2000  #: characters of the driver's own reason


class StopKind(Enum):
    """The kind of a reason; its value is what the text begins with."""

    END = "end"
    STALL = "stall"
    START = "start"
    IMPLAUSIBLE = "implausible"
    TOLD = ""


class StopReason(NamedTuple):
    """Why a run stops; detail: in words, "" for END."""

    kind: StopKind
    detail: str = ""


END = StopReason(StopKind.END)


def encode_reason(reason: StopReason) -> str:
    """The text that stands for a reason; see the module's docstring."""
    if reason.kind is StopKind.END:
        return str(reason.kind.value)
    return reason.detail if reason.kind is StopKind.TOLD else f"{reason.kind.value}: {reason.detail}"


def decode_reason(text: str) -> StopReason:
    """The reason that a text stands for; never fails."""
    if text == StopKind.END.value:
        return END
    for kind in (StopKind.STALL, StopKind.START, StopKind.IMPLAUSIBLE):
        if text.startswith(f"{kind.value}: "):
            return StopReason(kind, text.removeprefix(f"{kind.value}: "))
    return StopReason(StopKind.TOLD, text)
