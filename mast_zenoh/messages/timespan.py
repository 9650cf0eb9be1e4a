"""The valid frames and times of a run's messages; others are rejected on arrival."""

from __future__ import annotations

from typing import NamedTuple

from mast_zenoh.messages.schemas import Header

#: s, tolerance for times where no node declares that it changes them (`Node.restamps_s`): small shifts by an adversary
#: must take effect; messages that are off by more are useless to every shipped node.
LEEWAY_S = 1.0


class Timespan(NamedTuple):
    """The frames of a run and their times.

    frames:    number of frames
    period_ns: ns, from one frame to the next
    leeway_ns: ns, tolerance for the time in a header: clock faults, uneven frames, LEEWAY_S
    """

    frames: int
    period_ns: int
    leeway_ns: int

    def refusal(self, header: Header, step: int) -> str:
        """The reason why a message cannot belong to the run, or "".

        step: the current frame of the run, -1 if unknown

        A message is about a frame of the run that has begun. Its time is between the times of its frame and of `step`.
        Both may be off by the leeway.
        """
        _, _, frame, time_ns, _ = header
        frames, period_ns, leeway_ns = self
        if frame <= step < frames and time_ns == frame * period_ns:
            return ""  # nearly all are
        latest = frames - 1 if step < 0 else min(step, frames - 1)
        if (frame - latest) * period_ns > leeway_ns:
            expected = f"at most {latest + leeway_ns // period_ns}"
            return f"frame: {header.schema}: frame is {frame}, expected {expected}"
        earliest_ns, latest_ns = frame * period_ns - leeway_ns, max(frame, step) * period_ns + leeway_ns
        if not earliest_ns <= time_ns <= latest_ns:
            expected = f"{max(0, earliest_ns)} to {latest_ns} of frame {frame}"
            return f"time: {header.schema}: time_ns is {time_ns}, expected {expected}"
        return ""
