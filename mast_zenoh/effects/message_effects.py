"""Effects on whole messages, and the frames in which an interposer is on a wire."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from mast_zenoh.arrays.states import Floats

#: Effects on whole messages.
DELAYED, DROPPED, REPEATED, CORRUPTED, RESTAMPED, REFRAMED, FORGED, UNSETTLED = MESSAGE_EFFECTS = (
    "delayed",
    "dropped",
    "repeated",
    "corrupted",
    "restamped",
    "reframed",
    "forged",
    "unsettled",
)

#: Number of frames by which nodes may differ, in real time, about the time of a live wiring change.
CHANGE_FRAMES = 2


class MessageEffect(NamedTuple):
    """The effect of an interposer on one message.

    effect:  one of MESSAGE_EFFECTS
    frame, seq: of the message; -1 if unreadable
    step:    frame in which the interposer received it (forged: sent it)
    frames_late: delay in frames
    time_ns: ns, change of the time in its header
    columns: names of the changed columns, except columns with a row for each object
    """

    effect: str
    frame: int
    seq: int
    step: int
    frames_late: int = 0
    time_ns: int = 0
    columns: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Interval:
    """The frames in which a passage is part of the wiring.

    From `begin`, before `end` (None: to the end of the run).
    """

    begin: int
    end: int | None = None

    def contains(self, step: int) -> bool:
        """Whether a message sent in a step passed through."""
        return self.begin <= step and (self.end is None or step < self.end)

    def near_change(self, step: int) -> bool:
        """Whether the passage was added or removed when a message was sent."""
        return (self.begin > 0 and step < self.begin + CHANGE_FRAMES) or (
            self.end is not None and step >= self.end - CHANGE_FRAMES
        )


class Spoof(NamedTuple):
    """A pose that an interposer changed.

    Position (3,) m and quaternion (4,) in a frame, before and after.
    """

    frame: int
    position: Floats
    rotation: Floats
    false_position: Floats
    false_rotation: Floats
