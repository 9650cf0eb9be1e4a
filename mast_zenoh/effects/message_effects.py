"""What can happen to a whole message, and in which frames an interposer is on a wire."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from mast_zenoh.arrays.states import Floats

#: What can happen to a whole message.
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

#: Frames by which nodes may differ in real time about when a live change of the wiring took place.
CHANGE_FRAMES = 2


class MessageEffect(NamedTuple):
    """What an interposer did to one message.

    effect:  one of MESSAGE_EFFECTS
    frame, seq: of the message; -1 where nobody can read them
    step:    frame in which the interposer received it (forged: sent it)
    frames_late: by how many frames it was sent on later than it was received
    time_ns: ns, by how much the time in its header was changed
    columns: names of the columns, not of single objects, that were changed
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
    """The frames in which a passage is part of the wiring: from `begin`, before `end` (None: to the end of the run)."""

    begin: int
    end: int | None = None

    def has(self, step: int) -> bool:
        """Whether a message that was sent in a step took this way."""
        return self.begin <= step and (self.end is None or step < self.end)

    def near_change(self, step: int) -> bool:
        """Whether the passage came or went, while the run went on, about when a message was sent."""
        return (self.begin > 0 and step < self.begin + CHANGE_FRAMES) or (
            self.end is not None and step >= self.end - CHANGE_FRAMES
        )


class Spoof(NamedTuple):
    """A pose that an interposer changed: the frame, and position (3,) m and quaternion (4,) before and after."""

    frame: int
    position: Floats
    rotation: Floats
    false_position: Floats
    false_rotation: Floats
